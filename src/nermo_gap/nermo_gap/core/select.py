"""Which hypothesis: the one-standard-error rule on held-out scores, forward selection with swaps."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from nermo_gap.core.effects.base import Effect
from nermo_gap.core.effects.growing import MIN_DURATION, Growing
from nermo_gap.core.effects.link import Late
from nermo_gap.core.fit import Fitter
from nermo_gap.core.hypothesis import Fit, Hypothesis
from nermo_gap.core.nuisance import BOX
from nermo_gap.core.scores import PER_PARAMETER, Scored, Scores
from nermo_gap.core.screen import Screened, informative_windows, screen

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Progress = Callable[[str, float], None]

EVIDENCE = 4.0
"""An effect must earn this many nats beyond the price of having looked at many candidates (the log of their number)."""
EVIDENCE_MORE = 16.0
"""Any further effect so many: what the first one's law does not get quite right is cheap for some other to take."""
RELEVANT = 0.10
"""An effect must take at least this share of the gap (or as much strain off the priors as EVIDENCE)."""
MORE = 0.3
"""Any further effect must take this share of what the typical window is left with above the noise floor."""
ENOUGH = 1.2
"""[noise floors] With no more left than that in a typical window, and no nominal number at the end of its box, no
further effect is looked for."""
UNEXPLAINED = 2.0
"""[noise floors] An effect that is the cause leaves a typical window with no more."""
TIE = 0.5
"""[nats] Closer than this, two hypotheses predict the same."""
CLOSE, LEAD = 3.0, 0.1
"""Rivals nearer than so many nats, or than this share of what the winner explains, are not told apart, whatever the
bootstrap says: no effect of a library is quite what a robot has, and the wrong one may bend a little better."""
SURVIVORS = 10
FINALISTS = 5
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


@dataclass
class Selection:
    """What the competition found.

    Attributes:
        reference: nuisances only.
        nominal_gap: held-out gap of the nominal model as it is.
        best: the winner, which is the reference where no effect earns its place.
        singles, rivals: scored fits, best first; rivals are those of the winner's size.
        gains: (mean, 5 %, 95 %) of the score that each accepted effect earned when it was added.
    """

    reference: Scored
    nominal_gap: float
    best: Scored
    singles: list[Scored] = field(default_factory=list)
    rivals: list[Scored] = field(default_factory=list)
    gains: list[tuple[float, float, float]] = field(default_factory=list)
    screened: list[Screened] = field(default_factory=list)


def _score(scored: Scored) -> float:
    return scored.score


def indistinct(gain: float) -> float:
    """How far [nats] behind a winner that gains ``gain`` a rival is not told from it."""
    return max(CLOSE, LEAD * gain)


def _extremities(fit: Fit) -> Array:
    """How far each parameter of a fit is from neutral, in its strongest try."""
    away: Array = np.abs(fit.x - fit.hypothesis.vector("neutral")) / np.maximum(fit.hypothesis.vector("strong"), 1e-300)
    return away


def _kinds(fit: Fit) -> list[str]:
    return sorted(e.name for e in fit.hypothesis.effects)


def by_chance(fit: Fit) -> bool:
    """Whether an effect of a fit is a matter of chance."""
    return any(isinstance(e, Late) for e in fit.hypothesis.effects)


def special_case(simple: Fit, rich: Fit) -> bool:
    """Whether two fits differ in one effect, at one site, whose law the rich one generalises."""
    one = {(e.name, e.site.name) for e in simple.hypothesis.effects}
    two = {(e.name, e.site.name) for e in rich.hypothesis.effects}
    lost, gained = one - two, two - one
    return len(lost) == len(gained) == 1 and any(
        (a[0], b[0]) in _CONTAINS and a[1] == b[1] for a in lost for b in gained
    )


def _parts(fit: Fit) -> int:
    """How many parts of the robot the effects of a fit change."""
    return sum(len(e.site.targets) for e in fit.hypothesis.effects)


