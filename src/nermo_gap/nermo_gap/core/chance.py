"""Where no effect explains enough: is what is left what a link makes that loses commands or delays them unevenly?

Of such a link the competition replays the command that acts on average. What the single commands did stays in the
residual, many noise floors of it, and it has a law: where it is large, how long it lasts, and that all commands are
late together. Here that law is taken for what it predicts, as a likelihood.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nermo_gap.core.effects.link import Late
from nermo_gap.core.hypothesis import Fit, Hypothesis
from nermo_gap.core.scatter import Likelihood, Scatter, autoregression_costs
from nermo_gap.core.select import ENOUGH, EVIDENCE, Selection, Selector
from nermo_gap.core.structure import predictable_share

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


class Chance:
    """Fits links of random lateness with the scatter that they predict, and lets them win where that is right.

    They must be likelier, sample by sample, than an autoregression of any spectrum fitted to what the best hypothesis
    so far leaves: a cause that is none of chance leaves something smoother, or at other times, and loses. And chance
    has no pattern: what the mean leaves must not be predictable from commands and motion.
    """

    def __init__(self, selector: Selector) -> None:
        self._selector, self._fitter = selector, selector.fitter
        self._everything = np.ones(len(self._fitter.windows), bool)
        self._samples = np.maximum(self._fitter.count.sum(axis=1), 1.0)
        self._other = np.zeros(len(self._fitter.windows))

    def reconsider(self, selection: Selection) -> None:
        """Put a random effect in the place of the winner where it is better; edits ``selection``."""
        selector, fitter, best = self._selector, self._fitter, selection.best
        effects = [e for e in selector.effects if isinstance(e, Late)]
        mean_only = any(isinstance(e, Late) for e in best.fit.hypothesis.effects)
        if not effects or (selector.scores.typical(best.fit.held) < ENOUGH and not mean_only):
            return
        self._other = autoregression_costs(best.fit.residual.astype(float), self._samples)
        kept = fitter.jacobian
        means = {s.key: s.fit.z for s in reversed([*selection.rivals, *selection.singles])}
        fits = []
        for effect in effects:
            fitter.jacobian = kept.copy()
            fit, left = self._fit(effect, means.get(effect.key, np.zeros(len(fitter.nuisances))))
            assert fit.likelihood is not None
            fits.append((selector.scores.gain(self._other, fit.likelihood), fit, left))
        fitter.jacobian = kept
        fits.sort(key=lambda f: -f[0][0])
        (gain, low, high), fit, left = fits[0]
        likely = gain > EVIDENCE + np.log(len(selector.effects)) and low > 0.0
        if likely and predictable_share(fitter.residuals, left) < PATTERN:
            selection.best = selector.scores.scored(fit)
            selection.rivals = [selector.scores.scored(f) for _, f, _ in fits]
            selection.rivals[0] = selection.best
            selection.gains = [(gain, low, high)]

    def _fit(self, effect: Late, z: Array) -> tuple[Fit, Array]:
        """Fit the parameter and, from ``z``, all nuisances, in rounds; and what the mean leaves, (nw, ns, nl)."""
        fitter, hypothesis = self._fitter, Hypothesis((effect,))
        parameter = effect.parameters[0]
        first = np.array([0.5 * parameter.tries[0], *parameter.tries])
        grid = np.sort(np.concatenate([first, 0.5 * (first[1:] + first[:-1])]))[1:]
        about = float(parameter.tries[1])
        for _ in range(_PASSES):
            law, lag = effect.law(about), effect.lag(fitter.residuals.replayer.aligned.period)
            model = fitter.variant(hypothesis, np.array([about]), z)
            scatter = Scatter(fitter, model, np.array(effect.site.targets), lag, law)
            last = np.inf
            for round_ in range(_ROUNDS):
                x = np.array([about])
                fitter.refresh(hypothesis, x, z, fitter.replay(hypothesis, [(x, z)])[0])
                points = self._points(effect, scatter, grid, z)
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
        return self._scored(hypothesis, effect, scatter, points, z)

    def _points(self, effect: Late, scatter: Scatter, grid: Array, z: Array) -> list[_Point]:
        """Fits of the nuisances at values of the parameter."""
        residuals = self._fitter.replay(Hypothesis((effect,)), [(np.array([v]), z) for v in grid])
        points = []
        for v, residual in zip(grid, residuals, strict=True):
            likelihood = scatter.likelihood(effect.law(float(v)), residual)
            step = likelihood.fitted(z, self._everything)
            cost = float(likelihood.costs(step).sum()) + 0.5 * float((z + step) @ (z + step))
            points.append(_Point(float(v), residual, likelihood, step, cost))
        return points

    def _scored(
        self, hypothesis: Hypothesis, effect: Late, scatter: Scatter, points: list[_Point], z: Array
    ) -> tuple[Fit, Array]:
        """The fit with costs held out, fold by fold; and what the mean leaves. Costs are a parabola about the best."""
        fitter, fold = self._fitter, self._fitter.windows.fold
        best = min(points, key=lambda p: p.cost)
        moved = z + best.step
        curve = np.polyfit([p.x - best.x for p in points], [p.cost for p in points], 2)[0]
        variance = 0.5 / max(curve, 1e-12)
        left = best.residual + np.tensordot(best.step, fitter.jacobian, 1)
        residual = scatter.whiten(effect.law(best.x), left)
        fit = Fit(hypothesis, np.array([best.x]), moved, best.cost, residual, np.zeros((1, *residual.shape)))
        fit.likelihood = best.likelihood.costs(best.step)
        fit.held = fitter.mean_square(residual)
        fold_x, fold_z = [], []
        for f in range(fitter.windows.folds):
            train, test = fold != f, fold == f
            steps = [p.likelihood.fitted(z, train) for p in points]
            costs = [
                float(p.likelihood.costs(s)[train].sum()) + 0.5 * float((z + s) @ (z + s))
                for p, s in zip(points, steps, strict=True)
            ]
            i = int(np.argmin(costs))
            point, step = points[i], steps[i]
            own = scatter.whiten(effect.law(point.x), point.residual + np.tensordot(step, fitter.jacobian, 1))
            fit.held[test] = fitter.mean_square(own)[test]
            fit.likelihood[test] = point.likelihood.costs(step)[test]
            fold_x.append([point.x])
            fold_z.append(z + step)
        fit.held[fold < 0] = np.nan
        fit.fold_x, fit.fold_z, fit.covariance = np.array(fold_x), np.array(fold_z), np.array([[variance]])
        return fit, left
