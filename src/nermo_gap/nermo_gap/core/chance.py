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

from nermo_gap.core.effects.base import Effect
from nermo_gap.core.effects.link import Late
from nermo_gap.core.hypothesis import Fit, Hypothesis
from nermo_gap.core.nuisance import BOX
from nermo_gap.core.preference import EVIDENCE, UNEXPLAINED, by_chance, indistinct
from nermo_gap.core.scatter import Likelihood, Scatter, autoregression_costs
from nermo_gap.core.select import ENOUGH, Selection, Selector
from nermo_gap.core.structure import REPEATS, predictable_share, repeating_share

Array = NDArray[np.float64]

_PASSES = 2
"""Responses are computed about the nominal model first, then about what was found with them."""
_ROUNDS = 4
"""At most so many times nuisances and sensitivities are moved to the best value of the parameter."""
_FAR, _HOPELESS = 0.1, 0.5
"""[nats a sample] So far behind no cause in particular, there is no second pass, and no second round of the first."""
_GRID, _FINEST = 5, 0.1
"""Values of the parameter in a round, and how far they go at least, in its scale."""
PATTERN = 0.1
"""Share of the residual's power that a regression predicts where there is none to speak of."""
_SETTLED = 1.0
"""[nats] A round that changes the cost by less is the last."""


@dataclass
class _Point:
    """One value of the parameter."""

    x: float
    residual: Array
    likelihood: Likelihood
    step: Array
    cost: float


@dataclass
class _Found:
    """A link of chance, beside other effects or alone.

    Attributes:
        gain: (mean, 5 %, 95 %) [nats] over no cause in particular.
        left: (nw, ns, nl) what the mean leaves.
    """

    effect: Late
    fit: Fit
    gain: tuple[float, float, float]
    left: Array
    scatter: Scatter


