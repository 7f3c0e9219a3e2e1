"""Fitting a hypothesis: its effects together with all nuisances under their priors, by the one likelihood."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear
from scipy.stats import truncnorm

from simgap.inference.budget import NUISANCES, Budget
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
_LOOSE = 1e-6
"""Prior weight of an effect's parameter, in its scale: none to speak of."""
_BOXED = float(truncnorm.var(-BOX, BOX))
"""Variance of a nuisance that stays in its box, where its prior has 1."""
_FOLD_TRIALS = (1.0, 0.3)
_STRAINED = 1.0
"""[nats] Nuisances that cost more than this may have swallowed a part of an effect."""
_LARGER = (1.0, 1.5, 2.2, 3.3)
"""Where nuisances do a part of what an effect does, the whole effect is so much larger."""
_VALLEY = 0.05
"""[nats] Polishing ends when a round gains less."""
MANY = 24
"""With more nuisances than this, what they answer is computed by one factorisation, some are left out (`_WORTH`)."""
_ALL, _MOVED = 48, 0.5
"""Of more than so many nuisances, a second look is had at those that are this many standard deviations off; of fewer,
at all, for what one number does is another matter beside others. With a second look at those that had moved alone a
mouse's 29 and 36 numbers stopped 206 and 259 nats short of where all of them end; with none at all the 25 of a healthy
camera stopped 50 nats short, and its servos' gains, as an effect, earned these."""
_DULL = 0.1
"""[nats] Of a robot that lands with more than MANY numbers, a number is not tried again in windows that it moved by
less than this, off by a standard deviation, both as modelled and beside what fits: a servo's gain where that stands."""
_WORTH = 3.0
"""[nats] Of more than MANY nuisances, one that moves the data by less than this when it is off by a whole standard
deviation is left out: neither can it explain a gap, nor can this recording say what it is."""
_ROUNDS, _SETTLED = 10, 2.0
"""Of fitting nuisances, at most; and the gain [nats] of a round below which there is no other."""
_TRIALS = (1.0, 0.4, 0.12)
_ENDED = 0.2
"""[nats] A fit ends when a step gains less."""
_REUSED = 4
"""With so many parameters or more, what a step taught about sensitivities stands in for new ones while it foresees at
least half of what the next step gains."""
_STRETCHES = 6
"""A parameter that grows takes so many values over a recording."""


