"""Fitting a link of random lateness, alone or beside other effects, by the likelihood of what its law predicts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simgap.effects.base import Effect
from simgap.effects.link import Late
from simgap.inference.fit import Fitter
from simgap.inference.hypothesis import Fit, Hypothesis
from simgap.inference.nuisance import BOX
from simgap.inference.scatter import Likelihood, Room, Scatter, autoregression_costs

Array = NDArray[np.float64]

_PASSES = 2
"""Responses are computed about the nominal model first, then about what was found with them."""
_ROUNDS = 4
"""At most so many times all numbers and sensitivities are moved to the best value of the link's parameter."""
_FAR, _HOPELESS = 0.1, 0.5
"""[nats a sample] So far behind no cause in particular, or the best link so far, there is no second pass, and no second
round of the first."""
_GRID, _FINEST = 5, 0.1
"""Values of the parameter in a round, and how far they go at least, in its scale."""
_SETTLED = 1.0
"""[nats] A round that changes the cost by less is the last."""
_REACH = 0.5
"""Share of what is between a parameter of another effect and its neutral value that it may move in a round."""
_LOOSE = 1e-6
"""Precision of what has no prior."""


@dataclass
class LinkFit:
    """A link of chance, beside other effects or alone.

    Attributes:
        effect: the link; the last of the fit's effects.
        left: (nw, ns, nl) what the mean leaves.
        given_up: whether its search was broken off as hopeless: its parameter is then the best of a coarse grid, at the
            end of it as a rule, and the scatter that it predicts no link's.
    """

    effect: Late
    fit: Fit
    left: Array
    scatter: Scatter
    given_up: bool


@dataclass
class _Point:
    """One value of the link's parameter, with the step that suits all other numbers then."""

    x: float
    residual: Array
    likelihood: Likelihood
    step: Array
    cost: float


@dataclass
class _State:
    """Parameters of the other effects, nuisances, and the sensitivities (n, nw, ns, nl) of both there."""

    x: Array
    z: Array
    sensitivities: Array


