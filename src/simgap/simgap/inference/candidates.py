"""Fits of candidates: where they begin, one more beside others, and to the end."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations, pairwise, product

import numpy as np
from numpy.typing import NDArray

from simgap.effects.base import Effect
from simgap.inference.effort import Effort, Progress
from simgap.inference.fit import Fitter
from simgap.inference.forms import Forms
from simgap.inference.hypothesis import Fit, Hypothesis
from simgap.inference.loose_numbers import own_moved_into
from simgap.inference.model_selection import EVIDENCE, FINALISTS
from simgap.inference.proposals import Start
from simgap.inference.scores import Scored, Scores
from simgap.inference.screen import Screened, informative_windows

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Hint = tuple[str, str, float]
"""Name, site and value of an effect for which a part speaks that was looked at by itself."""

FIT_WINDOWS = 30
"""Windows in which candidates are fitted; they are scored, and the leaders refitted, in all."""
LARGER = (1.25, 1.6, 2.2)
"""How many times as large an effect is tried before it is fitted, as the screening found it."""
HOPELESS, FAR = 20.0, 0.3
"""Behind the best by more than so many nats, and by this share of what the best gains, a candidate is not refitted:
fits with the nominal model's sensitivities are that rough."""
FAVOURITES = 2
"""First fits start where nominal numbers hide most of an effect; what the screening ranks so high is refitted."""
SHAKEN = (0.75, 0.88, 0.95, 1.05, 1.14, 1.3)
"""So many times as large an effect is tried once more where much is left: laws that switch (a play, a dead band) have
optima beside the one that a fit ends in."""
_SHAKEN_STARTS, _SHAKEN_MOST = 3, 12
"""Of these values so many are fitted; and of hypotheses with more parameters none are tried: 24 of an arm's six joints
ask for 290 replays, and each fit for a hundred."""
MANY_PARAMETERS = 6
"""Hypotheses with more are fitted in some windows first, and in all only where that promises something."""
ITERATIONS = 15
"""Of a fit of what single parts speak for together, which has many parameters; most take no new sensitivities."""
PAIRED, _PAIRS_ENDED = 5, 2
"""Kinds of effects that are tried two by two, and pairs that are fitted to their end."""
TOGETHER = 4
"""Kinds of effects, at most, that single parts speak for and that are tried together."""


def by_score(scored: Scored) -> float:
    """To sort with; the best is first."""
    return scored.score


