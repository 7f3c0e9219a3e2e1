"""Extended Kalman filters, many at once: NumPy for speed, or one `filterpy` filter each. Readings come one by one."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.special import erfc

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


class CovarianceError(ValueError):
    """A covariance that is no covariance."""


def check_covariance(name: str, covariance: Array) -> None:
    """Raises CovarianceError where a matrix, or one of a stack, is not finite, symmetric and positive definite."""
    for number, matrix in enumerate(covariance.reshape(-1, *covariance.shape[-2:])):
        if not np.all(np.isfinite(matrix)):
            raise CovarianceError(f"{name}[{number}]: holds a number that is not finite")
        if not np.allclose(matrix, matrix.T, rtol=1e-9, atol=1e-12 * float(np.max(np.abs(matrix)))):
            raise CovarianceError(f"{name}[{number}]: is not symmetric")
        lowest = float(np.linalg.eigvalsh(matrix)[0])
        if lowest <= 0.0:
            raise CovarianceError(f"{name}[{number}]: is not positive definite (lowest eigenvalue {lowest:.3g})")


class FilterBank(Protocol):
    """B filters of n states each."""

    @property
    def x(self) -> Array:
        """(B, n): states."""

    @property
    def P(self) -> Array:  # noqa: N802 - the usual name
        """(B, n, n): their covariances."""

    def restore(self, x: Array, P: Array) -> None:
        """Back to states (B, n) and covariances (B, n, n) that it had before."""

    def predict(self, state: Array, transition: Array, process: Array) -> None:
        """To the predicted states (B, n), with their Jacobian (B, n, n) or (n, n) and variances to add (B, n)."""

    def update(self, residual: Array, gradient: Array, variance: Any, use: Mask) -> Array:
        """One scalar reading a filter, where `use` (B,) says so; returns the residuals' expected variances (B,).

        residual: reading minus prediction (B,); gradient: of the prediction by the state (B, n); variance: of the
        reading, a number or (B,).
        """

    def raise_to(self, index: int, bound: Array, use: Mask, spread: Any = 0.0) -> None:
        """Takes in that a state is at least `bound` (B,): the Gaussian cut off there, by its first two moments.

        spread: variance of the bound itself, a number or (B,).
        """


class KalmanBank:
    """All filters in one set of arrays. Updates in Joseph's form, so covariances stay positive definite."""

    def __init__(self, x: Array, P: Array) -> None:
        check_covariance("P", P)
        self.x, self.P = x.copy(), P.copy()
        self._unit = np.eye(x.shape[1])
        self._diagonal = np.arange(x.shape[1])

    def restore(self, x: Array, P: Array) -> None:
        self.x, self.P = x, P

    def predict(self, state: Array, transition: Array, process: Array) -> None:
        self.x = state
        P = transition @ self.P @ np.swapaxes(transition, -1, -2)
        P[:, self._diagonal, self._diagonal] += process
        self.P = P

    def update(self, residual: Array, gradient: Array, variance: Any, use: Mask) -> Array:
        PH = (self.P @ gradient[:, :, None])[:, :, 0]
        expected = (PH * gradient).sum(axis=1) + variance
        K = PH * (use / expected)[:, None]
        self.x = self.x + K * np.where(use, residual, 0.0)[:, None]
        A = self._unit - K[:, :, None] * gradient[:, None, :]
        P = A @ self.P @ A.transpose(0, 2, 1)
        P += (K * np.reshape(variance, (-1, 1)))[:, :, None] * K[:, None, :]
        self.P = 0.5 * (P + P.transpose(0, 2, 1))
        return np.asarray(expected)

    def raise_to(self, index: int, bound: Array, use: Mask, spread: Any = 0.0) -> None:
        if not use.any():
            return
        variance = self.P[:, index, index] + spread
        deviation = np.sqrt(variance)
        shift, share = cut_below((bound - self.x[:, index]) / deviation)
        K = np.where(use[:, None], self.P[:, :, index] / variance[:, None], 0.0)
        self.x = self.x + K * (deviation * shift)[:, None]
        self.P = self.P - K[:, :, None] * K[:, None, :] * (variance * (1.0 - share))[:, None, None]


class FilterpyBank:
    """The same on `filterpy`, one ExtendedKalmanFilter each."""

    def __init__(self, x: Array, P: Array) -> None:
        from filterpy.kalman import ExtendedKalmanFilter  # it brings scipy.stats, which is slow to load

        check_covariance("P", P)
        self._filters = []
        for state, covariance in zip(x, P, strict=True):
            one = ExtendedKalmanFilter(dim_x=len(state), dim_z=1)
            one.x, one.P = state.copy(), covariance.copy()
            self._filters.append(one)

    @property
    def x(self) -> Array:
        """(B, n)"""
        return np.stack([one.x for one in self._filters])

    @property
    def P(self) -> Array:  # noqa: N802 - the filter's own name for it
        """(B, n, n)"""
        return np.stack([one.P for one in self._filters])

    def restore(self, x: Array, P: Array) -> None:
        for one, state, covariance in zip(self._filters, x, P, strict=True):
            one.x, one.P = state, covariance

    def predict(self, state: Array, transition: Array, process: Array) -> None:
        size = len(self._filters)
        transitions = np.broadcast_to(transition, (size, *transition.shape[-2:]))
        variances = np.broadcast_to(process, (size, process.shape[-1]))
        for one, after, F, variance in zip(self._filters, state, transitions, variances, strict=True):
            one.F, one.Q = F, np.diag(variance)
            one.predict()
            one.x = after.copy()  # filterpy knows linear predictions only

    def update(self, residual: Array, gradient: Array, variance: Any, use: Mask) -> Array:
        size = len(self._filters)
        expected = np.empty(size)
        rows = zip(self._filters, residual, gradient, np.broadcast_to(variance, (size,)), use, strict=True)
        for number, (one, y, H, R, used) in enumerate(rows):
            expected[number] = H @ one.P @ H + R
            if used:
                # filterpy forms the residual itself: the reading is told as its distance from the prediction.
                one.update(np.array([y]), lambda _, H=H: H[None, :], lambda _: np.zeros(1), R=np.array([[R]]))
        return expected

    def raise_to(self, index: int, bound: Array, use: Mask, spread: Any = 0.0) -> None:
        spreads = np.broadcast_to(spread, bound.shape)
        for one, lowest, used, apart in zip(self._filters, bound, use, spreads, strict=True):
            if used:
                variance = one.P[index, index] + apart
                deviation = np.sqrt(variance)
                shift, share = cut_below((lowest - one.x[index]) / deviation)
                K = one.P[:, index] / variance
                one.x = one.x + K * deviation * float(shift)
                one.P = one.P - np.outer(K, K) * variance * (1.0 - float(share))


def cut_below(bound: Any) -> tuple[Any, Any]:
    """Mean and variance of a standard Gaussian that is cut off below `bound`."""
    bound = np.clip(bound, -8.0, 30.0)
    density = np.exp(-0.5 * bound * bound) / np.sqrt(2.0 * np.pi)
    # Mills' ratio; far out its asymptote, where the tail underflows.
    tail = 0.5 * erfc(bound / np.sqrt(2.0))
    far = bound > 6.0
    safe = np.where(far, bound, 1.0)
    shift = np.where(far, safe + 1.0 / safe - 2.0 / safe**3, density / np.maximum(tail, 1e-300))
    variance = np.where(far, 1.0 / safe**2, 1.0 + bound * shift - shift * shift)
    return shift, np.clip(variance, 1e-6, 1.0)