class LinkFitter:
    """Fits links of chance, and scores them held out."""

    def __init__(self, fitter: Fitter, best: Fit) -> None:
        """``best``: the fit without chance that they compete with."""
        self._fitter = fitter
        self._samples = np.maximum(fitter.count.sum(axis=1), 1.0)
        self.without: Array = autoregression_costs(best.residual.astype(float), self._samples)
        size = np.maximum((best.residual**2).sum(axis=(1, 2)) / self._samples, 1.0)
        self._least = float(self.without.sum())
        self._unexplained = float((0.5 * self._samples * (np.log(size) + 1.0)).sum()) + best.prior

    def beside(self, effect: Late, others: tuple[Effect, ...], x: Array, z: Array) -> LinkFit | None:
        """The same as `fit` beside others that have been fitted; None where their numbers, as they are, leave the link
        so far behind that it is hopeless: then no sensitivities are computed.
        """
        grid = _first_grid(effect)
        about = float(effect.parameters[0].tries[1])
        scatter = self._scatter(effect, Hypothesis((*others, effect)), x, z, about)
        residuals = self._fitter.replay(Hypothesis((*others, effect)), [(np.append(x, v), z) for v in grid])
        none = np.zeros((0, *residuals.shape[1:]))
        costs = [
            float(scatter.likelihood(effect.law(float(v)), residual, none).costs(np.zeros(0)).sum())
            for v, residual in zip(grid, residuals, strict=True)
        ]
        behind = (min(costs) + 0.5 * float(z @ z) - self._least) / float(self._samples.sum())
        return None if behind > _HOPELESS else self.fit(effect, others, x, z, scatter)

    def fit(
        self, effect: Late, others: tuple[Effect, ...], x: Array, z: Array, begun: Scatter | None = None
    ) -> LinkFit:
        """Fit the link's parameter, those of ``others`` from ``x`` and all nuisances from ``z``, in rounds.

        ``begun``: what the link does about these numbers, where known.
        """
        fitter = self._fitter
        hypothesis, around = Hypothesis((*others, effect)), Hypothesis(others)
        parameter, grid = effect.parameters[0], _first_grid(effect)
        about = float(parameter.tries[1])
        for pass_ in range(_PASSES):
            known = begun if pass_ == 0 else None
            scatter = known or self._scatter(effect, hypothesis, x, z, about)
            last = np.inf
            for round_ in range(_ROUNDS):
                at = np.append(x, about)
                residual = fitter.replay(hypothesis, [(at, z)])[0]
                with fitter.sensitivities_kept():
                    fitter.refresh(hypothesis, at, z, residual)
                    own = fitter.sensitivities(hypothesis, at, z, residual)[:-1]
                    state = _State(x, z, np.concatenate([own, fitter.jacobian]))
                room = _room(around, state)
                points = self._points(hypothesis, effect, scatter, state, room, grid)
                best = min(range(len(points)), key=lambda i: points[i].cost)
                gain, last = last - points[best].cost, points[best].cost
                behind = (last - self._least) / float(self._samples.sum())
                settled = abs(gain) < _SETTLED or round_ == _ROUNDS - 1
                if settled or behind > _HOPELESS:
                    break
                about, step = points[best].x, points[best].step
                x, z = around.values(around.scaled(x) + step[: len(x)]), z + step[len(x) :]
                near = (max(best - 1, 0), min(best + 1, len(points) - 1))
                reach = max(0.6 * max(abs(points[i].x - about) for i in near), _FINEST * parameter.scale)
                low, high = max(about - reach, parameter.low + 0.02 * reach), min(about + reach, parameter.high)
                grid = np.linspace(low, high, _GRID)
            if behind > _FAR:
                break
        self._least = min(self._least, last)
        fit, left = self._scored(hypothesis, effect, scatter, state, room, points)
        return LinkFit(effect, fit, left, scatter, not settled)

    def _scatter(self, effect: Late, hypothesis: Hypothesis, x: Array, z: Array, about: float) -> Scatter:
        """What the link does at a value of its parameter, beside these numbers."""
        law, lag = effect.law(about), effect.lag(self._fitter.residuals.replayer.aligned.period)
        model = self._fitter.variant(hypothesis, np.append(x, about), z)
        return Scatter(self._fitter, model, np.array(effect.site.targets), lag, law)

    def _points(
        self, hypothesis: Hypothesis, effect: Late, scatter: Scatter, state: _State, room: Room, grid: Array
    ) -> list[_Point]:
        """Fits of all other numbers at values of the link's parameter."""
        residuals = self._fitter.replay(hypothesis, [(np.append(state.x, v), state.z) for v in grid])
        everything, points = np.ones(len(self._samples), bool), []
        for v, residual in zip(grid, residuals, strict=True):
            likelihood = scatter.likelihood(effect.law(float(v)), residual, state.sensitivities)
            step = likelihood.fitted(room, everything)
            cost = float(likelihood.costs(step).sum()) + room.prior(step)
            points.append(_Point(float(v), residual, likelihood, step, cost))
        return points

    def _costs(
        self, effect: Late, scatter: Scatter, state: _State, point: _Point, step: Array
    ) -> tuple[Array, Array, Array]:
        """Residuals in units of noise and chance together, costs (nw,) [nats] of windows, and what the mean leaves.

        What is left beside chance may be of any spectrum, as it may for whom it competes with.
        """
        left = point.residual + np.tensordot(step, state.sensitivities, 1)
        white = scatter.whiten(effect.law(point.x), left)
        return white, autoregression_costs(white, self._samples) + point.likelihood.volume, left

    def _scored(
        self,
        hypothesis: Hypothesis,
        effect: Late,
        scatter: Scatter,
        state: _State,
        room: Room,
        points: list[_Point],
    ) -> tuple[Fit, Array]:
        """The fit with costs held out, fold by fold; and what the mean leaves. Costs are a parabola about the best."""
        fitter, fold, n = self._fitter, self._fitter.windows.fold, len(state.x)
        around = Hypothesis(hypothesis.effects[:-1])
        scale = around.slope(state.x)
        best = min(points, key=lambda p: p.cost)
        curve = np.polyfit([p.x - best.x for p in points], [p.cost for p in points], 2)[0]
        residual, likelihood, left = self._costs(effect, scatter, state, best, best.step)

        def values(point: _Point, step: Array) -> tuple[Array, Array]:
            return np.append(around.values(around.scaled(state.x) + step[:n]), point.x), state.z + step[n:]

        x, z = values(best, best.step)
        fit = Fit(hypothesis, x, z, best.cost, residual, np.zeros((n + 1, *residual.shape)))
        fit.held, found = fitter.mean_square(residual), []
        for f in range(fitter.windows.folds):
            train, test = fold != f, fold == f
            steps = [p.likelihood.fitted(room, train) for p in points]
            costs = [
                float(p.likelihood.costs(s)[train].sum()) + room.prior(s) for p, s in zip(points, steps, strict=True)
            ]
            i = int(np.argmin(costs))
            white, cost, _ = self._costs(effect, scatter, state, points[i], steps[i])
            fit.held[test], likelihood[test] = fitter.mean_square(white)[test], cost[test]
            found.append(values(points[i], steps[i]))
        fit.held[fold < 0] = np.nan
        square = np.nan_to_num(fit.held)
        fit.held_cost = fitter.likelihood.costs(square, fitter.likelihood.scale(square)).sum(axis=-1)
        wide = _room(Hypothesis(hypothesis.effects[:-1]), state, 2.0 * BOX)
        further = best.likelihood.fitted(wide, np.ones(len(fold), bool))
        wider = float(best.likelihood.costs(further).sum()) + wide.prior(further)
        fit.hidden = (best.cost - wider) / max(self._unexplained - best.cost, 1e-9)
        fit.likelihood = likelihood
        fit.fold_x, fit.fold_z = np.array([x for x, _ in found]), np.array([z for _, z in found])
        fit.covariance = np.zeros((n + 1, n + 1))
        fit.covariance[:n, :n] = best.likelihood.covariance(best.step, room)[:n, :n] * np.outer(scale, scale)
        fit.covariance[n, n] = 0.5 / max(curve, 1e-12)
        return fit, left


def _first_grid(effect: Late) -> Array:
    """Values of the link's parameter that are tried first."""
    tries = effect.parameters[0].tries
    first = np.array([0.5 * tries[0], *tries])
    return np.sort(np.concatenate([first, 0.5 * (first[1:] + first[:-1])]))[1:]


def _room(others: Hypothesis, state: _State, box: float = BOX) -> Room:
    """Bounds of a step of the parameters of other effects, by scale, and of the nuisances."""
    u, neutral = others.scaled(state.x), others.scaled(others.vector("neutral"))
    reach = 1.0 + _REACH * np.abs(u - neutral)
    low = np.maximum(others.scaled(others.vector("low")) - u, -reach)
    high = np.minimum(others.scaled(others.vector("high")) - u, reach)
    wide = np.full(len(state.z), box)
    return Room(
        np.concatenate([np.zeros(len(u)), state.z]),
        np.concatenate([np.full(len(u), _LOOSE), np.ones(len(wide))]),
        np.concatenate([low, -wide]),
        np.concatenate([high, wide]),
    )