_CONTAINS = {("coulomb_friction", "stribeck_friction")}
"""(special case, law)."""


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
        singles = self._fit_all([(Hypothesis((s.effect,)), s) for s in screened[: self._effort.survivors]], "fit")
        singles, reference = self._finals(singles, reference, screened[:FAVOURITES])
        nominal_square = fitter.mean_square(
            fitter.replay(Hypothesis(), [(np.zeros(0), np.zeros(len(fitter.nuisances)))])[0]
        )
        result = Selection(reference, float(self.scores.gaps(nominal_square)[0]), reference, singles, [], [], screened)
        self.nominal_square = nominal_square
        winner = self._simplest(singles, reference)
        if winner is None or not self._earns(reference, winner, len(self.effects)):
            return result
        winner = self._follow(winner)
        singles = sorted([winner, *(s for s in singles if s.fit.hypothesis is not winner.fit.hypothesis)], key=_score)
        result.best, result.rivals = winner, singles
        result.gains.append(self.scores.difference(reference.fit, winner.fit))
        while len(result.best.fit.hypothesis.effects) < self._effort.max_effects:
            enough = self.scores.typical(result.best.fit.held) < ENOUGH and not result.best.fit.strained
            if enough or not self.add(result, screened):
                break
        self._drop(result)
        self._settle(result)
        self._grow(result)
        return result

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

    def _fit_all(
        self, jobs: Sequence[tuple[Hypothesis, Screened]], label: str, base: Fit | None = None
    ) -> list[Scored]:
        fits = []
        assert self.fitter.nominal is not None
        select = informative_windows(self.fitter, self.fitter.nominal if base is None else base, FIT_WINDOWS)
        for i, (hypothesis, start) in enumerate(jobs):
            self._say(label, i / len(jobs))
            own, z = self._nearest(hypothesis, start, select) if base is None else (start.x, start.z)
            x = own if base is None else np.concatenate([base.x, own])
            fits.append(self.fitter.fit(hypothesis, x, z, select=select))
        fits.sort(key=lambda f: f.cost)
        without = self.fitter.nominal if base is None else base
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

    def _nearest(self, hypothesis: Hypothesis, start: Screened, select: Ints) -> tuple[Array, Array]:
        """The best of the start, of values between the tries on its side and of larger ones, by true replays.

        A limit or a stop acts from some value on: from the far side of it, or from far, no slope leads there. Each is
        also tried with untouched nuisances, which may have been bent to make up for a value that is far from right.
        """
        (effect,) = hypothesis.effects
        if len(effect.parameters) != 1:
            return start.x, start.z
        parameter = effect.parameters[0]
        away = start.x[0] - parameter.neutral
        tries = sorted(t for t in parameter.tries if (t - parameter.neutral) * np.sign(away) > 0)
        values = [start.x[0], *(a + k * (b - a) for a, b in pairwise(tries) for k in (1 / 3, 2 / 3))]
        values += [v for v in parameter.neutral + away * np.array(LARGER) if parameter.low < v < parameter.high]
        points = [(np.array([v]), z) for z in (start.z, np.zeros_like(start.z)) for v in values]
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
            for other in self.effects:
                same = other.key == effect.key and [p.name for p in other.parameters] == names
                if same and other.form != effect.form:
                    changed = Hypothesis((*effects[:i], other, *effects[i + 1 :]))
                    found.append(self.scores.scored(self.fitter.cross_validate(self.fitter.fit(changed, fit.x, fit.z))))
        return found

    @staticmethod
    def _hopeless(without: Scored, best: Scored) -> float:
        """How far [nats] behind the best of a round a candidate may be and still be refitted."""
        return max(HOPELESS, FAR * (without.score - best.score))

    def _simplest(self, scored: Sequence[Scored], without: Scored) -> Scored | None:
        """One-standard-error rule: of those within one standard error of the best, the one with fewest parameters.

        And of the same effects at fewer parts, any that cannot be told from it: values for joints that have nothing
        take up what nominal numbers are off, and so seem to earn a little. Likewise the special case of a law before
        the law, and before a link of chance what is late without it: chance has to show (`Chance`).
        """
        if not scored:
            return None
        best = scored[0]
        chosen = best
        for rival in scored[1:FINALISTS]:
            gain = self.scores.costs(rival.fit) - self.scores.costs(best.fit)
            simpler = rival.fit.hypothesis.size < chosen.fit.hypothesis.size
            if simpler and gain[0] <= float(gain[1:].std()) + PER_PARAMETER:
                chosen = rival
        close = best.score + indistinct(without.score - best.score)
        for rival in scored[1:FINALISTS]:
            if _kinds(rival.fit) == _kinds(chosen.fit) and _parts(rival.fit) < _parts(chosen.fit):
                chosen = rival if rival.score < close else chosen
        # Names for the same change: the one at fewer parts, or that has to be less extreme.
        for rival in scored[1:FINALISTS]:
            same = rival.fit.hypothesis.size == chosen.fit.hypothesis.size and rival.score < chosen.score + TIE
            fewer = _parts(rival.fit) - _parts(chosen.fit)
            milder = _extremities(rival.fit).max(initial=0.0) < 0.7 * _extremities(chosen.fit).max(initial=0.0)
            if same and (fewer < 0 or (fewer == 0 and milder)):
                chosen = rival
        for rival in scored[1:FINALISTS]:
            law = rival.score < close and special_case(rival.fit, chosen.fit)
            sure = rival.score < chosen.score + CLOSE and by_chance(chosen.fit) and not by_chance(rival.fit)
            if law or sure:
                chosen = rival
        return chosen

    def _earns(self, without: Scored, with_: Scored, looked_at: int) -> bool:
        """Whether the larger hypothesis is worth having.

        Of one effect more, a good part of what is left above the noise floor is asked: nothing is quite as its model
        says (a friction's law, a servo's), and there is always some effect that takes a little of that.
        """
        gain, low, _ = self.scores.difference(without.fit, with_.fit)
        if without.fit.likelihood is None and with_.fit.likelihood is None:
            # In sample flatters: what is not earned there is an accident of the folds.
            gain = min(gain, without.fit.cost - with_.fit.cost)
        before, after = (self.scores.typical(s.fit.held) for s in (without, with_))
        strain = without.fit.prior - with_.fit.prior
        if without.fit.hypothesis.effects:
            relevant = after - 1.0 < (1.0 - MORE) * (before - 1.0)
            relevant |= bool(without.fit.strained) and strain > EVIDENCE
        else:
            left = 1.0 - RELEVANT
            relevant = with_.gap < left * without.gap or after < left * before or strain > EVIDENCE
        evidence = EVIDENCE_MORE if without.fit.hypothesis.effects else EVIDENCE
        return gain > evidence + np.log(max(looked_at, 1)) and low > 0.0 and relevant

    def add(self, result: Selection, screened: Sequence[Screened]) -> bool:
        """Try one effect more, then swap the older ones; True where that was worth it."""
        fitter, base = self.fitter, result.best
        fitter.refresh(base.fit.hypothesis, base.fit.x, base.fit.z, base.fit.residual, fitter.moved(base.fit))
        present = {e.key for e in base.fit.hypothesis.effects}
        others = [e for e in self.effects if e.key not in present]
        partners = screen(
            fitter, base.fit, others, lambda share: self._say("screen partners", share), self._effort.hopeful
        )
        jobs = [(base.fit.hypothesis.with_effect(s.effect), s) for s in partners[: self._effort.partners]]
        pairs = self._fit_all(jobs, "fit partners", base.fit)
        if not pairs:
            return False
        pairs = self._swap(pairs, screened)
        margin = self._hopeless(base, pairs[0])
        polished = [self.scores.scored(fitter.polish(p.fit)) for p in pairs[:2] if p.score < pairs[0].score + margin]
        polished += [self.scores.scored(fitter.polish(f.fit)) for f in self._forms(min(polished, key=_score).fit)]
        keys = {p.key for p in polished}
        pairs = sorted([*polished, *(p for p in pairs if p.key not in keys)], key=_score)
        best = self._simplest(pairs, base)
        if best is None or not self._earns(base, best, len(others)):
            return False
        result.gains.append(self.scores.difference(base.fit, best.fit))
        best = self._follow(best)
        pairs = sorted([best, *(p for p in pairs if p.fit.hypothesis is not best.fit.hypothesis)], key=_score)
        result.best, result.rivals = best, pairs
        return True

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
            if self._earns(simpler, result.best, len(self.effects)):
                result.gains = [self.scores.difference(w.fit, full) for w in without]
                return
            others = result.singles if len(simpler.fit.hypothesis.effects) == 1 else without
            result.rivals = sorted([simpler, *(s for s in others if s.key != simpler.key)], key=_score)
            result.best, result.gains = simpler, [self.scores.difference(result.reference.fit, simpler.fit)]

    def _settle(self, result: Selection) -> None:
        """Fit the winner once more with all nuisance sensitivities its own: its intervals rest on them."""
        old = result.best
        self.fitter.refresh(old.fit.hypothesis, old.fit.x, old.fit.z, old.fit.residual, self.fitter.moved(old.fit))
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
