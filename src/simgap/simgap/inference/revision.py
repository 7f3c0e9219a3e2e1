"""What was found, looked at again: which effects later ones made needless, and which grow over the recording."""

from __future__ import annotations

import math

import numpy as np

from simgap.effects.growing import MIN_DURATION, Growing
from simgap.inference.candidates import FIT_WINDOWS, MANY_PARAMETERS, Candidates, by_score
from simgap.inference.hypothesis import Hypothesis
from simgap.inference.model_selection import EVIDENCE, EVIDENCE_MORE, earns
from simgap.inference.scores import Scored, Scores
from simgap.inference.screen import informative_windows
from simgap.inference.selection import Selection

_FAR_BEHIND = 5.0
"""Times what a further effect must earn [nats] by which, in sample, a set without one of its effects is hopeless."""
_BY_CHANCE = 2.0 * math.sqrt(2.0)
"""Standard deviations of a cost: two of a difference."""


class Revision:
    """Takes out and extends effects of what a competition found, on one recording."""

    def __init__(self, candidates: Candidates, scores: Scores) -> None:
        self._candidates, self._scores = candidates, scores
        self._fitter, self._effects = candidates.fitter, candidates.effects

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
                fit = self._fitter.fit(Hypothesis(rest), x, full.z, select=select)
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

    def grow(self, result: Selection) -> None:
        """Let the parameter of each effect that was found grow with time, where the recording is long enough."""
        duration = self._fitter.residuals.replayer.aligned.duration
        if duration < MIN_DURATION:
            return
        for i, effect in enumerate(result.best.fit.hypothesis.effects):
            if len(effect.parameters) != 1:
                continue
            self._candidates.say("growth", i / len(result.best.fit.hypothesis.effects))
            base = result.best
            effects = list(base.fit.hypothesis.effects)
            at = sum(len(e.parameters) for e in effects[: i + 1])
            effects[i] = Growing(effect, duration)
            fit = self._fitter.fit(Hypothesis(tuple(effects)), np.insert(base.fit.x, at, 0.0), base.fit.z)
            grown = self._scores.scored(self._fitter.cross_validate(fit))
            gain, low, _ = self._scores.difference(base.fit, grown.fit)
            # What it has not seen it cannot foresee better than what it has; the rest is chance, as much as that shows.
            gain = min(gain, base.fit.cost - grown.fit.cost)
            if gain > EVIDENCE + _BY_CHANCE * self._scores.roughness and low > 0.0:
                result.best = self._candidates.to_the_end(grown)
