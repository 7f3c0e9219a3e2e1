"""What a link of random lateness may do to every window, as a likelihood; and what any cause at all may, beside it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular, toeplitz
from scipy.optimize import lsq_linear

from simgap.inference.fit import Fitter
from simgap.inference.residual import weighed
from simgap.simulation.lateness import Lateness
from simgap.simulation.variant import Variant

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

_KNOTS = 60
"""At most so many pieces of a window in which commands are later or earlier than on average."""
_ORDER = 8
"""Samples that the autoregression looks back."""
_ROUNDS = 4
"""In which numbers and the size of each window's residual are fitted in turn."""


@dataclass(frozen=True)
class Room:
    """Where a step of numbers that enter linearly may lead.

    Attributes:
        at: (n,) where they are.
        precision: (n,) of their priors about 0.
        low, high: (n,) bounds.
    """

    at: Array
    precision: Array
    low: Array
    high: Array

    def prior(self, step: Array) -> float:
        """Cost [nats] of the priors after a step."""
        return 0.5 * float(self.precision @ (self.at + step) ** 2)


@dataclass(frozen=True)
class Likelihood:
    """How likely every window is under one law, as a function of n numbers that enter linearly.

    Attributes:
        square: (nw, 1 + n, 1 + n) products of residual and sensitivities in the metric of what the law predicts.
        volume: (nw,) half the log of the determinant of the predicted covariance [nats].
        samples: (nw,) recorded.
    """

    square: Array
    volume: Array
    samples: Array

    def costs(self, step: Array) -> Array:
        """Cost (nw,) [nats] of every window after a step (n,); a misfit may be larger than was predicted."""
        found = self._size(step)
        size = np.maximum(found, 1.0)
        cost: Array = 0.5 * self.samples * (np.log(size) + found / size) + self.volume
        return cost

    def fitted(self, room: Room, train: NDArray[np.bool_]) -> Array:
        """The step (n,) that the windows of ``train`` like best."""
        step: Array = np.zeros(len(room.at))
        if not len(step):
            return step
        for _ in range(_ROUNDS):
            normal, slope = self._normal(step, room, train)
            factor = np.linalg.cholesky(normal).T
            target = -np.linalg.solve(factor.T, slope)
            bounds = room.low - room.at - 1e-9, room.high - room.at + 1e-9
            # Not clipped: where several numbers make up for each other, a clipped step is worse than none.
            step = lsq_linear(factor, target, bounds, method="bvls").x
        return step

    def covariance(self, step: Array, room: Room) -> Array:
        """(n, n) Of the numbers, in all windows, about a step."""
        inverse: Array = np.linalg.inv(self._normal(step, room, np.ones(len(self.samples), bool))[0])
        return inverse

    def _normal(self, step: Array, room: Room, train: NDArray[np.bool_]) -> tuple[Any, Any]:
        weight = train / np.maximum(self._size(step), 1.0)
        normal = np.tensordot(weight, self.square, 1)
        return normal[1:, 1:] + np.diag(room.precision), normal[1:, 0] + room.precision * room.at

    def _size(self, step: Array) -> Array:
        """(nw,) Mean square of a window in units of what is predicted."""
        moved = np.concatenate([[1.0], step])
        size: Array = np.einsum("i,wij,j->w", moved, self.square, moved) / self.samples
        return size


def factor_of(response: Array, gram: Array, root: Array) -> Array:
    """Lower factor (nw, k, k) of 1 + root' gram root, for responses (nw, m, k) and their gram (nw, k, k)."""
    one = np.eye(root.shape[2])
    try:
        lower = np.linalg.cholesky(one + np.swapaxes(root, 1, 2) @ gram @ root)
    except np.linalg.LinAlgError:
        # A robot that falls over throws a late command so far that beside its square the 1 is lost in rounding.
        moved = response.astype(float) @ root
        upper = np.linalg.qr(np.concatenate([moved, np.broadcast_to(one, root.shape)], axis=1), mode="r")
        sign = np.sign(np.diagonal(upper, axis1=1, axis2=2))
        lower = np.swapaxes(sign[:, :, None] * upper, 1, 2)
    return np.asarray(lower, dtype=np.float64)


