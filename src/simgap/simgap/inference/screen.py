"""A first look at every candidate: one replay for each start value on a few windows, nuisances refitted linearly."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from simgap.effects.base import Effect
from simgap.inference.fit import MANY, Fitter
from simgap.inference.hypothesis import Fit
from simgap.inference.model_selection import places
from simgap.inference.nuisance import BOX
from simgap.simulation.windows import HORIZON

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

WINDOWS = 18
"""Windows used for screening."""
_JOBS, _FEWEST = 500, 6
"""With more start values than this (a robot with many joints), each gets fewer windows, down to six."""
_GLANCE = 5
"""Windows of the glance that leaves out what promises least."""
_CROWD, _GLANCE_CROWD = 150, 3
"""With more candidates than this, it sees fewer, and one start in each direction, whose opposite is taken from that."""
_BATCH = 24
_FARTHEST, _FURTHER, _ROUNDS = 1.5, 2.0, 3
"""A start value promises something for effects up to so many times as large; of one that promises most there, the next
start lies so many times as far, so often. What is large beside the model's own (damping of a servo that hardly has to
push) is not lost behind what happens to begin near its size."""


@dataclass
class Glance:
    """What starts change in the windows of a glance, kept for a look about another fit.

    What an effect changes depends little on which nominal numbers it stands beside, and a glance only proposes.
    """

    select: Ints | None = None
    changes: dict[tuple[int, tuple[float, ...]], Array] = field(default_factory=dict)


@dataclass(frozen=True)
class Screened:
    """A candidate with the start value from which it promises most, and the cost that it promises."""

    effect: Effect
    x: Array
    z: Array
    cost: float
    response: Array
    """What the start value changes in the residual, weighted, with what nuisances can imitate taken out; flat."""
    farthest: bool = False
    """Whether it promises most as far from neutral as the start value tells."""


def informative_windows(fitter: Fitter, fit: Fit, count: int = WINDOWS) -> Ints:
    """Windows spread over the recording: in each stretch the one with the largest gap.

    ``count`` is that of windows of the usual length; of shorter ones there are more, of longer ones fewer, so that as
    many seconds are looked at.
    """
    length = fitter.windows.length * fitter.residuals.replayer.aligned.period
    count = max(round(count * HORIZON / length), min(count, _FEWEST))
    square = fitter.mean_square(fit.residual)
    size = np.log1p(square).sum(axis=1)
    if len(size) <= count:
        return np.arange(len(size), dtype=np.int64)
    parts = np.array_split(np.arange(len(size)), count)
    chosen: Ints = np.array([int(p[np.argmax(size[p])]) for p in parts], np.int64)
    return chosen


def screen(
    fitter: Fitter,
    fit: Fit,
    effects: Sequence[Effect],
    progress: Callable[[float], None] | None = None,
    hopeful: int | None = None,
    thorough: bool = False,
    windows: int = WINDOWS,
    glance: Glance | None = None,
) -> list[Screened]:
    """Rank candidates, each added to ``fit``'s hypothesis; best first.

    Where a model has more than ``hopeful`` candidates, a look at fewer windows from moderate starts only leaves out
    what promises least; ``thorough``: but from all of them. ``windows`` are those of the closer look; ``glance`` keeps
    what the first look about one fit saw for that about another of the same effects.

    The residual at a start value is a true replay; between it and the residual without the effect, and in the
    nuisances, it is taken for linear. One start is kept for each candidate.
    """
    chosen, done = list(effects), 0.0
    if hopeful is not None and len(chosen) > 1.3 * hopeful:
        crowd = len(chosen) > _CROWD
        starts = {id(e): _glanced_at(e, crowd, thorough) + _far(e, crowd) for e in chosen}
        glance = glance or Glance()
        if glance.select is None:
            glance.select = informative_windows(fitter, fit, _GLANCE_CROWD if crowd else _GLANCE)
        both = crowd and not thorough
        ranked = _ranked(fitter, fit, chosen, starts, glance.select, progress, (0.0, 0.6), both, glance.changes)
        # What a robot has but one of (its ground, its link) is no crowd.
        sites = places(chosen)
        hope = ranked[:hopeful] + [s for s in ranked[hopeful:] if sites[s.effect.name] == 1]
        chosen, done = [s.effect for s in hope], 0.6
    starts = {id(e): e.starts() + _far(e, len(effects) > _CROWD) for e in chosen}
    jobs = sum(len(tries) for tries in starts.values())
    count = int(np.clip(windows * _JOBS / max(jobs, 1), _FEWEST, windows))
    select = informative_windows(fitter, fit, count)
    fresh = _ranked(fitter, fit, chosen, starts, select, progress, (done, 1.0))
    best = {id(s.effect): s for s in fresh}
    for _ in range(_ROUNDS):
        starts = {id(s.effect): [further] for s in fresh if (further := _beyond(s)) is not None}
        tried = _ranked(fitter, fit, [e for e in chosen if id(e) in starts], starts, select, None, (1.0, 1.0))
        fresh = [s for s in tried if s.cost < best[id(s.effect)].cost]
        best |= {id(s.effect): s for s in fresh}
    return sorted(best.values(), key=lambda s: s.cost)


def _beyond(screened: Screened) -> tuple[float, ...] | None:
    """The next start value of a candidate with one parameter that promises most as far as its start tells, if any."""
    return screened.effect.times(_FURTHER, screened.x) if screened.farthest and screened.effect.one_size else None


def _glanced_at(effect: Effect, crowd: bool, thorough: bool) -> list[tuple[float, ...]]:
    """The starts of a glance."""
    if thorough:
        return effect.starts()
    return _directions(effect) if crowd else _moderate(effect)


def _moderate(effect: Effect) -> list[tuple[float, ...]]:
    """Of three starts the weaker two, for a limit that is reached now and then shows little when far lower; of four the
    inner.
    """
    starts = effect.starts()
    return starts[:2] if len(starts) == 3 else starts[1:-1] if len(starts) == 4 else starts


def _far(effect: Effect, crowd: bool) -> list[tuple[float, ...]]:
    """Starts decades away; in a crowd of groups only, for a model that is so wrong is so in more than one part."""
    return effect.far_starts() if len(effect.site.targets) > 1 or not crowd else []


def _directions(effect: Effect) -> list[tuple[float, ...]]:
    """The stronger of the moderate starts in each direction from neutral; an opposite is the same direction.

    Of an effect that is `one_sided` all but the strongest.
    """
    if effect.one_sided:
        return sorted(effect.starts(), key=lambda start: abs(effect.parameters[0].away(start[0])))[:-1]
    neutral, scale = (np.array([getattr(p, a) for p in effect.parameters]) for a in ("neutral", "scale"))
    kept: list[tuple[tuple[float, ...], Array]] = []
    for start in reversed(_moderate(effect)):
        away = (np.array(start) - neutral) / scale
        away = away / max(float(np.linalg.norm(away)), 1e-300)
        if all(abs(float(away @ other)) < 0.9 for _, other in kept):
            kept.append((start, away))
    return [start for start, _ in kept]


def _reversible(effect: Effect, start: Array) -> bool:
    """Whether the opposite of a start lies within the bounds too."""
    return effect.times(-1.0, start) is not None


def _ranked(
    fitter: Fitter,
    fit: Fit,
    effects: Sequence[Effect],
    starts: dict[int, list[tuple[float, ...]]],
    select: Ints,
    progress: Callable[[float], None] | None,
    span: tuple[float, float],
    both: bool = False,
    known: dict[tuple[int, tuple[float, ...]], Array] | None = None,
) -> list[Screened]:
    """Candidates by what their best start promises on the selected windows, best first; ``both``: or its opposite.

    Changes that are ``known`` are not replayed; those that are replayed are known from then on.
    """
    known = {} if known is None else known
    base = fit.residual[select]
    project = _projector(fitter, base, select)
    jobs = [(effect, np.array(start)) for effect in effects for start in starts[id(effect)]]
    best: dict[int, Screened] = {}
    quick = _Quick(fitter, fit, base, select) if len(fitter.nuisances) > MANY else None
    for first in range(0, len(jobs), _BATCH):
        part = jobs[first : first + _BATCH]
        fresh = [(e, x) for e, x in part if (id(e), tuple(x)) not in known]
        variants = [fitter.variant(fit.hypothesis.with_effect(e), np.concatenate([fit.x, x]), fit.z) for e, x in fresh]
        for (effect, x), residual in zip(fresh, fitter.residuals.of(variants, select) if fresh else (), strict=True):
            known[id(effect), tuple(x)] = residual - base
        for effect, x in part:
            response = known[id(effect), tuple(x)]
            if quick is None:
                share, z, cost = _promise(fitter, fit, base, base + response, select)
            else:
                share, z, cost = quick.promise(response, -1.0 if both and _reversible(effect, x) else 0.0)
            reach = float(np.copysign(np.clip(abs(share), 0.15, _FARTHEST), share))
            start = np.array(effect.moved(reach, x))
            if id(effect) not in best or cost < best[id(effect)].cost:
                farthest = abs(share) > 0.99 * _FARTHEST
                best[id(effect)] = Screened(effect, start, z, cost, project(response), farthest)
        if progress:
            progress(span[0] + (span[1] - span[0]) * min(first + _BATCH, len(jobs)) / len(jobs))
    return sorted(best.values(), key=lambda s: s.cost)


def _promise(fitter: Fitter, fit: Fit, base: Array, residual: Array, select: Ints) -> tuple[float, Array, float]:
    """(share of the start value that fits best, nuisances and cost there), about no effect and about the start."""
    nuisances = fitter.jacobian[:, select].astype(float)
    candidates = []
    response = residual - base
    for about, low, high in ((base, 0.0, _FARTHEST), (residual, -0.7, _FARTHEST - 1.0)):
        dx, dz, _ = fitter.solve(about, response[None], fit.z, np.array([low]), np.array([high]), select)
        predicted = about + dx[0] * response + np.tensordot(dz, nuisances, 1)
        z = fit.z + dz
        cost = float(fitter.data_cost(fitter.mean_square(predicted, select), select)) + 0.5 * float(z @ z)
        candidates.append((float(dx[0]) + (0.0 if about is base else 1.0), np.clip(z, -BOX, BOX), cost))
    return min(candidates, key=lambda c: c[2])


class _Quick:
    """`_promise` where there are many nuisances: all starts are weighted as the residual without the effect is.

    What nuisances answer to it and to each change then comes from one factorisation.
    """

    def __init__(self, fitter: Fitter, fit: Fit, base: Array, select: Ints) -> None:
        self._fitter, self._select, self._base, self._z = fitter, select, base, fit.z
        root = np.sqrt(fitter.weights(fitter.mean_square(base, select), select))[:, None, :]
        self._root = np.broadcast_to(root, base.shape).reshape(-1)
        self._nuisances = fitter.jacobian[:, select].reshape(len(fit.z), base.size)
        self._rows = self._nuisances * self._root.astype(np.float32)
        normal = (self._rows @ self._rows.T).astype(float) + np.eye(len(fit.z))
        self._factor = cho_factor(normal)
        self._flat = base.reshape(-1) * self._root
        self._pull = self._rows @ self._flat + fit.z
        self._answer = cho_solve(self._factor, self._pull)

    def promise(self, response: Array, lowest: float = 0.0) -> tuple[float, Array, float]:
        """As `_promise`, of what a start changes; ``lowest`` is the smallest share of it about no effect."""
        flat = response.reshape(-1) * self._root
        pull = self._rows @ flat
        answer = cho_solve(self._factor, pull)
        curve = max(float(flat @ flat - pull @ answer), 1e-12)
        slope = float(flat @ self._flat - pull @ self._answer)
        found = []
        # At the start itself the residual is a true replay.
        for s in (float(np.clip(-slope / curve, lowest, _FARTHEST)), 1.0):
            dz = np.clip(-(self._answer + s * answer), -BOX - self._z, BOX - self._z)
            predicted = (self._base + s * response).reshape(-1) + dz.astype(np.float32) @ self._nuisances
            square = self._fitter.mean_square(predicted.reshape(response.shape), self._select)
            z = self._z + dz
            found.append((s, z, float(self._fitter.data_cost(square, self._select)) + 0.5 * float(z @ z)))
        return min(found, key=lambda f: f[2])


def _projector(fitter: Fitter, base: Array, select: Ints) -> Callable[[Array], Array]:
    """A function that weighs a change of the residual and takes out what nuisances within their priors can imitate."""
    root = np.sqrt(fitter.weights(fitter.mean_square(base, select), select))[:, None, :]
    nuisances = (fitter.jacobian[:, select] * root).reshape(len(fitter.jacobian), base.size).astype(float)
    factor = np.linalg.cholesky(nuisances @ nuisances.T + np.eye(len(nuisances)))

    def project(change: Array) -> Array:
        flat = (change * root).reshape(-1)
        shares = np.linalg.solve(factor.T, np.linalg.solve(factor, nuisances @ flat))
        result: Array = flat - nuisances.T @ shares
        return result

    return project


def projected_response(fitter: Fitter, fit: Fit, reference: Fit) -> Array:
    """What a fitted hypothesis changes in the residual, whitened, with what nuisances can imitate taken out; flat."""
    root = np.sqrt(fitter.weights(fitter.mean_square(reference.residual)))[:, None, :]
    change = ((fit.residual - reference.residual) * root).reshape(-1)
    nuisances = (fitter.jacobian * root).reshape(len(fitter.jacobian), change.size).astype(float)
    normal = nuisances @ nuisances.T + np.eye(len(nuisances))
    projected: Array = change - nuisances.T @ np.linalg.solve(normal, nuisances @ change)
    return projected


def angle(one: Array, two: Array) -> float:
    """Angle [deg] between two responses, 0 to 180."""
    norm = float(np.linalg.norm(one) * np.linalg.norm(two))
    return float(np.degrees(np.arccos(np.clip(one @ two / norm, -1.0, 1.0)))) if norm > 0 else 90.0
