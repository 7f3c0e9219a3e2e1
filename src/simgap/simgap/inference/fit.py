"""Fitting a hypothesis: its effects together with all nuisances under their priors, by the one likelihood."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.stats import truncnorm

from simgap.inference.budget import NUISANCES
from simgap.inference.gauss_newton import LOOSE, GaussNewton, stack
from simgap.inference.hypothesis import Fit, Hypothesis
from simgap.inference.nuisance import BOX, Nuisance
from simgap.inference.residual import Residuals
from simgap.simulation.variant import Variant

Array = NDArray[np.float64]

_BOXED = float(truncnorm.var(-BOX, BOX))
"""Variance of a nuisance that stays in its box, where its prior has 1."""
_FOLD_TRIALS = (1.0, 0.3)
_STRAINED = 1.0
"""[nats] Nuisances that cost more than this may have swallowed a part of an effect."""
_LARGER = (1.0, 1.5, 2.2, 3.3)
"""Where nuisances do a part of what an effect does, the whole effect is so much larger."""
_VALLEY = 0.05
"""[nats] Polishing ends when a round gains less."""
LITTLE = 0.005
"""Or less than this share of all that is explained: an eighth of what the law that is fitted may be off by
(`thresholds.LAW_ERROR`)."""
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
_STEPS, _STEPS_LANDING = 12, 4
"""Of each round. A step asks for a replay or two and teaches about sensitivities, a round for one of each number: with
12 the SO-101's 32 numbers need four rounds where with 4 they need six, and end 3 nats further. Where feet land, what a
step teaches is chance."""


class Fitter(GaussNewton):
    """Fits hypotheses on one recording. Nuisance sensitivities are shared by all fits and refreshed on demand."""

    def __init__(self, residuals: Residuals, nuisances: Sequence[Nuisance], base: Variant | None = None) -> None:
        """``base``: the model beside which hypotheses stand; the plant's own where None."""
        super().__init__(residuals, nuisances, base)
        self.left_out: list[Nuisance] = []
        self._dull: NDArray[np.bool_] | None = None
        """(nn, nw) Where a number tells so little that its sensitivity is not looked at again."""
        self.nominal: Fit | None = None
        self.lost: list[float] = []
        """What each cross-validated fit lost [nats] by not having seen a window."""

    # -- sensitivities to the nuisances --------------------------------------------------------------------------

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

    def fit_nuisances(self, say: Callable[[float], None] = lambda share: None) -> Fit:
        """The nominal model with its nuisances: the reference of everything.

        Of models that the recording moves far, sensitivities about the nominal numbers say little; they are taken anew
        until that gains nothing more. ``say`` is told how far it is.
        """
        empty, none = Hypothesis(), np.zeros(0)
        z = np.zeros(len(self.nuisances))
        residual = self.replay(empty, [(none, z)])[0]
        self.estimate_independent(residual)
        fit = Fit(empty, none, z, self.cost(residual, z), residual, np.zeros((0, *residual.shape)))
        self.nominal, self._dull = fit, None
        hurried = False
        for round_ in range(_ROUNDS):
            say(round_ / _ROUNDS)
            self.refresh(empty, none, fit.z, fit.residual, self.moved(fit) if round_ else None)
            if round_ == 0:
                self._leave_out()
                self.nominal_jacobian = self.jacobian.copy()
            if round_ == 1 and self.lands and len(fit.z) > MANY:
                self._dull = self._dull_about(fit)
            steps = _STEPS_LANDING if self.lands else _STEPS
            before, fit = fit.cost, self.fit(empty, none, fit.z, steps, known=fit.residual)
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

    def _little(self, fit: Fit) -> float:
        """What does not matter [nats] beside all that a fit explains; of a robot that lands each nat may."""
        return LITTLE * (self.nominal.cost - fit.cost) if self.nominal and not self.lands else 0.0

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
            if gain < max(_VALLEY, self._little(fit)):
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

    # -- scores and intervals ------------------------------------------------------------------------------------

    def cross_validate(self, fit: Fit) -> Fit:
        """Score every held-out window with a fit that has not seen its fold; adds held, fold_x and covariance.

        Each fold's fit is one Gauss-Newton step from the common one, taken as far as the windows outside the fold like.
        """
        hypothesis, fold = self.complete(fit).hypothesis, self.windows.fold
        u = hypothesis.scaled(fit.x)
        low, high = (hypothesis.scaled(hypothesis.vector(end)) for end in ("low", "high"))
        bounds = np.maximum(low - u, -2.0), np.minimum(high - u, 2.0)
        tied = u, hypothesis.pull()
        # What is left of the common fit's own step is not the fold's doing.
        rest_x, rest_z, _ = self.solve(fit.residual, fit.effect_jacobian, fit.z, *bounds, tied=tied)
        trials: list[list[tuple[Array, Array]]] = []
        for f in range(self.windows.folds):
            train = np.flatnonzero(fold != f)
            dx, dz, _ = self.solve(fit.residual[train], fit.effect_jacobian[:, train], fit.z, *bounds, train, tied=tied)
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
                float(self.data_cost(square[train], train)) + 0.5 * float(z @ z) + hypothesis.tied(x)
                for square, (x, z) in zip(own, tried, strict=True)
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
        stacked = stack(fit.effect_jacobian, self.jacobian) * np.sqrt(weight)
        prior, drawn = (
            np.diag(np.r_[np.full(ne, LOOSE), np.ones(nn)]),
            np.diag(np.r_[np.zeros(ne), np.full(nn, _BOXED)]),
        )
        for matrix in (prior, drawn):
            matrix[:ne, :ne] += fit.hypothesis.pull()
        bread = np.linalg.inv(stacked @ stacked.T + prior)
        slope = (stacked * share) @ stacked.T + drawn
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
