"""Gauss-Newton on one recording: residuals of a hypothesis, their cost, and a bounded descent from where one begins."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from simgap.inference.budget import Budget
from simgap.inference.hypothesis import Fit, Hypothesis
from simgap.inference.likelihood import Likelihood
from simgap.inference.nuisance import BOX, Nuisance, apply_nuisances
from simgap.inference.residual import Residuals
from simgap.simulation.contacts import colliding
from simgap.simulation.variant import Variant

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

_STEP = 0.02
"""Finite-difference step of an effect's parameter, in its scale."""
_NUISANCE_STEP = 0.02
"""The same of a nuisance, in standard deviations of its prior. Small: an effect and its imitation differ by
what a longer step bends."""
_ROUGH_STEP = 0.5
"""The same of a robot that lands, with contacts as they are: there a small step shows which foot came down when, a long
one what the number does. By such slopes a mouse's numbers came 17 nats further in half the replays, 40 in as many."""
_ROUGH_EFFECT_STEP = 0.2
"""And of an effect's parameter there, in its scale: about as far, so that the two kinds of slopes are of one kind, and
what does the same (feet's friction as a number and as an effect) is seen to do so."""
LOOSE = 1e-6
"""Prior weight of an effect's parameter, in its scale: none to speak of."""
_TRIALS = ((0.0, (1.0, 0.4, 0.12)),)
"""How a step is damped, and the shares of it that are tried."""
_DAMPED = (0.0, (1.0,)), (0.03, (1.0,)), (0.3, (1.0,)), (3.0, (1.0, 0.3))
"""The same where sensitivities are dear: a step that is damped may lead on where a shorter one does not."""
_ENDED = 0.2
"""[nats] A fit ends when a step gains less."""
_REUSED = 4
"""With so many parameters or more, what a step taught about sensitivities stands in for new ones while it foresees at
least half of what the next step gains."""
_STRETCHES = 6
"""A parameter that grows takes so many values over a recording."""


