"""Which hypothesis: a competition on held-out scores, forward selection with swaps."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from nermo_gap.core.effects.base import Effect
from nermo_gap.core.effects.growing import MIN_DURATION, Growing
from nermo_gap.core.fit import Fitter
from nermo_gap.core.hypothesis import Fit, Hypothesis
from nermo_gap.core.nuisance import BOX
from nermo_gap.core.preference import (
    EVIDENCE,
    EVIDENCE_MORE,
    FINALISTS,
    UNEXPLAINED,
    earns,
    indistinct,
    places,
    simplest,
    stands_out,
)
from nermo_gap.core.scores import Scored, Scores
from nermo_gap.core.screen import Screened, informative_windows, screen
from nermo_gap.core.seek import seek

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Progress = Callable[[str, float], None]
Start = tuple[Effect, Array, Array]
"""An effect, its parameters' values, and those of all nuisances."""

ENOUGH = 1.2
"""[noise floors] With no more left than that in a typical window, and no nominal number at the end of its box, no
further effect is looked for."""
SURVIVORS = 10
FIT_WINDOWS = 30
"""Windows in which candidates are fitted; they are scored, and the leaders refitted, in all."""
LARGER = (1.25, 1.6, 2.2)
"""How many times as large an effect is tried before it is fitted, as the screening found it."""
PARTNERS = 6
HOPELESS, FAR = 20.0, 0.3
"""Behind the best by more than so many nats, and by this share of what the best gains, a candidate is not refitted:
fits with the nominal model's sensitivities are that rough."""
FAVOURITES = 2
"""First fits start where nominal numbers hide most of an effect; what the screening ranks so high is refitted."""
LEADERS = 2
"""Kinds of effects about which, beside the nominal model, errors of the windows' start are computed, at most."""
_UNTOUCHED = 3
"""Effects that are also tried beside untouched nominal numbers, where those are bent far."""
MAX_EFFECTS = 3


@dataclass(frozen=True)
class Effort:
    """How much is looked at; a model whose steps cost more gets less."""

    hopeful: int | None = 30
    """Candidates that are screened thoroughly, after a glance at all; None: all of them."""
    survivors: int = SURVIVORS
    """Candidates that are fitted."""
    finalists: int = FINALISTS
    """Candidates that are refitted with sensitivities of their own."""
    leaders: int = LEADERS
    """Kinds of effects about which errors of the windows' start are computed."""
    rounds: int = 3
    """How often the winner is."""
    partners: int = PARTNERS
    """Candidates that are fitted as one effect more."""
    max_effects: int = MAX_EFFECTS
    sought: int = 200
    """Replays in search of a law with more parameters."""


@dataclass
class Selection:
    """What the competition found.

    Attributes:
        reference: nuisances only.
        nominal_gap: held-out gap of the nominal model as it is.
        best: the winner, which is the reference where no effect earns its place.
        singles, rivals: scored fits, best first; rivals are those of the winner's size.
        gains: (mean, 5 %, 95 %) of the score that each accepted effect earned when it was added.
        unrivalled: further effects that took far more than any other would have in their place.
    """

    reference: Scored
    nominal_gap: float
    best: Scored
    singles: list[Scored] = field(default_factory=list)
    rivals: list[Scored] = field(default_factory=list)
    gains: list[tuple[float, float, float]] = field(default_factory=list)
    screened: list[Screened] = field(default_factory=list)
    unrivalled: set[str] = field(default_factory=set)


def _score(scored: Scored) -> float:
    return scored.score