class Chance:
    """Fits links of random lateness with the scatter that they predict, and lets them win where that is right.

    They must be likelier, sample by sample, than an autoregression of any spectrum fitted to what the best hypothesis
    so far leaves: a cause that is none of chance leaves something smoother, or at other times, and loses. And chance
    has no pattern: what the mean leaves must not be predictable from commands and motion, nor come at regular times.
    """

    def __init__(self, selector: Selector) -> None:
        self._selector, self._fitter = selector, selector.fitter
        self._samples = np.maximum(self._fitter.count.sum(axis=1), 1.0)
        self._other, self._without = np.zeros(len(self._fitter.windows)), 0.0

    def reconsider(self, selection: Selection, thorough: bool = True) -> None:
        """Put a random effect in the place of the winner, or beside others, where it is better; edits ``selection``.

        Not ``thorough``, only where the mean of a random link is about the best already, and nothing beside it.
        """
        selector, fitter, best = self._selector, self._fitter, selection.best
        effects = [e for e in selector.effects if isinstance(e, Late)]
        close = best.score + indistinct(selection.reference.score - best.score)
        tied = any(by_chance(s.fit) for s in selection.rivals if s.score < close)
        if not effects or not (tied or (thorough and selector.scores.typical(best.fit.held) > ENOUGH)):
            return
        self._other = autoregression_costs(best.fit.residual.astype(float), self._samples)
        size = np.maximum((best.fit.residual**2).sum(axis=(1, 2)) / self._samples, 1.0)
        self._without = float((0.5 * self._samples * (np.log(size) + 1.0)).sum()) + best.fit.prior
        means = {s.key: s.fit.z for s in reversed([*selection.rivals, *selection.singles])}
        rest = np.zeros(len(fitter.nuisances))
        alone = [self._fit(e, None, means.get(e.key, rest)) for e in effects]
        # What explains as much as an effect should is not doubted.
        doubted = by_chance(best.fit) or selector.scores.typical(best.fit.held) > UNEXPLAINED
        beside = [self._fit(e, best.fit, best.fit.z) for e in effects if doubted and _mine(best.fit).any()]
        links = sorted(alone + beside, key=self._price)
        lead = next((k for k in links if self._right(k)), None)
        if thorough and (lead is None or selector.scores.typical(lead.fit.held) > ENOUGH):
            more = self._one_more(min(alone, key=self._price), selection)
            first = next((k for k in more if self._right(k)), None)
            if first and (lead is None or self._earns(lead, first)):
                lead, links = first, more
        if lead is None:
            return
        rivals = [k for k in links if len(k.fit.hypothesis.effects) == len(lead.fit.hypothesis.effects)]
        selection.best = selector.scores.scored(lead.fit)
        selection.rivals = [selection.best, *(selector.scores.scored(k.fit) for k in rivals if k is not lead)]
        # What is beside a link gains over that link alone.
        without = next(k.fit.likelihood for k in alone if k.effect is lead.effect)
        assert without is not None and lead.fit.likelihood is not None
        own = selector.scores.gain(without, lead.fit.likelihood)
        selection.gains = [own] * (len(lead.fit.hypothesis.effects) - 1) + [lead.gain]

    def _price(self, found: _Found) -> float:
        """Cost [nats] of a link, with that of having looked for what is beside it."""
        beside = len(found.fit.hypothesis.effects) - 1
        return beside * (EVIDENCE + np.log(len(self._selector.effects))) - found.gain[0]

    def _right(self, found: _Found) -> bool:
        gain, low, _ = found.gain
        likely = gain > EVIDENCE + np.log(len(self._selector.effects)) and low > 0.0
        if not likely or predictable_share(self._fitter.residuals, found.left) > PATTERN:
            return False
        return repeating_share(self._fitter.residuals, found.left)[0] < REPEATS

    def _earns(self, without: _Found, with_: _Found) -> bool:
        """Whether what is beside a link is worth having."""
        assert without.fit.likelihood is not None and with_.fit.likelihood is not None
        gain, low, _ = self._selector.scores.gain(without.fit.likelihood, with_.fit.likelihood)
        return bool(gain > EVIDENCE + np.log(len(self._selector.effects)) and low > 0.0)

    def _one_more(self, alone: _Found, selection: Selection) -> list[_Found]:
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
        pair = result.best.fit
        if not _mine(pair).any():
            return []
        links = [self._fit(e, pair, pair.z) for e in selector.effects if isinstance(e, Late)]
        return sorted(links, key=self._price)

    def _fit(self, effect: Late, beside: Fit | None, z: Array) -> _Found:
        """Fit the parameter and, from ``z``, all nuisances, in rounds; effects of ``beside`` stay as they are there."""
        fitter, x = self._fitter, np.zeros(0)
        others: tuple[Effect, ...] = ()
        if beside is not None:
            others, x = tuple(e for e in beside.hypothesis.effects if not isinstance(e, Late)), beside.x[_mine(beside)]
        hypothesis = Hypothesis((*others, effect))
        parameter, kept = effect.parameters[0], fitter.jacobian
        fitter.jacobian = kept.copy()
        first = np.array([0.5 * parameter.tries[0], *parameter.tries])
        grid = np.sort(np.concatenate([first, 0.5 * (first[1:] + first[:-1])]))[1:]
        about = float(parameter.tries[1])
        for _ in range(_PASSES):
            law, lag = effect.law(about), effect.lag(fitter.residuals.replayer.aligned.period)
            model = fitter.variant(hypothesis, np.append(x, about), z)
            scatter = Scatter(fitter, model, np.array(effect.site.targets), lag, law)
            last = np.inf
            for round_ in range(_ROUNDS):
                at = np.append(x, about)
                fitter.refresh(hypothesis, at, z, fitter.replay(hypothesis, [(at, z)])[0])
                points = self._points(hypothesis, effect, scatter, x, grid, z)
                best = min(range(len(points)), key=lambda i: points[i].cost)
                gain, last = last - points[best].cost, points[best].cost
                behind = (last - float(self._other.sum())) / float(self._samples.sum())
                if abs(gain) < _SETTLED or round_ == _ROUNDS - 1 or behind > _HOPELESS:
                    break
                about, z = points[best].x, z + points[best].step
                near = (max(best - 1, 0), min(best + 1, len(points) - 1))
                reach = max(0.6 * max(abs(points[i].x - about) for i in near), _FINEST * parameter.scale)
                low, high = max(about - reach, parameter.low + 0.02 * reach), min(about + reach, parameter.high)
                grid = np.linspace(low, high, _GRID)
            if behind > _FAR:
                break
        fit, left = self._scored(hypothesis, effect, scatter, x, points, z)
        fitter.jacobian = kept
        if beside is not None:
            mine, n = _mine(beside), len(x)
            fit.covariance[:n, :n] = beside.covariance[np.ix_(mine, mine)]
            fit.fold_x[:, :n] = beside.fold_x[:, mine]
        assert fit.likelihood is not None
        return _Found(effect, fit, self._selector.scores.gain(self._other, fit.likelihood), left, scatter)

    def _points(
        self, hypothesis: Hypothesis, effect: Late, scatter: Scatter, x: Array, grid: Array, z: Array
    ) -> list[_Point]:
        """Fits of the nuisances at values of the parameter."""
        residuals = self._fitter.replay(hypothesis, [(np.append(x, v), z) for v in grid])
        everything, points = np.ones(len(self._samples), bool), []
        for v, residual in zip(grid, residuals, strict=True):
            likelihood = scatter.likelihood(effect.law(float(v)), residual)
            point = _Point(float(v), residual, likelihood, likelihood.fitted(z, everything), 0.0)
            point.cost = float(likelihood.costs(point.step).sum())
            point.cost += 0.5 * float((z + point.step) @ (z + point.step))
            points.append(point)
        return points

    def _costs(self, effect: Late, scatter: Scatter, point: _Point, step: Array) -> tuple[Array, Array]:
        """Residuals in units of noise and chance, nuisances moved by ``step``, and the cost (nw,) [nats] of windows.

        What is left beside chance may be of any spectrum, as it may for whom it competes with.
        """
        left = point.residual + np.tensordot(step, self._fitter.jacobian, 1)
        white = scatter.whiten(effect.law(point.x), left)
        return white, autoregression_costs(white, self._samples) + point.likelihood.volume

    def _scored(
        self, hypothesis: Hypothesis, effect: Late, scatter: Scatter, x: Array, points: list[_Point], z: Array
    ) -> tuple[Fit, Array]:
        """The fit with costs held out, fold by fold; and what the mean leaves. Costs are a parabola about the best."""
        fitter, fold, n = self._fitter, self._fitter.windows.fold, len(x)
        best = min(points, key=lambda p: p.cost)
        curve = np.polyfit([p.x - best.x for p in points], [p.cost for p in points], 2)[0]
        residual, likelihood = self._costs(effect, scatter, best, best.step)
        value = np.append(x, best.x)
        fit = Fit(hypothesis, value, z + best.step, best.cost, residual, np.zeros((n + 1, *residual.shape)))
        fit.held, fold_x, fold_z = fitter.mean_square(residual), [], []
        for f in range(fitter.windows.folds):
            train, test = fold != f, fold == f
            steps = [p.likelihood.fitted(z, train) for p in points]
            costs = [
                float(p.likelihood.costs(s)[train].sum()) + 0.5 * float((z + s) @ (z + s))
                for p, s in zip(points, steps, strict=True)
            ]
            i = int(np.argmin(costs))
            white, cost = self._costs(effect, scatter, points[i], steps[i])
            fit.held[test], likelihood[test] = fitter.mean_square(white)[test], cost[test]
            fold_x.append(np.append(x, points[i].x))
            fold_z.append(z + steps[i])
        fit.held[fold < 0] = np.nan
        further = best.likelihood.fitted(z, np.ones(len(fold), bool), 2.0 * BOX)
        wider = float(best.likelihood.costs(further).sum()) + 0.5 * float((z + further) @ (z + further))
        fit.hidden = (best.cost - wider) / max(self._without - best.cost, 1e-9)
        fit.likelihood = likelihood
        fit.fold_x, fit.fold_z, fit.covariance = np.array(fold_x), np.array(fold_z), np.zeros((n + 1, n + 1))
        fit.covariance[n, n] = 0.5 / max(curve, 1e-12)
        return fit, best.residual + np.tensordot(best.step, fitter.jacobian, 1)


def _mine(fit: Fit) -> Array:
    """Which of a fit's parameters are those of effects that are no links of chance."""
    late = [isinstance(e, Late) for e in fit.hypothesis.effects for _ in e.parameters]
    return ~np.array(late, bool)
