"""What was found, looked at again: what later effects made needless, what differs from part to part, what grows."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from simgap.effects.base import ByPart
from simgap.effects.growing import MIN_DURATION, Growing
from simgap.inference.candidates import FIT_WINDOWS, HOPELESS, MANY_PARAMETERS, Candidates, by_score
from simgap.inference.hypothesis import Fit, Hypothesis
from simgap.inference.model_selection import EVIDENCE, EVIDENCE_MORE, earns
from simgap.inference.scores import Scored, Scores
from simgap.inference.screen import informative_windows
from simgap.inference.selection import Selection

Array = NDArray[np.float64]

_FAR_BEHIND = 5.0
"""Times what a further effect must earn [nats] by which, in sample, a set without one of its effects is hopeless."""
_NEAR = 2
"""Rivals, at most, whose parts are given values of their own."""
_BY_CHANCE = 2.0 * math.sqrt(2.0)
"""Standard deviations of a cost: two of a difference."""


class Revision:
    """Takes out and extends effects of what a competition found, on one recording."""

    def __init__(self, candidates: Candidates, scores: Scores) -> None:
        self._candidates, self._scores = candidates, scores
        self._fitter, self._effects = candidates.fitter, candidates.effects
        self._ended: dict[str, tuple[Array, Array]] = {}
        """(x, z) where fits without one of the effects ended when these were last looked at."""

    def drop(self, result: Selection) -> None:
        """Take out what later effects made needless: the first one found may only have stood in for them."""
        while len(result.best.fit.hypothesis.effects) > 1:
            full = result.best.fit
            starts = np.cumsum([0, *(len(e.parameters) for e in full.hypothesis.effects)])
            without = []
            for i, effect in enumerate(full.hypothesis.effects):
                self._candidates.say("drop", i / len(full.hypothesis.effects))
                rest = tuple(e for e in full.hypothesis.effects if e is not effect)
                x = np.delete(full.x, np.arange(starts[i], starts[i + 1]))
                select = informative_windows(self._fitter, full, FIT_WINDOWS) if len(x) > MANY_PARAMETERS else None
                fit = self._fitter.fit(Hypothesis(rest), *self._begun(Hypothesis(rest), x, full.z), select=select)
                self._ended[fit.hypothesis.key] = fit.x, fit.z
                # What lacks so much is not brought back by fitting on.
                far = fit.cost - full.cost > _FAR_BEHIND * EVIDENCE_MORE
                without.append(self._scores.scored((self._fitter.cross_validate if far else self._fitter.polish)(fit)))
            which = min(range(len(without)), key=lambda i: without[i].score)
            simpler = without[which]
            if self._needed(result, which, simpler):
                result.gains = [self._scores.difference(w.fit, full) for w in without]
                return
            others = result.singles if len(simpler.fit.hypothesis.effects) == 1 else without
            result.rivals = sorted([simpler, *(s for s in others if s.key != simpler.key)], key=by_score)
            result.best, result.gains = simpler, [self._scores.difference(result.reference.fit, simpler.fit)]

    def _begun(self, hypothesis: Hypothesis, x: Array, z: Array) -> tuple[Array, Array]:
        """Where a fit without one effect begins: at (x, z), or where it ended when it was looked at before."""
        ended = self._ended.get(hypothesis.key)
        if ended is None:
            return x, z
        points = [(x, z), ended]
        squares = self._fitter.mean_square(self._fitter.replay(hypothesis, points))
        prior = [0.5 * float(z @ z) + hypothesis.tied(x) for x, z in points]
        return points[int(np.argmin(self._fitter.data_cost(squares) + prior))]

    def _needed(self, result: Selection, which: int, simpler: Scored) -> bool:
        """Whether effect number ``which`` earns its place over what is ``simpler`` without it, in any of its forms.

        The form that predicts best may do so by much in some pieces of a recording and lose a little in others.
        """
        full = result.best
        unrivalled = full.fit.hypothesis.effects[which].key in result.unrivalled
        first = self._scores.difference(result.reference.fit, simpler.fit)[0]

        def earned(with_: Scored) -> bool:
            return earns(self._scores, simpler, with_, len(self._effects), unrivalled, first)

        hopeful = simpler.score - full.score > EVIDENCE_MORE
        return earned(full) or (hopeful and any(map(earned, self._candidates.forms.others(full.fit, which))))

    def part(self, result: Selection) -> None:
        """Give the parts of effects values of their own, tied to a common one, if that is worth it.

        In robots of few joints they have them from the beginning. Of the winner, and of those that are near: where
        parts differ, one value for all is behind, and what is near may be the same under another name.
        """
        near = [r for r in result.rivals if r is not result.best and r.score < result.best.score + HOPELESS]
        known = [result.best, *near[:_NEAR]]
        parted = [self._parted(scored, i / len(known)) for i, scored in enumerate(known)]
        leader = min(parted, key=by_score)
        gain, low, _ = self._scores.difference(parted[0].fit, leader.fit)
        best = leader if gain > EVIDENCE + _BY_CHANCE * self._scores.roughness and low > 0.0 else parted[0]
        if best is result.best:
            return
        result.best = best
        others = [*parted, *(r for r in result.rivals if r not in known)]
        # Effects of one kind at the same parts, together, are what was found under other names.
        others = [r for r in others if _everywhere(r) != _everywhere(best)]
        result.rivals = sorted([best, *others], key=by_score)
        effects = best.fit.hypothesis.effects
        if len(effects) == 1:
            result.gains = [self._scores.difference(result.reference.fit, best.fit)]
        elif len(effects) != len(result.gains) or best is not parted[0]:
            self.drop(result)  # which says what each of them gains

    def _parted(self, scored: Scored, share: float) -> Scored:
        """A fit whose effects of a kind have values of their own for each part, where that earns its place."""
        for kind in dict.fromkeys(e.name for e in scored.fit.hypothesis.effects if isinstance(e, ByPart)):
            made = self._by_part(scored.fit, kind)
            if made is None:
                continue
            self._candidates.say("parts", share)
            if len(made[0].effects) == len(scored.fit.hypothesis.effects):
                scored = self._extended(scored, *made)
                continue
            # Several of one kind, which together are at all parts of a group, are one that differs from part to part.
            fit = self._fitter.fit(*made, scored.fit.z)
            one = self._scores.scored(self._fitter.polish(fit))
            scored = one if one.score < scored.score + EVIDENCE else scored
        return scored

    def _by_part(self, fit: Fit, kind: str) -> tuple[Hypothesis, Array] | None:
        """A hypothesis with one effect of a kind at all its parts, with values of their own, and those of a fit."""
        effects = list(fit.hypothesis.effects)
        values = np.split(fit.x, np.cumsum([len(e.parameters) for e in effects])[:-1])
        which = [i for i, e in enumerate(effects) if e.name == kind]
        first = effects[which[0]]
        targets = sorted({t for i in which for t in effects[i].site.targets})
        alike = all(effects[i].form == first.form and len(values[i]) == 1 for i in which)
        wholes = [e for e in self._effects if e.name == kind and sorted(e.site.targets) == targets]
        laws = [law for e in wholes for law in (e, *e.alternatives()) if law.form == first.form]
        law = next((law for law in laws if len(law.parameters) == 1), None)
        if not alike or not isinstance(law, ByPart):
            return None
        parameter = law.parameters[0]
        away = [
            sum(parameter.away(float(values[i][0])) for i in which if target in effects[i].site.targets)
            for target in law.site.targets
        ]
        apart = law.apart(self._effects, parameter.at(float(np.mean(away))))
        if apart is None:
            return None
        effects[which[0]], values[which[0]] = apart, np.array([parameter.at(a) for a in away])
        kept = [i for i in range(len(effects)) if i not in which[1:]]
        return Hypothesis(tuple(effects[i] for i in kept)), np.concatenate([values[i] for i in kept])

    def grow(self, result: Selection) -> None:
        """Let the parameter of each effect that was found grow with time, where the recording is long enough."""
        duration = self._fitter.residuals.replayer.aligned.duration
        if duration < MIN_DURATION:
            return
        for i, effect in enumerate(result.best.fit.hypothesis.effects):
            if len(effect.parameters) != 1:
                continue
            self._candidates.say("growth", i / len(result.best.fit.hypothesis.effects))
            fit = result.best.fit
            effects = list(fit.hypothesis.effects)
            at = sum(len(e.parameters) for e in effects[: i + 1])
            effects[i] = Growing(effect, duration)
            result.best = self._extended(result.best, Hypothesis(tuple(effects)), np.insert(fit.x, at, 0.0))

    def _extended(self, base: Scored, hypothesis: Hypothesis, x: Array) -> Scored:
        """What contains ``base`` and begins as it, fitted to its end, where that earns its place; else ``base``."""
        fit = self._fitter.fit(hypothesis, x, base.fit.z)
        more = self._scores.scored(self._fitter.cross_validate(fit))
        gain, low, _ = self._scores.difference(base.fit, more.fit)
        # What it has not seen it cannot foresee better than what it has; the rest is chance, as much as that shows.
        gain = min(gain, base.fit.cost - fit.cost)
        worth = gain > EVIDENCE + _BY_CHANCE * self._scores.roughness and low > 0.0
        return self._candidates.to_the_end(more) if worth else base


def _everywhere(scored: Scored) -> dict[str, set[int]]:
    """The parts at which effects act, by their kind."""
    found: dict[str, set[int]] = {}
    for effect in scored.fit.hypothesis.effects:
        found.setdefault(effect.name, set()).update(effect.site.targets)
    return found
