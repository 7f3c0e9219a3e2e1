"""Where no effect explains enough: is what is left what a link makes that loses commands or delays them unevenly?

Of such a link the competition replays the command that acts on average. What the single commands did stays in the
residual, many noise floors of it, and it has a law: where it is large, how long it lasts, and that all commands are
late together. Here that law is taken for what it predicts, as a likelihood; and once it is known, as noise, beside
which another effect shows that was hidden under it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simgap.effects.base import Effect
from simgap.effects.link import Late
from simgap.inference.hypothesis import Fit
from simgap.inference.link_fit import LinkFit, LinkFitter
from simgap.inference.model_selection import ENOUGH, EVIDENCE, EVIDENCE_MORE, by_chance, indistinct
from simgap.inference.select import Selector
from simgap.inference.selection import Selection
from simgap.inference.structure import REPEATS, predictable_share, repeating_share
from simgap.inference.thresholds import UNEXPLAINED

Array = NDArray[np.float64]

PATTERN = 0.1
"""Share of the residual's power that a regression predicts where there is none to speak of."""
_RARELY = 20
"""One window in so many may be none of chance's."""
_COMPANIONS = 4
"""Sets of effects beside which a link is fitted, at most."""
_STAND_INS = ("link_latency", "servo_delay")
"""Effects that stand in for the mean of a link of chance as long as no such link is there."""


@dataclass(frozen=True)
class _Companions:
    """Effects beside a link, and where their fit begins."""

    effects: tuple[Effect, ...]
    x: Array
    z: Array

    @property
    def key(self) -> str:
        return " + ".join(sorted(repr(e) for e in self.effects))

    def only(self, kept: tuple[Effect, ...]) -> _Companions:
        """Some of them."""
        mine = [e in kept for e in self.effects for _ in e.parameters]
        return _Companions(kept, self.x[np.array(mine, bool)], self.z)