class Candidates:
    """Fits effects, alone or beside others, on one recording."""

    def __init__(
        self, fitter: Fitter, effects: Sequence[Effect], scores: Scores, effort: Effort, progress: Progress | None
    ) -> None:
        self.fitter, self.effects, self.scores = fitter, list(effects), scores
        self.effort, self._progress = effort, progress
        self.forms = Forms(fitter, self.effects, scores, effort)

    def hinted(self, hints: Sequence[Hint]) -> list[Start]:
        """Starts for what single parts speak for, where a hint is there for each part of a candidate's site.

        Nominal numbers are untouched.
        """
        assert self.fitter.nominal is not None
        spoken = {(name, site): value for name, site, value in hints}
        found = []
        for effect in self.effects:
            parts = _parts(effect, [site for name, site in spoken if name == effect.name])
            if parts and effect.one_size:
                values = [spoken[effect.name, part] for part in parts]
                x = np.clip(values, [p.low for p in effect.parameters], [p.high for p in effect.parameters])
                found.append((effect, x, np.zeros_like(self.fitter.nominal.z)))
        return found

    def together(self, hints: Sequence[Hint], base: Scored) -> Scored | None:
        """What single parts speak for, kind by kind at as many parts as do, as one hypothesis; None for one kind."""
        starts = self.hinted(hints)
        order = list(dict.fromkeys(name for name, _, _ in hints))
        kinds: list[list[Start]] = []
        for name in order:
            own = [s for s in starts if s[0].name == name]
            widest = max((len(e.site.targets) for e, _, _ in own), default=0)
            if own:
                kinds.append([s for s in own if len(s[0].site.targets) == widest])
        kinds = kinds[:TOGETHER]
        if len(kinds) < 2:
            return None
        self.say("fit", 0.0)
        select = informative_windows(self.fitter, base.fit, FIT_WINDOWS)
        tried: list[tuple[float, Hypothesis, Array]] = []
        for chosen in product(*kinds):
            hypothesis = Hypothesis(tuple(e for e, _, _ in chosen))
            x = np.concatenate([x for _, x, _ in chosen])
            square = self.fitter.mean_square(self.fitter.replay(hypothesis, [(x, base.fit.z)], select)[0], select)
            tried.append((float(self.fitter.data_cost(square, select)), hypothesis, x))
        _, hypothesis, x = min(tried, key=lambda t: t[0])
        fit = self.fitter.fit(hypothesis, x, base.fit.z, ITERATIONS, select=select)
        return self.scores.scored(self.fitter.polish(self.forms.best(fit), rounds=2))

    def paired(self, singles: Sequence[Scored]) -> Scored | None:
        """The best of the best of each kind, two by two; None where there are no two kinds."""
        kinds = {s.fit.hypothesis.effects[0].name: s for s in sorted(singles, key=by_score, reverse=True)}
        chosen = [s.fit for s in sorted(kinds.values(), key=by_score)[:PAIRED]]
        fits: list[Fit] = []
        for one, other in combinations(chosen, 2):
            self.say("fit pairs", len(fits) / math.comb(PAIRED, 2))
            hypothesis = Hypothesis((*one.hypothesis.effects, *other.hypothesis.effects))
            u, neutral = hypothesis.scaled(np.concatenate([one.x, other.x])), hypothesis.vector("neutral")
            # Each by itself does the work of both.
            x = hypothesis.values(0.5 * (u + hypothesis.scaled(neutral)))
            fits.append(self.fitter.fit(hypothesis, x, np.zeros_like(one.z)))
        if not fits:
            return None
        best = sorted(fits, key=lambda fit: fit.cost)[:_PAIRS_ENDED]
        made = min((self.scores.scored(self.fitter.polish(fit, rounds=2)) for fit in best), key=by_score)
        other = self.forms.best(made.fit)
        ended = self.fitter.polish(other) if other is not made.fit else other
        return self.scores.scored(ended) if ended.cost < made.fit.cost else made

    def fitted(self, starts: Sequence[Start], base: Scored) -> list[Scored]:
        """Fits of ``base`` with one effect more, best first."""
        assert self.fitter.nominal is not None
        first = not base.fit.hypothesis.effects
        without = self.fitter.nominal if first else base.fit
        select = informative_windows(self.fitter, without, FIT_WINDOWS)

        def begun(effect: Effect, x: Array, z: Array) -> Fit:
            hypothesis = base.fit.hypothesis.with_effect(effect)
            if first and not self.effort.twice:
                x, z = self._nearest(hypothesis, x, z, select)
            many = hypothesis.size > MANY_PARAMETERS
            return self.fitter.fit(hypothesis, x, z, select=select, roughly=many)

        fits = []
        for i, start in enumerate(starts):
            self.say("fit" if first else "fit partners", i / len(starts))
            fits.append(begun(*start))
        if first and all(f.cost > base.fit.cost - EVIDENCE for f in fits):
            # They contain what they do not beat: perhaps they were begun too far from its nuisances.
            fits += [begun(effect, x, base.fit.z) for effect, x, _ in starts]
        fits = sorted({f.hypothesis.key: f for f in sorted(fits, key=lambda f: -f.cost)}.values(), key=lambda f: f.cost)
        margin = max(HOPELESS, FAR * (without.cost - fits[0].cost)) if fits else HOPELESS
        for i, fit in enumerate(fits):
            # Whoever loses in sample by far need not be scored held out: in sample flatters.
            if i < FINALISTS and fit.cost < fits[0].cost + margin:
                self.fitter.cross_validate(fit)
            else:
                self.fitter.score_in_sample(fit)
        return sorted((self.scores.scored(f) for f in fits), key=by_score)

    def _nearest(self, hypothesis: Hypothesis, x: Array, z: Array, select: Ints) -> tuple[Array, Array]:
        """The best of the start, of the tries on its side, of values between them and of larger ones, by true replays.

        A limit or a stop acts from some value on: from the far side of it, or from far, no slope leads there. Each is
        also tried with untouched nuisances, which may have been bent to make up for a value that is far from right.
        """
        (effect,) = hypothesis.effects
        if not effect.one_size:
            return x, z
        first = effect.parameters[0]
        away = first.away(float(x[0])) or first.scale
        tries = sorted(a / away for t in first.tries if (a := first.away(t)) * np.sign(away) > 0)
        shares = [*tries, *(a + k * (b - a) for a, b in pairwise(tries) for k in (1 / 3, 2 / 3)), *LARGER]
        values = [tuple(x), *(v for k in shares if (v := effect.times(k, x)) is not None)]
        points = [(np.array(v), z) for z in (z, np.zeros_like(z)) for v in values]
        residuals = self.fitter.replay(hypothesis, points, select)
        costs = self.fitter.data_cost(self.fitter.mean_square(residuals, select), select)
        costs = costs + 0.5 * np.array([z @ z for _, z in points])
        return points[int(np.argmin(costs))]

    def finals(
        self,
        singles: list[Scored],
        reference: Scored,
        favourites: Sequence[Screened],
        beside: Sequence[Fit] = (),
        outdone: bool = False,
    ) -> tuple[list[Scored], Scored]:
        """Refit the leaders with sensitivities of their own, the start of windows judged by the leader's model.

        The ``favourites`` of the screening are refitted in any case. Starts are judged by the models of the fits
        ``beside`` as well. ``outdone``: these are so far ahead that only the first of all is refitted.
        """
        fitter = self.fitter
        if not singles:
            return singles, reference
        # Leaders of different kinds, so that no kind is judged by what another forgives.
        kinds = {s.fit.hypothesis.effects[0].name: s.fit for s in reversed(singles[: self.effort.finalists])}
        leaders = (
            sorted(kinds.values(), key=lambda f: f.cost)[: self.effort.leaders]
            if singles[0].score < reference.score
            else []
        )
        models = [fitter.variant(f.hypothesis, f.x, f.z) for f in (reference.fit, *reversed(leaders), *beside)]
        fitter.update_start(*models)
        again = []
        hopeful = singles[:1] if outdone else self._hopeful(singles, reference, favourites)
        for i, scored in enumerate([*hopeful, reference]):
            self.say("finals", i / (len(hopeful) + 1))
            fit = fitter.fit(scored.fit.hypothesis, scored.fit.x, scored.fit.z, iterations=1)
            again.append(self.scores.scored(fitter.polish(fit)))
        reference = again.pop()
        fit = reference.fit
        fitter.refresh(fit.hypothesis, fit.x, fit.z, fit.residual, fitter.moved(fit))
        again.sort(key=by_score)
        keys = {s.key for s in again}
        return again + [s for s in singles if s.key not in keys], reference

    def _hopeful(self, singles: Sequence[Scored], reference: Scored, favourites: Sequence[Screened]) -> list[Scored]:
        """Those to refit: the leaders that are not far behind, the ``favourites``, and the first in other forms."""
        margin = self.hopeless(reference, singles[0])
        found = [s for s in singles[: self.effort.finalists] if s.score < singles[0].score + margin]
        promising = [Hypothesis((f.effect,)).key for f in favourites]
        found += [s for s in singles if s.key in promising and s not in found]
        known = {s.key for s in found}
        return found + [f for s in found[:FAVOURITES] for f in self.forms.of(s.fit) if f.key not in known]

    @staticmethod
    def hopeless(without: Scored, best: Scored) -> float:
        """How far [nats] behind the best of a round a candidate may be and still be refitted."""
        return max(HOPELESS, FAR * (without.score - best.score))

    def to_the_end(self, scored: Scored) -> Scored:
        """A winner fitted to the end."""
        better = self.scores.scored(self.fitter.polish(scored.fit, rounds=self.effort.rounds))
        return better if better.fit.cost <= scored.fit.cost else scored

    def told_apart(self, scored: Scored) -> Scored:
        """A single effect of a robot that lands, numbers that do nearly the same as modelled, if that costs less."""
        fitter, fit = self.fitter, scored.fit
        if not fitter.lands or len(fit.hypothesis.effects) != 1:
            return scored
        x, z = own_moved_into(fitter, fit.hypothesis.effects[0], fit.x, fit.z)
        if np.array_equal(z, fit.z):
            return scored
        better = self.scores.scored(fitter.polish(fitter.fit(fit.hypothesis, x, z, 4)))
        return better if better.fit.cost < fit.cost else scored

    def begun_from(self, scored: Scored, leader: Scored, reach: float) -> Scored:
        """The same effects, fitted anew from a leader's nominal numbers where that takes them further.

        Of many numbers, on rough ground, each start has a valley of its own: who is compared begins where the other is.
        Who is behind the leader there by more than ``reach`` [nats] is not fitted on.
        """
        fit = self.fitter.fit(scored.fit.hypothesis, scored.fit.x, leader.fit.z, roughly=True)
        if fit.cost > min(scored.fit.cost + HOPELESS, leader.fit.cost + reach):
            return scored
        return self._nearer(scored, self.scores.scored(self.fitter.polish(fit)))

    def _nearer(self, one: Scored, other: Scored) -> Scored:
        """Of two ends of one fit the one that costs less."""
        if one.fit.polished:
            self.scores.ends.append(abs(one.fit.cost - other.fit.cost))
        return other if other.fit.cost < one.fit.cost else one

    def without(self, singles: Sequence[Scored], reference: Scored) -> Scored:
        """Nominal numbers alone, begun where those beside effects are, if that takes them further.

        They may stop a hundred nats short of what they can explain, and any effect that leads past it seems to earn it.
        """
        fitter = self.fitter
        self.say("finals", 1.0)
        begun = [fitter.fit(Hypothesis(), np.zeros(0), s.fit.z, roughly=True) for s in singles]
        fit = min(begun, key=lambda f: f.cost, default=reference.fit)
        if fit.cost > reference.fit.cost + HOPELESS:
            return reference
        return self._nearer(reference, self.scores.scored(fitter.polish(fit, rounds=self.effort.rounds)))

    def restarted(self, scored: Scored) -> Scored:
        """A winner, begun anew from values about its own, one at a time, nominal numbers as they are or untouched."""
        fitter, fit = self.fitter, scored.fit
        if fit.hypothesis.size > _SHAKEN_MOST:
            return scored
        u, neutral = fit.hypothesis.scaled(fit.x), fit.hypothesis.scaled(fit.hypothesis.vector("neutral"))
        points = []
        for i, share in product(range(len(fit.x)), SHAKEN):
            moved = u.copy()
            moved[i] = neutral[i] + share * (u[i] - neutral[i])
            points += [(fit.hypothesis.values(moved), z) for z in (fit.z, np.zeros_like(fit.z))]
        costs = fitter.data_cost(fitter.mean_square(fitter.replay(fit.hypothesis, points)))
        costs = costs + 0.5 * np.array([z @ z for _, z in points])
        starts = np.argsort(costs)[:_SHAKEN_STARTS]
        best = min((fitter.fit(fit.hypothesis, *points[i]) for i in starts), key=lambda f: f.cost)
        if best.cost > fit.cost - EVIDENCE:
            return scored
        return self.to_the_end(self.scores.scored(fitter.cross_validate(best)))

    def say(self, stage: str, share: float) -> None:
        """Report progress: ``share`` of a stage is done."""
        if self._progress:
            self._progress(stage, share)


def _parts(effect: Effect, spoken: Sequence[str]) -> list[str]:
    """The parts of an effect's site of which there is one of ``spoken``, parameter by parameter; else none."""
    if len(effect.parameters) == 1:
        return [effect.site.name] if effect.site.name in spoken else []
    found = [max((s for s in spoken if p.name.endswith(f"_{s}")), key=len, default="") for p in effect.parameters]
    return found if all(found) else []