class Fitter:
    """Fits hypotheses on one recording. Nuisance sensitivities are shared by all fits and refreshed on demand."""

    def __init__(self, residuals: Residuals, nuisances: Sequence[Nuisance], base: Variant | None = None) -> None:
        """``base``: the model beside which hypotheses stand; the plant's own where None."""
        self.residuals, self.nuisances = residuals, list(nuisances)
        self.left_out: list[Nuisance] = []
        self.budget = Budget()
        self.windows = residuals.replayer.windows
        self.base = base or Variant.nominal(residuals.replayer.plant)
        self.count = np.maximum(residuals.mask.sum(axis=1), 1).astype(float)
        self.recorded: NDArray[np.bool_] = np.asarray(residuals.mask.any(axis=1))
        self.likelihood = Likelihood(self.recorded, np.full(residuals.mask.shape[2], 4.0))
        self.jacobian = np.zeros((len(self.nuisances), *residuals.mask.shape), np.float32)
        self._dull: NDArray[np.bool_] | None = None
        """(nn, nw) Where a number tells so little that its sensitivity is not looked at again."""
        self.nominal: Fit | None = None
        self.lost: list[float] = []
        """What each cross-validated fit lost [nats] by not having seen a window."""
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

    def estimate_independent(self, residual: Array) -> None:
        """Set the effective number of independent samples in a window from a residual's autocorrelation."""
        ns = residual.shape[1]
        lags = np.arange(1, max(ns // 2, 2))
        for c in range(residual.shape[2]):
            r = residual[..., c] / (1e-12 + np.sqrt((residual[..., c] ** 2).mean(axis=1, keepdims=True)))
            power = float((r * r).mean())
            rho = np.array([float((r[:, :-k] * r[:, k:]).mean()) / max(power, 1e-12) for k in lags])
            ends = np.flatnonzero(rho < 0.05)
            total = rho[: ends[0]].sum() if len(ends) else rho.sum()
            self.likelihood.independent[c] = float(np.clip(ns / (1.0 + 2.0 * total), 2.0, 20.0))

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
    ) -> tuple[Array, Array, Array]:
        """One bounded Gauss-Newton step (dx scaled, dz) about a residual; also the normal matrix.

        ``low`` and ``high`` bound the scaled step of the effects; z stays in its box. ``nuisance`` are the
        sensitivities in the selected windows, the fitter's own where not given.
        """
        if nuisance is None:
            nuisance = self.jacobian if select is None else self.jacobian[:, select]
        square = self.mean_square(residual, select)
        root = np.sqrt(self.weights(square, select))[:, None, :]
        ne, nn = len(effect_jacobian), len(nuisance)
        stacked = _stack(effect_jacobian, nuisance) * np.broadcast_to(root, residual.shape).reshape(1, -1)
        target = (residual * root).reshape(-1)
        prior = np.diag(np.concatenate([np.full(ne, _LOOSE), np.ones(nn)]))
        normal = stacked @ stacked.T + prior
        slope = stacked @ target + np.concatenate([np.zeros(ne), z])
        if ne + nn == 0:
            return np.zeros(0), np.zeros(0), normal
        lower = np.concatenate([low, -box - z]) - 1e-9
        upper = np.concatenate([high, box - z]) + 1e-9
        factor = np.linalg.cholesky(normal).T
        step = lsq_linear(factor, -np.linalg.solve(factor.T, slope), (lower, upper), method="bvls").x
        return step[:ne], step[ne:], normal

    def update_start(self, *models: Variant) -> None:
        """Judge the start of windows by other models.

        Sensitivities that will not all be looked at again are whitened anew with the residuals.
        """
        many = len(self.nuisances) > MANY
        plain = self.residuals.colour(self.jacobian.astype(float)) if many else None
        self.residuals.update_start(*models)
        if plain is not None:
            self.jacobian = self.residuals.whiten(plain).astype(np.float32)

    def refresh(
        self, hypothesis: Hypothesis, x: Array, z: Array, residual: Array, which: NDArray[np.bool_] | None = None
    ) -> None:
        """Recompute the nuisance sensitivities (or those of ``which``) about a point whose residual is known.

        The array that was there stays as it is: who keeps it has what was true there.
        """
        found = self.jacobian.copy()
        signs = np.where(z > 0, -1.0, 1.0)
        rows = np.arange(len(z)) if which is None else np.flatnonzero(which)
        if self._dull is not None:
            for i in rows:
                moved, windows = z.copy(), np.flatnonzero(~self._dull[i])
                if not len(windows):
                    continue
                moved[i] += signs[i] * self._step
                change = self.replay(hypothesis, [(x, moved)], windows)[0] - residual[windows]
                found[i][windows] = change / (signs[i] * self._step)
            self.jacobian = found
            return
        for first in range(0, len(rows), 16):
            part, points = rows[first : first + 16], []
            for i in part:
                moved = z.copy()
                moved[i] += signs[i] * self._step
                points.append((x, moved))
            changes = self.replay(hypothesis, points) - residual
            found[part] = changes / (signs[part, None, None, None] * self._step)
        self.jacobian = found

    def moved(self, fit: Fit) -> NDArray[np.bool_] | None:
        """Nuisances whose sensitivities a fit may have changed: of many those that it moved, else all (None)."""
        return np.abs(fit.z) > _MOVED if len(fit.z) > _ALL else None

    def _leave_out(self) -> None:
        """Leave out nuisances that hardly move the data, by their sensitivities about the nominal model."""
        assert self.nominal is not None
        if len(self.nuisances) <= MANY:
            return
        # As if no gap were left: beside an effect that explains it they count for more.
        weight = self.weights(np.ones_like(self.mean_square(self.nominal.residual)))[:, None, :]
        worth = 0.5 * np.array([float((row * row * weight).sum()) for row in self.jacobian])
        kept = np.flatnonzero(worth > _WORTH)
        self.left_out = [self.nuisances[i] for i in np.flatnonzero(worth <= _WORTH)]
        self.nuisances = [self.nuisances[i] for i in kept]
        self.jacobian, self.nominal.z = self.jacobian[kept], self.nominal.z[kept]

    def _dull_about(self, fit: Fit) -> NDArray[np.bool_]:
        """See `_dull`, from the sensitivities about the nominal model and about numbers that fit."""
        weight = self.weights(self.mean_square(fit.residual))[:, None, :]
        told = [0.5 * (j.astype(float) ** 2 * weight).sum(axis=(2, 3)) for j in (self.nominal_jacobian, self.jacobian)]
        return np.maximum(*told) < _DULL

    # -- fits ----------------------------------------------------------------------------------------------------

    def fit_nuisances(self) -> Fit:
        """The nominal model with its nuisances: the reference of everything.

        Of models that the recording moves far, sensitivities about the nominal numbers say little; they are taken anew
        until that gains nothing more.
        """
        empty, none = Hypothesis(), np.zeros(0)
        z = np.zeros(len(self.nuisances))
        residual = self.replay(empty, [(none, z)])[0]
        self.estimate_independent(residual)
        fit = Fit(empty, none, z, self.cost(residual, z), residual, np.zeros((0, *residual.shape)))
        self.nominal, self._dull = fit, None
        hurried = False
        for round_ in range(_ROUNDS):
            self.refresh(empty, none, fit.z, fit.residual, self.moved(fit) if round_ else None)
            if round_ == 0:
                self._leave_out()
                self.nominal_jacobian = self.jacobian.copy()
            if round_ == 1 and self.lands and len(fit.z) > MANY:
                self._dull = self._dull_about(fit)
            before, fit = fit.cost, self.fit(empty, none, fit.z, iterations=4, known=fit.residual)
            if before - fit.cost < _SETTLED and round_ > 0:
                break
            hurried = self.budget.spent(NUISANCES)
            if hurried:
                self.budget.ended("nuisances")
                break
        if not hurried:
            self.refresh(empty, none, fit.z, fit.residual, self.moved(fit))
        self.estimate_independent(fit.residual)
        return self.fit(empty, none, fit.z, iterations=2, known=fit.residual)

    def polish(self, fit: Fit, rounds: int = 1) -> Fit:
        """Fit on with nuisance sensitivities computed at the fit itself; those of the fitter stay as they are.

        An effect and the nuisances that can imitate it form a long narrow valley; more rounds follow it further.
        """
        with self.sensitivities_kept():
            return self._polished(self.complete(fit), rounds)

    def _polished(self, fit: Fit, rounds: int) -> Fit:
        strained = fit.prior > _STRAINED
        for _ in range(rounds):
            self.refresh(fit.hypothesis, fit.x, fit.z, fit.residual, self.moved(fit))
            better = self.fit(fit.hypothesis, fit.x, fit.z, 4, fit.residual, slope=fit.effect_jacobian)
            if strained:
                rested = self.fit(fit.hypothesis, *self._at_rest(fit), 4)
                better, strained = min(better, rested, key=lambda f: f.cost), False
            gain, fit = fit.cost - better.cost, better
            if gain < _VALLEY:
                break
        fit.polished = True
        return self.cross_validate(fit)

    def _at_rest(self, fit: Fit) -> tuple[Array, Array]:
        """The other end of the valley (x, z): nuisances at rest, effects as much larger as then fits best."""
        hypothesis, rest = fit.hypothesis, np.zeros_like(fit.z)
        low, high = (hypothesis.scaled(hypothesis.vector(end)) for end in ("low", "high"))
        neutral = hypothesis.scaled(hypothesis.vector("neutral"))
        away = hypothesis.scaled(fit.x) - neutral
        sizes = [hypothesis.values(np.clip(neutral + k * away, low, high)) for k in (_LARGER if len(away) else (1.0,))]
        squares = self.mean_square(self.replay(hypothesis, [(x, rest) for x in sizes]))
        return sizes[int(np.argmin([float(self.data_cost(square)) for square in squares]))], rest

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
    ) -> Fit:
        low, high = hypothesis.scaled(hypothesis.vector("low")), hypothesis.scaled(hypothesis.vector("high"))
        neutral = hypothesis.scaled(hypothesis.vector("neutral"))
        x, z = hypothesis.values(hypothesis.scaled(x)), z.copy()
        residual = self.replay(hypothesis, [(x, z)], select)[0] if known is None else known
        cost = self.cost(residual, z, select)
        jacobian = np.zeros((len(x), *residual.shape)) if slope is None else slope
        fresh, stale = slope is not None, slope is None
        if select is not None:
            self.jacobian = self.jacobian[:, select]
        for _ in range(iterations):
            if stale or (len(x) < _REUSED and not fresh):
                jacobian, fresh, stale = self.sensitivities(hypothesis, x, z, residual, select), True, False
            u = hypothesis.scaled(x)
            reach = 3.0 + np.abs(u - neutral)
            bounds = np.maximum(low - u, -reach), np.minimum(high - u, reach)
            dx, dz, _ = self.solve(residual, jacobian, z, *bounds, select, self.jacobian, box)
            for t in _TRIALS:
                point = hypothesis.values(u + t * dx), np.clip(z + t * dz, -box, box)
                tried = self.replay(hypothesis, [point], select)[0]
                new_cost = self.cost(tried, point[1], select)
                if new_cost < cost:
                    break
            else:
                if fresh:
                    break
                stale = True
                continue
            moved_x, moved_z = hypothesis.scaled(point[0]) - u, point[1] - z
            foreseen = residual + np.tensordot(moved_x, jacobian, 1) + np.tensordot(moved_z, self.jacobian, 1)
            gain, hoped = cost - new_cost, cost - self.cost(foreseen, point[1], select)
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
            fresh, stale = False, gain < max(0.5 * hoped, _ENDED)
        if select is not None:
            residual, fresh = self.replay(hypothesis, [(x, z)])[0], False
            cost = self.cost(residual, z)
        return Fit(hypothesis, x, z, cost, residual, jacobian if fresh else jacobian[:0])

    def complete(self, fit: Fit) -> Fit:
        """A fit with its effects' sensitivities in all windows, computed where they are not there."""
        if len(fit.effect_jacobian) != len(fit.x):
            fit.effect_jacobian = self.sensitivities(fit.hypothesis, fit.x, fit.z, fit.residual)
        return fit

    def cross_validate(self, fit: Fit) -> Fit:
        """Score every held-out window with a fit that has not seen its fold; adds held, fold_x and covariance.

        Each fold's fit is one Gauss-Newton step from the common one, taken as far as the windows outside the fold like.
        """
        hypothesis, fold = self.complete(fit).hypothesis, self.windows.fold
        u = hypothesis.scaled(fit.x)
        low, high = (hypothesis.scaled(hypothesis.vector(end)) for end in ("low", "high"))
        bounds = np.maximum(low - u, -2.0), np.minimum(high - u, 2.0)
        # What is left of the common fit's own step is not the fold's doing.
        rest_x, rest_z, _ = self.solve(fit.residual, fit.effect_jacobian, fit.z, *bounds)
        trials: list[list[tuple[Array, Array]]] = []
        for f in range(self.windows.folds):
            train = np.flatnonzero(fold != f)
            dx, dz, _ = self.solve(fit.residual[train], fit.effect_jacobian[:, train], fit.z, *bounds, train)
            dx, dz = dx - rest_x, dz - rest_z
            trials.append([(hypothesis.values(u + t * dx), np.clip(fit.z + t * dz, -BOX, BOX)) for t in _FOLD_TRIALS])
        squares = self.mean_square(self.replay(hypothesis, [p for t in trials for p in t]))
        common = self.mean_square(fit.residual)
        fit.held = np.full(common.shape, np.nan)
        points, trained = [], []
        for f, options in enumerate(trials):
            train, test = np.flatnonzero(fold != f), np.flatnonzero(fold == f)
            own = [*squares[f * len(_FOLD_TRIALS) : (f + 1) * len(_FOLD_TRIALS)], common]
            tried = [*options, (fit.x, fit.z)]
            costs = [
                float(self.data_cost(square[train], train)) + 0.5 * float(z @ z)
                for square, (_, z) in zip(own, tried, strict=True)
            ]
            best = int(np.argmin(costs))
            fit.held[test] = own[best][test]
            points.append(tried[best])
            trained.append(own[best])
        fit.held_cost = self.likelihood.held_out(np.nan_to_num(fit.held), fold, np.array(trained))
        self.lost.append(float(np.nansum(fit.held_cost) - self.seen(fit)[fold >= 0].sum()))
        fit.fold_x = np.array([x for x, _ in points]).reshape(len(points), len(fit.x))
        fit.fold_z = np.array([z for _, z in points]).reshape(len(points), len(fit.z))
        fit.covariance = self.covariance(fit)
        return fit

    def seen(self, fit: Fit) -> Array:
        """Minus the log density (nw,) of each window under a fit that has seen it, and its own scales."""
        square = self.mean_square(fit.residual)
        costs: Array = self.likelihood.costs(square, self.likelihood.scale(square)).sum(axis=-1)
        return costs

    def score_in_sample(self, fit: Fit) -> None:
        """Put what a fit leaves in sample in the place of held-out scores, of one that loses anyhow."""
        square, held = self.mean_square(fit.residual), self.windows.fold >= 0
        fit.held, fit.held_cost = np.where(held[:, None], square, np.nan), np.where(held, self.seen(fit), np.nan)

    def covariance(self, fit: Fit, thorough: bool = False) -> Array:
        """Covariance (nx, nx) of the effects' parameters about the truth, with nuisances drawn from their prior.

        The sandwich A^-1 B A^-1: A is the normal matrix of the data term and the prior, B the covariance of its slope.
        The two differ, for the data term gives a window's samples the variance of its channel's scale, where they have
        their own mean square, and the fit's prior is not cut off at its box, the nuisances are.
        ``thorough``: what was left out, as the nominal model hardly moves by it, may be off as well, and beside the
        effect it may count: the friction of a ground on which only a foot that slips depends.
        """
        ne, nn = len(fit.x), len(fit.z)
        scale = fit.hypothesis.slope(fit.x)
        square = self.mean_square(fit.residual)
        shape = fit.residual.shape
        weights = self.weights(square)
        weight = np.broadcast_to(weights[:, None, :], shape).reshape(-1)
        share = weights * square * self.count / np.maximum(self.likelihood.independent, 1e-300)
        share = np.broadcast_to(share[:, None, :], shape).reshape(-1)
        stacked = _stack(fit.effect_jacobian, self.jacobian) * np.sqrt(weight)
        bread = np.linalg.inv(stacked @ stacked.T + np.diag(np.r_[np.full(ne, _LOOSE), np.ones(nn)]))
        slope = (stacked * share) @ stacked.T + np.diag(np.r_[np.zeros(ne), np.full(nn, _BOXED)])
        if thorough and self.left_out:
            others = self._left_out_jacobian(fit).reshape(len(self.left_out), -1) * np.sqrt(weight)
            pull = stacked @ others.T
            slope += _BOXED * pull @ pull.T
        found: Array = (bread @ slope @ bread)[:ne, :ne] * np.outer(scale, scale)
        return found

    def _left_out_jacobian(self, fit: Fit) -> Array:
        """Sensitivities (n, nw, ns, nl) to the nuisances that are left out, about a fit."""
        kept, jacobian, dull = self.nuisances, self.jacobian, self._dull
        which = np.arange(len(kept) + len(self.left_out)) >= len(kept)
        try:
            self.nuisances, self._dull = [*kept, *self.left_out], None
            self.jacobian = np.zeros((len(which), *fit.residual.shape), np.float32)
            z = np.concatenate([fit.z, np.zeros(len(self.left_out))])
            self.refresh(fit.hypothesis, fit.x, z, fit.residual, which)
            return self.jacobian[which].astype(float)
        finally:
            self.nuisances, self.jacobian, self._dull = kept, jacobian, dull

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

    def cost(self, residual: Array, z: Array, select: Ints | None = None) -> float:
        """Cost [nats] of a residual in all (or selected) windows and of nuisances z."""
        return float(self.data_cost(self.mean_square(residual, select), select)) + 0.5 * float(z @ z)


def _stack(effects: Array, nuisances: Array) -> Array:
    """Sensitivities (ne + nn, samples) to effects and nuisances, one row each."""
    both = np.concatenate([effects, nuisances])
    return both.reshape(len(both), math.prod(both.shape[1:]))