class Chance:
    """Fits links of random lateness with the scatter that they predict, and lets them win where that is right.

    They must be likelier, sample by sample, than an autoregression of any spectrum fitted to what the best hypothesis
    so far leaves: a cause that is none of chance leaves something smoother, or at other times, and loses. And chance
    has no pattern: what the mean leaves must not be predictable from commands and motion, nor come at regular times.
    """

    def __init__(self, selector: Selector) -> None:
        self._selector, self._fitter = selector, selector.fitter
        self._kinds = [e for e in selector.effects if isinstance(e, Late)]

    def reconsider(self, selection: Selection, thorough: bool = True) -> None:
        """Put a random effect in the place of the winner, or beside others, where it is better; edits ``selection``.

        Not ``thorough``, only where the mean of a random link is about the best already, and beside other effects only
        where it is the best.
        """
        selector, best = self._selector, selection.best
        close = best.score + indistinct(selection.reference.score - best.score)
        tied = any(by_chance(s.fit) for s in selection.rivals if s.score < close)
        # What explains as much as an effect should is not doubted.
        enough = UNEXPLAINED if best.fit.hypothesis.effects else ENOUGH
        if not self._kinds or not (tied or (thorough and selector.scores.typical(best.fit.held) > enough)):
            return
        self._links = LinkFitter(self._fitter, best.fit)
        means = {s.key: s.fit.z for s in reversed([*selection.rivals, *selection.singles])}
        rest = np.zeros(len(self._fitter.nuisances))
        alone = [self._links.fit(e, (), np.zeros(0), means.get(e.key, rest)) for e in self._kinds]
        lead, links = self._first_right(alone), alone
        if (thorough or by_chance(best.fit)) and (lead is None or selector.scores.typical(lead.fit.held) > ENOUGH):
            links = alone + [k for c in self._companions(selection, close) for k in self._beside(c)]
            lead = self._first_right(links)
        # Where no link comes near what the best effects leave, it is no noise under which another effect could hide.
        near = any(not k.given_up for k in links)
        if thorough and near and (lead is None or self._leaves_much(lead)):
            more = self._one_more(min(alone, key=self._price), selection)
            first = self._first_right(more)
            if first and (lead is None or self._earns(lead, first)):
                lead, links = first, more
        if lead is None:
            return
        lead, links = self._dropped(lead, links)
        size = len(lead.fit.hypothesis.effects)
        rivals = [k for k in sorted(links, key=self._price) if len(k.fit.hypothesis.effects) == size and k is not lead]
        selection.best = selector.scores.scored(lead.fit)
        selection.rivals = [selection.best, *(selector.scores.scored(k.fit) for k in rivals)]
        # What is beside a link gains over that link alone.
        without = next(k.fit for k in alone if k.effect is lead.effect)
        selection.gains = [self._gain(without, lead.fit)] * (size - 1) + [self._gain(None, lead.fit)]

    def _companions(self, selection: Selection, close: float) -> list[_Companions]:
        """The best effects, those without what may stand in for a link's mean, and those that come close to them."""
        found: dict[str, _Companions] = {}
        for scored in [selection.best, *(r for r in selection.rivals if r.score < close)]:
            whole = _companions_of(scored.fit)
            bare = whole.only(tuple(e for e in whole.effects if e.name not in _STAND_INS))
            for companions in (whole, bare):
                found.setdefault(companions.key, companions)
        return [c for c in found.values() if c.effects][:_COMPANIONS]

    def _beside(self, companions: _Companions) -> list[LinkFit]:
        found = (self._links.beside(e, companions.effects, companions.x, companions.z) for e in self._kinds)
        return [link for link in found if link is not None]

    def _first_right(self, links: list[LinkFit]) -> LinkFit | None:
        return next((k for k in sorted(links, key=self._price) if self._right(k)), None)

    def _leaves_much(self, found: LinkFit) -> bool:
        """Whether there may be something beside a link."""
        return bool(self._selector.scores.typical(found.fit.held) > ENOUGH or found.fit.strained)

    def _price(self, found: LinkFit) -> float:
        """Cost [nats] of a link, with that of having looked for what is beside it."""
        beside = len(found.fit.hypothesis.effects) - 1
        return beside * (EVIDENCE + np.log(len(self._selector.effects))) - self._gain(None, found.fit)[0]

    def _gain(self, without: Fit | None, with_: Fit) -> tuple[float, float, float]:
        """(mean, 5 %, 95 %) [nats] over another link, or over no cause in particular."""
        better = with_.likelihood
        assert better is not None
        if without is None:
            return self._selector.scores.gain(self._links.without, forgiven(self._links.without, better))
        assert without.likelihood is not None
        return self._selector.scores.gain(without.likelihood, better)

    def _right(self, found: LinkFit) -> bool:
        if found.given_up:
            return False
        gain, low, _ = self._gain(None, found.fit)
        beside = len(found.fit.hypothesis.effects) > 1
        likely = gain > EVIDENCE + np.log(len(self._selector.effects)) and low > (EVIDENCE_MORE if beside else 0.0)
        if not likely or predictable_share(self._fitter.residuals, found.left) > PATTERN:
            return False
        return repeating_share(self._fitter.residuals, found.left)[0] < REPEATS

    def _earns(self, without: LinkFit, with_: LinkFit) -> bool:
        """Whether what is beside a link is worth having."""
        gain, low, _ = self._gain(without.fit, with_.fit)
        return bool(gain > EVIDENCE + np.log(len(self._selector.effects)) and low > 0.0)

    def _one_more(self, alone: LinkFit, selection: Selection) -> list[LinkFit]:
        """The links beside the effect that shows best once chance, as the first of them has it, is taken as noise."""
        selector, fitter, residuals = self._selector, self._fitter, self._fitter.residuals
        kept, fit = fitter.jacobian, alone.fit
        residuals.chance = alone.scatter.directions(alone.effect.law(float(fit.x[-1])))
        try:
            fitter.refresh(fit.hypothesis, fit.x, fit.z, fitter.replay(fit.hypothesis, [(fit.x, fit.z)])[0])
            base = selector.scores.scored(fitter.cross_validate(fitter.fit(fit.hypothesis, fit.x, fit.z)))
            result = Selection(base, selection.nominal_gap, base)
            if not selector.add(result, []):
                return []
        finally:
            residuals.chance, fitter.jacobian = None, kept
        companions = _companions_of(result.best.fit)
        return self._beside(companions) if companions.effects else []

    def _dropped(self, lead: LinkFit, links: list[LinkFit]) -> tuple[LinkFit, list[LinkFit]]:
        """The lead without what is beside it and does not earn its place, and all links that it is among then."""
        while len(lead.fit.hypothesis.effects) > 2:
            companions = _companions_of(lead.fit)
            less = []
            for effect in companions.effects:
                less += self._beside(companions.only(tuple(e for e in companions.effects if e is not effect)))
            simpler = self._first_right(less)
            if simpler is None or self._earns(simpler, lead):
                break
            lead, links = simpler, less
        return lead, links


def forgiven(other: Array, cost: Array) -> Array:
    """Costs (nw,) [nats] of windows where one in _RARELY may hold what is no matter of the law, but of the ``other``.

    A law is a few numbers, and the rare event that it gives no chance must not outweigh all that it gets right.
    """
    worst = np.argsort(other - cost)[: len(cost) // _RARELY]
    found = cost.copy()
    found[worst] = np.minimum(cost[worst], other[worst] + np.log(_RARELY))
    return found


def _companions_of(fit: Fit) -> _Companions:
    """The effects of a fit that are no links of chance."""
    whole = _Companions(fit.hypothesis.effects, fit.x, fit.z)
    return whole.only(tuple(e for e in whole.effects if not isinstance(e, Late)))