class Selector:
    """Runs the competition on one recording."""

    def __init__(
        self,
        fitter: Fitter,
        effects: Sequence[Effect],
        seed: int = 0,
        progress: Progress | None = None,
        effort: Effort | None = None,
    ) -> None:
        self._effort = effort or Effort()
        self.fitter, self.effects, self._progress = fitter, list(effects), progress
        self.scores = Scores(fitter, seed)
        self._sites = places(self.effects)

    def hidden(self, selection: Selection) -> float:
        """What the data would gain if nominal numbers might be off twice as far, as a share of what the effect gains.

        Their priors stay.
        """
        fit = selection.best.fit
        if fit.likelihood is not None:
            return fit.hidden
        wider = self.fitter.fit(fit.hypothesis, fit.x, fit.z, 4, fit.residual, box=2.0 * BOX)
        return (fit.cost - wider.cost) / max(selection.gains[-1][0], 1e-9)

    def run(self) -> Selection:
        """The whole competition."""
        fitter = self.fitter
        self._say("nuisances", 0.0)
        reference = self.scores.scored(fitter.cross_validate(fitter.fit_nuisances()))
        assert fitter.nominal is not None
        screened = self._screen_about_nominal()
        singles = self._fit_all([(s.effect, s.x, s.z) for s in screened[: self._effort.survivors]], reference)
        singles, reference = self._finals(singles, reference, screened[:FAVOURITES])
        nominal_square = fitter.mean_square(
            fitter.replay(Hypothesis(), [(np.zeros(0), np.zeros(len(fitter.nuisances)))])[0]
        )
        result = Selection(reference, float(self.scores.gaps(nominal_square)[0]), reference, singles, [], [], screened)
        self.nominal_square = nominal_square
        winner = simplest(self.scores, singles, reference, self._sites)
        if winner is not None and earns(self.scores, reference, winner, len(self.effects)):
            singles, winner = self._followed(singles, winner, reference)
            result = self._forward(result, singles, winner, screened)
            if self.scores.typical(result.best.fit.held) > ENOUGH:
                result = self._begun_elsewhere(result, screened)
        elif self.scores.typical(reference.fit.held) > UNEXPLAINED:
            result = self._only_together(result, screened)
        if result.best is reference:
            return result
        self._settle(result)
        self._grow(result)
        return result

    def _forward(
        self, result: Selection, singles: list[Scored], first: Scored, screened: Sequence[Screened]
    ) -> Selection:
        """One effect after the other, beginning with ``first``, as long as that is worth it."""
        gain = self.scores.difference(result.reference.fit, first.fit)
        found = replace(result, best=first, singles=singles, rivals=singles, gains=[gain], unrivalled=set())
        while len(found.best.fit.hypothesis.effects) < self._effort.max_effects:
            enough = self.scores.typical(found.best.fit.held) < ENOUGH and not found.best.fit.strained
            if enough or not self.add(found, screened):
                break
        self._drop(found)
        return found

    def _begun_elsewhere(self, result: Selection, screened: Sequence[Screened]) -> Selection:
        """The same with another first effect, where much is left: the first may only have imitated two others.

        Begun with each of the later ones, which were found beside it.
        """
        full, found = result.best.fit, result
        sizes = np.cumsum([0, *(len(e.parameters) for e in full.hypothesis.effects)])
        for i, effect in enumerate(full.hypothesis.effects[1:], 1):
            own = full.x[sizes[i] : sizes[i + 1]]
            alone = self.fitter.fit(Hypothesis((effect,)), own, np.zeros_like(full.z))
            first = self.scores.scored(self.fitter.polish(alone))
            if not earns(self.scores, result.reference, first, len(self.effects)):
                continue
            other = self._forward(result, result.singles, first, screened)
            more = len(other.best.fit.hypothesis.effects) > len(found.best.fit.hypothesis.effects)
            better = other.best.score < found.best.score - (EVIDENCE_MORE if more else EVIDENCE)
            found, left = (other, found) if better else (found, other)
            if len(left.best.fit.hypothesis.effects) == len(found.best.fit.hypothesis.effects):
                known = {r.key for r in found.rivals}
                found.rivals = sorted([*found.rivals, *(r for r in left.rivals if r.key not in known)], key=_score)
        return found

    def _only_together(self, result: Selection, screened: Sequence[Screened]) -> Selection:
        """Effects of which none earns its place alone, where much is left: each may show only beside the other."""
        found = result
        kinds = {s.fit.hypothesis.effects[0].name: s for s in reversed(result.singles)}
        for first in sorted(kinds.values(), key=_score)[:FAVOURITES]:
            other = self._forward(result, result.singles, first, screened)
            several = len(other.best.fit.hypothesis.effects)
            better = several > 1 and other.best.score < found.best.score
            # So many sets of so many effects could have been found.
            if better and earns(self.scores, result.reference, other.best, len(self.effects) ** several):
                found = other
        return found

    def _screen_about_nominal(self) -> list[Screened]:
        """Screen about the untouched nominal model: the nuisances' best fit may have swallowed half of an effect."""
        fitter = self.fitter
        assert fitter.nominal is not None
        kept, fitter.jacobian = fitter.jacobian, fitter.nominal_jacobian
        screened = screen(
            fitter,
            fitter.nominal,
            self.effects,
            lambda share: self._say("screen", share),
            self._effort.hopeful,
        )
        fitter.jacobian = kept
        return screened

    def _fit_all(self, starts: Sequence[Start], base: Scored) -> list[Scored]:
        """Fits of ``base`` with one effect more, best first."""
        assert self.fitter.nominal is not None
        first = not base.fit.hypothesis.effects
        without = self.fitter.nominal if first else base.fit
        select = informative_windows(self.fitter, without, FIT_WINDOWS)

        def fitted(effect: Effect, x: Array, z: Array) -> Fit:
            hypothesis = base.fit.hypothesis.with_effect(effect)
            x, z = self._nearest(hypothesis, x, z, select) if first else (x, z)
            return self.fitter.fit(hypothesis, np.concatenate([base.fit.x, x]), z, select=select)

        fits = []
        for i, start in enumerate(starts):
            self._say("fit" if first else "fit partners", i / len(starts))
            fits.append(fitted(*start))
        if first and all(f.cost > base.fit.cost - EVIDENCE for f in fits):
            # They contain what they do not beat: perhaps they were begun too far from its nuisances.
            fits += [fitted(effect, x, base.fit.z) for effect, x, _ in starts]
        fits = sorted({f.hypothesis.key: f for f in sorted(fits, key=lambda f: -f.cost)}.values(), key=lambda f: f.cost)
        margin = max(HOPELESS, FAR * (without.cost - fits[0].cost)) if fits else HOPELESS
        for i, fit in enumerate(fits):
            # Whoever loses in sample by far need not be scored held out: in sample flatters.
            if i < FINALISTS and fit.cost < fits[0].cost + margin:
                self.fitter.cross_validate(fit)
            else:
                fit.held = np.where(
                    self.fitter.windows.fold[:, None] >= 0, self.fitter.mean_square(fit.residual), np.nan
                )
        return sorted((self.scores.scored(f) for f in fits), key=_score)

    def _nearest(self, hypothesis: Hypothesis, x: Array, z: Array, select: Ints) -> tuple[Array, Array]:
        """The best of the start, of the tries on its side, of values between them and of larger ones, by true replays.

        A limit or a stop acts from some value on: from the far side of it, or from far, no slope leads there. Each is
        also tried with untouched nuisances, which may have been bent to make up for a value that is far from right.
        """
        (effect,) = hypothesis.effects
        if len(effect.parameters) != 1:
            return x, z
        parameter = effect.parameters[0]
        away = x[0] - parameter.neutral
        tries = sorted(t for t in parameter.tries if (t - parameter.neutral) * np.sign(away) > 0)
        values = [x[0], *tries, *(a + k * (b - a) for a, b in pairwise(tries) for k in (1 / 3, 2 / 3))]
        values += [v for v in parameter.neutral + away * np.array(LARGER) if parameter.low < v < parameter.high]
        points = [(np.array([v]), z) for z in (z, np.zeros_like(z)) for v in values]
        residuals = self.fitter.replay(hypothesis, points, select)
        costs = self.fitter.data_cost(self.fitter.mean_square(residuals, select), select)
        costs = costs + 0.5 * np.array([z @ z for _, z in points])
        return points[int(np.argmin(costs))]

    def _finals(
        self, singles: list[Scored], reference: Scored, favourites: Sequence[Screened]
    ) -> tuple[list[Scored], Scored]:
        """Refit the leaders with sensitivities of their own, the start of windows judged by the leader's model.

        The ``favourites`` of the screening are refitted in any case.
        """
        fitter = self.fitter
        if not singles:
            return singles, reference
        # Leaders of different kinds, so that no kind is judged by what another forgives.
        kinds = {s.fit.hypothesis.effects[0].name: s.fit for s in reversed(singles[: self._effort.finalists])}
        leaders = (
            sorted(kinds.values(), key=lambda f: f.cost)[: self._effort.leaders]
            if singles[0].score < reference.score
            else []
        )
        models = [fitter.variant(f.hypothesis, f.x, f.z) for f in (reference.fit, *reversed(leaders))]
        fitter.update_start(*models)
        again = []
        margin = self._hopeless(reference, singles[0])
        hopeful = [s for s in singles[: self._effort.finalists] if s.score < singles[0].score + margin]
        promising = [Hypothesis((f.effect,)).key for f in favourites]
        hopeful += [s for s in singles if s.key in promising and s not in hopeful]
        known = {s.key for s in hopeful}
        hopeful += [f for s in hopeful[:FAVOURITES] for f in self._forms(s.fit) if f.key not in known]
        for i, scored in enumerate([*hopeful, reference]):
            self._say("finals", i / (len(hopeful) + 1))
            fit = fitter.fit(scored.fit.hypothesis, scored.fit.x, scored.fit.z, iterations=1)
            again.append(self.scores.scored(fitter.polish(fit)))
        reference = again.pop()
        fit = reference.fit
        fitter.refresh(fit.hypothesis, fit.x, fit.z, fit.residual, fitter.moved(fit))
        again.sort(key=_score)
        keys = {s.key for s in again}
        return again + [s for s in singles if s.key not in keys], reference

    def _forms(self, fit: Fit) -> list[Scored]:
        """The same effects, one of them in another form; fitted from the same values.

        Laws of one name are close, and which is the robot's shows only when each is fitted to the end.
        """
        found, effects = [], fit.hypothesis.effects
        for i, effect in enumerate(effects):
            names = [p.name for p in effect.parameters]
            same = [o for o in self.effects if o.key == effect.key and [p.name for p in o.parameters] == names]
            for other in [*(o for o in same if o.form != effect.form), *effect.alternatives()]:
                changed, x = Hypothesis((*effects[:i], other, *effects[i + 1 :])), fit.x
                if changed.size > len(x):
                    x = seek(self.fitter, changed, i, x, fit.z, self._effort.sought)
                found.append(self.scores.scored(self.fitter.cross_validate(self.fitter.fit(changed, x, fit.z))))
        return found

    @staticmethod
    def _hopeless(without: Scored, best: Scored) -> float:
        """How far [nats] behind the best of a round a candidate may be and still be refitted."""
        return max(HOPELESS, FAR * (without.score - best.score))

    def add(self, result: Selection, screened: Sequence[Screened]) -> bool:
        """Try one effect more, then swap the older ones; True where that was worth it."""
        fitter, base = self.fitter, result.best
        fitter.refresh(base.fit.hypothesis, base.fit.x, base.fit.z, base.fit.residual)
        present = {e.key for e in base.fit.hypothesis.effects}
        others = [e for e in self.effects if e.key not in present]
        partners = screen(
            fitter, base.fit, others, lambda share: self._say("screen partners", share), self._effort.hopeful
        )[: self._effort.partners]
        pairs = self._fit_all([(s.effect, s.x, s.z) for s in partners], base)
        if base.fit.strained:
            again = sorted([*pairs, *self._beside_untouched(result)], key=_score, reverse=True)
            pairs = sorted({p.key: p for p in again}.values(), key=_score)
        if not pairs:
            return False
        pairs = self._swap(pairs, screened)
        margin = self._hopeless(base, pairs[0])
        hopeful = [p for p in pairs[:2] if p.score < pairs[0].score + margin]
        # Fits start where the older effect's nominal numbers are, and may stop short.
        promising = {base.fit.hypothesis.with_effect(s.effect).key for s in partners[:FAVOURITES]}
        hopeful += [p for p in pairs if p.key in promising and p not in hopeful]
        polished = [self.scores.scored(fitter.polish(p.fit)) for p in hopeful]
        polished += [self.scores.scored(fitter.polish(f.fit)) for f in self._forms(min(polished, key=_score).fit)]
        keys = {p.key for p in polished}
        pairs = sorted([*polished, *(p for p in pairs if p.key not in keys)], key=_score)
        best = simplest(self.scores, pairs, base, self._sites)
        if best is None:
            return False
        unrivalled = stands_out(base.fit, best.fit, pairs)
        if not earns(self.scores, base, best, len(others), unrivalled):
            return False
        if unrivalled:
            result.unrivalled |= {e.key for e in best.fit.hypothesis.effects} - present
        result.gains.append(self.scores.difference(base.fit, best.fit))
        best = self._follow(best)
        pairs = sorted([best, *(p for p in pairs if p.fit.hypothesis is not best.fit.hypothesis)], key=_score)
        result.best, result.rivals = best, pairs
        return True

    def _beside_untouched(self, result: Selection) -> list[Scored]:
        """Fits of one effect more that begin where it was alone, and nominal numbers untouched.

        Those that are bent far may have swallowed it.
        """
        fitter, base, found = self.fitter, result.best.fit, []
        kept, fitter.jacobian, z = fitter.jacobian, fitter.nominal_jacobian.copy(), np.zeros_like(base.z)
        present = {e.key for e in base.hypothesis.effects}
        alone = [s.fit for s in result.singles if s.fit.hypothesis.effects[0].key not in present]
        for i, single in enumerate(alone[:_UNTOUCHED]):
            self._say("fit beside untouched", i / _UNTOUCHED)
            hypothesis = base.hypothesis.with_effect(single.hypothesis.effects[0])
            fit = fitter.fit(hypothesis, np.concatenate([base.x, single.x]), z)
            found.append(self.scores.scored(fitter.cross_validate(fit)))
        fitter.jacobian = kept
        return found

    def _drop(self, result: Selection) -> None:
        """Take out what later effects made needless: the first one found may only have stood in for them."""
        while len(result.best.fit.hypothesis.effects) > 1:
            full = result.best.fit
            starts = np.cumsum([0, *(len(e.parameters) for e in full.hypothesis.effects)])
            without = []
            for i, effect in enumerate(full.hypothesis.effects):
                self._say("drop", i / len(full.hypothesis.effects))
                rest = tuple(e for e in full.hypothesis.effects if e is not effect)
                x = np.delete(full.x, np.arange(starts[i], starts[i + 1]))
                without.append(self.scores.scored(self.fitter.polish(self.fitter.fit(Hypothesis(rest), x, full.z))))
            simpler = min(without, key=_score)
            lost = {e.key for e in full.hypothesis.effects} - {e.key for e in simpler.fit.hypothesis.effects}
            if earns(self.scores, simpler, result.best, len(self.effects), lost <= result.unrivalled):
                result.gains = [self.scores.difference(w.fit, full) for w in without]
                return
            others = result.singles if len(simpler.fit.hypothesis.effects) == 1 else without
            result.rivals = sorted([simpler, *(s for s in others if s.key != simpler.key)], key=_score)
            result.best, result.gains = simpler, [self.scores.difference(result.reference.fit, simpler.fit)]

    def _settle(self, result: Selection) -> None:
        """Fit the winner once more with all nuisance sensitivities its own: its intervals rest on them."""
        old = result.best
        self.fitter.refresh(old.fit.hypothesis, old.fit.x, old.fit.z, old.fit.residual)
        fit = self.fitter.fit(old.fit.hypothesis, old.fit.x, old.fit.z, known=old.fit.residual)
        result.best = self.scores.scored(self.fitter.cross_validate(fit))
        result.rivals = sorted([result.best, *(r for r in result.rivals if r is not old)], key=_score)

    def _grow(self, result: Selection) -> None:
        """Let the parameter of each effect that was found grow with time, where the recording is long enough."""
        duration = self.fitter.residuals.replayer.aligned.duration
        if duration < MIN_DURATION:
            return
        for i, effect in enumerate(result.best.fit.hypothesis.effects):
            if len(effect.parameters) != 1:
                continue
            self._say("growth", i / len(result.best.fit.hypothesis.effects))
            base = result.best
            effects = list(base.fit.hypothesis.effects)
            at = sum(len(e.parameters) for e in effects[: i + 1])
            effects[i] = Growing(effect, duration)
            fit = self.fitter.fit(Hypothesis(tuple(effects)), np.insert(base.fit.x, at, 0.0), base.fit.z)
            grown = self.scores.scored(self.fitter.cross_validate(fit))
            gain, low, _ = self.scores.difference(base.fit, grown.fit)
            if gain > EVIDENCE and low > 0.0:
                result.best = self._follow(grown)

    def _followed(self, scored: list[Scored], winner: Scored, without: Scored) -> tuple[list[Scored], Scored]:
        """Those that cannot be told from the best fitted to the end, best first; and which of them wins then."""
        close = scored[0].score + indistinct(without.score - scored[0].score)
        tied = [i < FINALISTS and (s.score < close or s is winner) for i, s in enumerate(scored)]
        again = sorted((self._follow(s) if t else s for s, t in zip(scored, tied, strict=True)), key=_score)
        chosen = simplest(self.scores, again, without, self._sites)
        assert chosen is not None
        return again, chosen

    def _follow(self, scored: Scored) -> Scored:
        """A winner fitted to the end."""
        better = self.scores.scored(self.fitter.polish(scored.fit, rounds=self._effort.rounds))
        return better if better.fit.cost <= scored.fit.cost else scored

    def _swap(self, pairs: list[Scored], screened: Sequence[Screened]) -> list[Scored]:
        """Replace each older effect of the best pair by the candidates that screened best."""
        lead = pairs[0].fit
        present = {e.key for e in lead.hypothesis.effects}
        spare = [s for s in screened[:PARTNERS] if s.effect.key not in present][:3]
        extra = []
        for position in range(len(lead.hypothesis.effects) - 1):
            sizes = [len(e.parameters) for e in lead.hypothesis.effects]
            parts = np.split(lead.x, np.cumsum(sizes)[:-1])
            for s in spare:
                effects, values = list(lead.hypothesis.effects), list(parts)
                effects[position], values[position] = s.effect, s.x
                fit = self.fitter.fit(Hypothesis(tuple(effects)), np.concatenate(values), lead.z)
                extra.append(self.scores.scored(self.fitter.cross_validate(fit)))
        return sorted([*pairs, *extra], key=_score)

    def _say(self, stage: str, share: float) -> None:
        if self._progress:
            self._progress(stage, share)