class Scatter:
    """Responses of all windows to commands that are later than on average in one piece of a window, and their law.

    All commands come over one link, so that one number for each piece moves all of them: by how much more or less than
    usual the command that acts lags behind, in standard deviations of what acts. The windows' covariance is that of
    these numbers (the law's memory), seen through the responses, on top of the noise floor's.
    """

    def __init__(self, fitter: Fitter, about: Variant, channels: Ints, lag: int, law: Lateness) -> None:
        """``about``: the model with the law's mean. ``lag``: rows between updates. ``law``: sizes of the responses."""
        self._fitter, self._channels, self._lag = fitter, channels, lag
        windows = fitter.windows
        # A command that comes late, and acts later still, was sent before the window.
        late = float(about.inputs.delay[channels].max()) / fitter.residuals.replayer.aligned.period
        before = min(max(round(late), 0), windows.warm_up)
        piece = max(lag, -(-(before + windows.length) // _KNOTS))
        self._starts = np.arange(0, before + windows.length, piece)
        self._rows = windows.start[:, None] + np.arange(-before, windows.length)
        self._deviation = self._moved(law)
        variants = [about]
        for start in self._starts:
            inside = self._rows[:, start : start + piece, None]
            variant = about.copy()
            variant.inputs.added = np.zeros_like(fitter.residuals.replayer.aligned.inputs)
            variant.inputs.added[inside, channels] = self._deviation[inside[..., 0]]
            variants.append(variant)
        found = fitter.residuals.of(variants)
        flat = (found[1:] - found[0]).reshape(len(self._starts), len(windows), -1)
        self._response: Array = np.moveaxis(flat, 0, -1)
        self._gram = np.swapaxes(self._response, 1, 2) @ self._response

    def likelihood(self, law: Lateness, residual: Array, sensitivities: Array) -> Likelihood:
        """Of residuals (nw, ns, nl) that the law leaves when its mean is replayed, and their sensitivities (n, ...)."""
        columns = np.concatenate([residual[None], sensitivities]).reshape(1 + len(sensitivities), len(residual), -1)
        seen = np.moveaxis(columns, 0, 1).astype(float)
        root = self._root(law)
        turned = np.swapaxes(root, 1, 2)
        factor = factor_of(self._response, self._gram, root)
        shadow = turned @ np.swapaxes(seen @ self._response, 1, 2)
        shadow = np.stack([solve_triangular(f, s, lower=True) for f, s in zip(factor, shadow, strict=True)])
        square = seen @ np.swapaxes(seen, 1, 2) - np.swapaxes(shadow, 1, 2) @ shadow
        volume = np.log(np.diagonal(factor, axis1=1, axis2=2)).sum(axis=1)
        return Likelihood(square, volume, np.maximum(self._fitter.count.sum(axis=1), 1.0))

    def whiten(self, law: Lateness, residual: Array) -> Array:
        """Residuals (nw, ns, nl) in units of noise floor and chance together."""
        return weighed(residual, *self.directions(law))

    def directions(self, law: Lateness) -> tuple[Array, Array]:
        """What chance does to a window: directions (nw, m, k), and how far it moves along each (nw, k) [floors]."""
        basis, size, _ = np.linalg.svd(self._response @ self._root(law), full_matrices=False)
        return basis, size

    def _moved(self, law: Lateness) -> Array:
        """(n, channels) By how much the acting commands scatter, with the sign of those that are late."""
        aligned = self._fitter.residuals.replayer.aligned
        inputs = aligned.inputs[:, self._channels]
        moved = np.zeros_like(inputs)
        for run in aligned.runs:
            part = slice(run.start, run.stop)
            mean, deviation = law.moments(inputs[part], self._lag)
            moved[part] = deviation * np.sign(mean - inputs[part])
        return moved

    def _root(self, law: Lateness) -> Array:
        """(nw, nk, nk) Root of the covariance of the pieces, in units of the responses."""
        length, piece = self._rows.shape[1], int(self._starts[1] if len(self._starts) > 1 else self._rows.shape[1])
        rows = np.arange(length)
        mean = np.zeros((len(self._starts), -(-length // self._lag)))
        np.add.at(mean, (rows // piece, rows // self._lag), 1.0)
        mean /= mean.sum(axis=1, keepdims=True)
        covariance = mean @ toeplitz(law.memory(mean.shape[1])) @ mean.T
        root = np.linalg.cholesky(covariance + 1e-8 * np.eye(len(covariance)))
        before, after = (self._sizes(d) for d in (self._deviation, self._moved(law)))
        result: Array = (after / np.maximum(before, 1e-12))[:, :, None] * root
        return result

    def _sizes(self, moved: Array) -> Array:
        """(nw, nk) Root mean square of a scatter (n, channels) in every piece, channels in units of their usual one."""
        unit = (self._deviation**2).mean(axis=0) + 1e-300
        square = (moved**2 / unit).sum(axis=1)[self._rows]
        sizes: Array = np.sqrt(np.add.reduceat(square, self._starts, axis=1))
        return sizes


def autoregression_costs(residual: Array, samples: Array) -> Array:
    """Cost (nw,) [nats] of residuals (nw, ns, nl) of no cause in particular.

    Every channel is a stationary process of any spectrum (an autoregression, fitted to these very residuals), whose
    size is unknown in every window. ``samples`` (nw,) are recorded.
    """
    size = np.maximum((residual**2).sum(axis=(1, 2)) / samples, 1e-12)
    cost = np.zeros(len(residual))
    for _ in range(_ROUNDS):
        scaled = residual / np.sqrt(size)[:, None, None]
        volume, square = 0.5 * samples * np.log(size), np.zeros(len(residual))
        for channel in np.moveaxis(scaled, 2, 0):
            for order in range(_ORDER + 1):
                # The first samples have a shorter past.
                now = channel[:, order:] if order == _ORDER else channel[:, order : order + 1]
                past = [channel[:, order - 1 - k :][:, : now.shape[1]] for k in range(order)]
                if past:
                    known = np.stack(past, axis=-1)
                    weights = np.linalg.lstsq(known.reshape(-1, order), now.reshape(-1), rcond=1e-10)[0]
                    now = now - known @ weights
                power = max(float((now**2).mean()), 1e-12)
                volume += 0.5 * now.shape[1] * np.log(power)
                square += (now**2).sum(axis=1) / power
        cost = volume + 0.5 * samples * (np.log(square / samples) + 1.0)
        size *= square / samples
    return cost