class GaussNewton:
    """Descends the one likelihood of a recording; what nuisances do is in ``jacobian`` and stays there."""

    def __init__(self, residuals: Residuals, nuisances: Sequence[Nuisance], base: Variant | None = None) -> None:
        """``base``: the model beside which hypotheses stand; the plant's own where None."""
        self.residuals, self.nuisances = residuals, list(nuisances)
        self.budget = Budget()
        self.windows = residuals.replayer.windows
        self.base = base or Variant.nominal(residuals.replayer.plant)
        self.count = np.maximum(residuals.mask.sum(axis=1), 1).astype(float)
        self.recorded: NDArray[np.bool_] = np.asarray(residuals.mask.any(axis=1))
        self.likelihood = Likelihood(self.recorded, np.full(residuals.mask.shape[2], 4.0))
        self.jacobian = np.zeros((len(self.nuisances), *residuals.mask.shape), np.float32)
        """Sensitivities to the nuisances, which all fits share."""
        self.lands = bool(colliding(self.base.model)[0])
        self._step = _ROUGH_STEP if self.lands else _NUISANCE_STEP
        self._effect_step = _ROUGH_EFFECT_STEP if self.lands else _STEP
        middles = (self.windows.start + 0.5 * self.windows.length) * residuals.replayer.aligned.period
        count = min(_STRETCHES, len(middles))
        self._stretch: Ints = (count * np.arange(len(middles), dtype=np.int64)) // len(middles)
        self._moments = np.array([middles[self._stretch == s].mean() for s in range(count)])
        self._moments = self._moments - 0.5 * (middles.min() + middles.max())

    # -- model ---------------------------------------------------------------------------------------------------

    def variant(self, hypothesis: Hypothesis, x: Array, z: Array, moment: float = 0.0) -> Variant:
        """The model of a hypothesis at given parameters, ``moment`` [s] after the middle of the recording."""
        made = self.base.copy()
        made.moment = moment
        apply_nuisances(self.nuisances, made, z)
        position = 0
        for effect in hypothesis.effects:
            n = len(effect.parameters)
            effect.apply(made, tuple(float(v) for v in x[position : position + n]))
            position += n
        return made

    def replay(
        self,
        hypothesis: Hypothesis,
        points: Sequence[tuple[Array, Array]],
        select: Ints | None = None,
    ) -> Array:
        """Residuals (n, nw, ns, nl) at points (x, z).

        Raises:
            OutOfTimeError: the time for what is being looked for is over.
        """
        self.budget.check()
        moments = [float(m) for m in self._moments] if hypothesis.grows else [0.0]
        variants = [self.variant(hypothesis, x, z, moment) for x, z in points for moment in moments]
        if not hypothesis.grows:
            return self.residuals.of(variants, select)
        stretch = self._stretch if select is None else self._stretch[select]
        which = len(self._moments) * np.arange(len(points))[:, None] + stretch
        return self.residuals.of(variants, select, which)

    # -- cost ----------------------------------------------------------------------------------------------------

    def mean_square(self, residual: Array, select: Ints | None = None) -> Array:
        """Mean square (..., nw, nl) of residuals (..., nw, ns, nl) over the recorded samples."""
        count = self.count if select is None else self.count[select]
        square: Array = (residual**2).sum(axis=-2) / count
        return square

    def data_cost(self, square: Array, select: Ints | None = None) -> Array:
        """The data term (...) of mean squares (..., nw, nl)."""
        return (self.likelihood if select is None else self.likelihood.of(select)).cost(square)

    def weights(self, square: Array, select: Ints | None = None) -> Array:
        """Weight (nw, nl) of a squared sample, such that the weighted sum of squares has the data term's slope."""
        likelihood = self.likelihood if select is None else self.likelihood.of(select)
        weight: Array = likelihood.weights(square) / (self.count if select is None else self.count[select])
        return weight

    def cost(self, residual: Array, z: Array, select: Ints | None = None) -> float:
        """Cost [nats] of a residual in all (or selected) windows and of nuisances z."""
        return float(self.data_cost(self.mean_square(residual, select), select)) + 0.5 * float(z @ z)

    # -- linear algebra ------------------------------------------------------------------------------------------

    def solve(
        self,
        residual: Array,
        effect_jacobian: Array,
        z: Array,
        low: Array,
        high: Array,
        select: Ints | None = None,
        nuisance: Array | None = None,
        box: float = BOX,
        damping: float = 0.0,
        tied: tuple[Array, Array] | None = None,
    ) -> tuple[Array, Array, Array]:
        """One bounded Gauss-Newton step (dx scaled, dz) about a residual; also the normal matrix.

        With ``damping`` Levenberg and Marquardt's: shorter, and nearer to where the cost falls at first.

        ``low`` and ``high`` bound the scaled step of the effects; z stays in its box. ``nuisance`` are the
        sensitivities in the selected windows, the fitter's own where not given. ``tied``: scaled values of the effects
        and the normal matrix of their own prior.
        """
        if nuisance is None:
            nuisance = self.jacobian if select is None else self.jacobian[:, select]
        square = self.mean_square(residual, select)
        root = np.sqrt(self.weights(square, select))[:, None, :]
        ne, nn = len(effect_jacobian), len(nuisance)
        stacked = stack(effect_jacobian, nuisance) * np.broadcast_to(root, residual.shape).reshape(1, -1)
        target = (residual * root).reshape(-1)
        prior = np.diag(np.concatenate([np.full(ne, LOOSE), np.ones(nn)]))
        normal = stacked @ stacked.T + prior
        slope = stacked @ target + np.concatenate([np.zeros(ne), z])
        if tied is not None:
            normal[:ne, :ne] += tied[1]
            slope[:ne] += tied[1] @ tied[0]
        normal += damping * np.diag(np.diag(normal))
        if ne + nn == 0:
            return np.zeros(0), np.zeros(0), normal
        lower = np.concatenate([low, -box - z]) - 1e-9
        upper = np.concatenate([high, box - z]) + 1e-9
        factor = np.linalg.cholesky(normal).T
        step = lsq_linear(factor, -np.linalg.solve(factor.T, slope), (lower, upper), method="bvls").x
        return step[:ne], step[ne:], normal

    def sensitivities(
        self, hypothesis: Hypothesis, x: Array, z: Array, residual: Array, select: Ints | None = None
    ) -> Array:
        """Change of the residual, known at (x, z), by scaled parameter of the effects, (ne, nw, ns, nl)."""
        if not len(x):
            return np.zeros((0, *residual.shape))
        u, high = hypothesis.scaled(x), hypothesis.scaled(hypothesis.vector("high"))
        points, steps = [], np.where(u + self._effect_step <= high, self._effect_step, -self._effect_step)
        for i, s in enumerate(steps):
            moved = u.copy()
            moved[i] += s
            points.append((hypothesis.values(moved), z))
        return (self.replay(hypothesis, points, select) - residual) / steps[:, None, None, None]

    # -- descent -------------------------------------------------------------------------------------------------

    @contextmanager
    def sensitivities_kept(self) -> Iterator[None]:
        """The nuisances' sensitivities are afterwards what they were, also where the time is over in the midst."""
        kept = self.jacobian
        try:
            yield
        finally:
            self.jacobian = kept

    def fit(
        self,
        hypothesis: Hypothesis,
        x: Array,
        z: Array,
        iterations: int = 5,
        known: Array | None = None,
        select: Ints | None = None,
        box: float = BOX,
        slope: Array | None = None,
        roughly: bool = False,
    ) -> Fit:
        """Gauss-Newton with line search from (x, z) on all (or selected) windows; the fit is evaluated on all of them.

        ``known`` is the residual at (x, z) and ``slope`` its change by the effects' parameters, where computed.
        ``roughly``: the fit's own sensitivities are left to `complete`.
        """
        with self.sensitivities_kept():
            found = self._descended(hypothesis, x, z, iterations, known, select, box, slope)
        return found if roughly else self.complete(found)

    def descend(self, hypothesis: Hypothesis, x: Array, z: Array, iterations: int, known: Array, slope: Array) -> Fit:
        """The same on all windows with the sensitivities that are there, ``slope`` those to the effects' parameters.

        What steps teach about either stays, in the fitter and in the fit; none are computed anew. Ends where they lead
        no further.
        """
        return self._descended(hypothesis, x, z, iterations, known, None, BOX, slope, learning=True)

    def _descended(
        self,
        hypothesis: Hypothesis,
        x: Array,
        z: Array,
        iterations: int,
        known: Array | None,
        select: Ints | None,
        box: float,
        slope: Array | None,
        learning: bool = False,
    ) -> Fit:
        low, high = hypothesis.scaled(hypothesis.vector("low")), hypothesis.scaled(hypothesis.vector("high"))
        neutral = hypothesis.scaled(hypothesis.vector("neutral"))
        x, z = hypothesis.values(hypothesis.scaled(x)), z.copy()
        residual = self.replay(hypothesis, [(x, z)], select)[0] if known is None else known
        cost = self.cost(residual, z, select) + hypothesis.tied(x)
        pull = hypothesis.pull()
        jacobian = np.zeros((len(x), *residual.shape)) if slope is None else slope
        fresh, stale = slope is not None, slope is None
        if select is not None:
            self.jacobian = self.jacobian[:, select]
        for _ in range(iterations):
            if stale or (len(x) < _REUSED and not fresh and not learning):
                jacobian, fresh, stale = self.sensitivities(hypothesis, x, z, residual, select), True, False
            u = hypothesis.scaled(x)
            reach = 3.0 + np.abs(u - neutral)
            bounds = np.maximum(low - u, -reach), np.minimum(high - u, reach)
            tries = (
                (share * dx, share * dz)
                for damping, shares in (_DAMPED if learning else _TRIALS)
                for dx, dz, _ in [
                    self.solve(residual, jacobian, z, *bounds, select, self.jacobian, box, damping, (u, pull))
                ]
                for share in shares
            )
            for dx, dz in tries:
                point = hypothesis.values(u + dx), np.clip(z + dz, -box, box)
                tried = self.replay(hypothesis, [point], select)[0]
                new_cost = self.cost(tried, point[1], select) + hypothesis.tied(point[0])
                if new_cost < cost:
                    break
            else:
                if fresh or learning:
                    break
                stale = True
                continue
            moved_x, moved_z = hypothesis.scaled(point[0]) - u, point[1] - z
            foreseen = residual + np.tensordot(moved_x, jacobian, 1) + np.tensordot(moved_z, self.jacobian, 1)
            hoped = cost - self.cost(foreseen, point[1], select) - hypothesis.tied(point[0])
            gain = cost - new_cost
            missed, length = tried - foreseen, float(moved_x @ moved_x + moved_z @ moved_z)
            if length > 0:
                # Broyden: what the step taught about the sensitivities is kept for this fit.
                update = (moved_z / length).astype(np.float32)[:, None, None, None] * missed.astype(np.float32)
                self.jacobian = self.jacobian + update
                jacobian = jacobian + (moved_x / length)[:, None, None, None] * missed
            (x, z), residual, cost = point, tried, new_cost
            if gain < _ENDED and (fresh or len(x) < _REUSED):
                fresh = False
                break
            fresh, stale = False, not learning and gain < max(0.5 * hoped, _ENDED)
        if select is not None:
            residual, fresh = self.replay(hypothesis, [(x, z)])[0], False
            cost = self.cost(residual, z) + hypothesis.tied(x)
        return Fit(hypothesis, x, z, cost, residual, jacobian if fresh or learning else jacobian[:0])

    def complete(self, fit: Fit) -> Fit:
        """A fit with its effects' sensitivities in all windows, computed where they are not there."""
        if len(fit.effect_jacobian) != len(fit.x):
            fit.effect_jacobian = self.sensitivities(fit.hypothesis, fit.x, fit.z, fit.residual)
        return fit


def stack(effects: Array, nuisances: Array) -> Array:
    """Sensitivities (ne + nn, samples) to effects and nuisances, one row each."""
    both = np.concatenate([effects, nuisances])
    return both.reshape(len(both), math.prod(both.shape[1:]))
