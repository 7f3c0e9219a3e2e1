"""The one likelihood: how likely windows are under a hypothesis, given noise floor and discrepancy.

No robot obeys a law of a library down to its encoder's noise. What a hypothesis leaves is therefore noise *and*
discrepancy: a process of unknown size s_c in each channel c, stationary over the recording, and heavier-tailed than a
Gaussian, because a robot is now and then in a place that nobody modelled. For window w and channel c let q be the mean
square of the residual in noise floors (errors of the window's start and of measured inputs are whitened away before,
see `residual.py`) and n the number of independent samples in it. Then the residual is Student-t,

    -log p(q | s) = n/2 log(V) + (nu + n)/2 log(1 + n q / (nu V)),    V = 1 + s^2,

up to a constant. The scale V of each channel is inferred with everything else: in sample it is the likeliest one, for
held-out windows it is that of the windows that were fitted, so that a held-out score is a density of data that had no
say in it. n comes from the autocorrelation of what the nominal model leaves, once, and is the same for all hypotheses:
were it inferred for each, a slow error would pass for few samples and cost next to nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simgap.inference.thresholds import TAIL

Array = NDArray[np.float64]

PRIOR_WINDOWS = 1.0
"""Weight of the prior of no discrepancy, in windows that show none: decides only where there are few windows."""
_ROUNDS, _SETTLED = 60, 1e-4
"""Of the fixed-point iteration for the scale, at most; and the relative change that ends it."""


@dataclass
class Likelihood:
    """Student-t likelihood of windows, from their mean squares in noise floors.

    Attributes:
        recorded: (nw, nl) whether a channel was recorded in a window.
        independent: (nl,) independent samples n of each channel in one window.
    """

    recorded: NDArray[np.bool_]
    independent: Array

    def scale(self, square: Array, use: NDArray[np.bool_] | None = None) -> Array:
        """Likeliest V (..., nl), at least 1, of mean squares (..., nw, nl); of the windows ``use`` (nw,) if given."""
        recorded = self.recorded if use is None else self.recorded & use[:, None]
        n, weight = self.independent, recorded.astype(float)
        total = weight.sum(axis=0) + PRIOR_WINDOWS
        square = np.where(recorded, square, 0.0)
        scale = np.maximum(np.median(square, axis=-2), 1.0)
        for _ in range(_ROUNDS):
            pull = (TAIL + n) / (TAIL + n * square / scale[..., None, :])
            prior = PRIOR_WINDOWS * np.ones_like(scale)
            found = np.maximum(((weight * pull * square).sum(axis=-2) + prior) / total, 1.0)
            if np.all(np.abs(found - scale) <= _SETTLED * scale):
                return found
            scale = found
        return scale

    def costs(self, square: Array, scale: Array, recorded: NDArray[np.bool_] | None = None) -> Array:
        """Minus the log density (..., nw, nl) [nats] of windows at scales V (..., nl); 0 for q = 0 and V = 1."""
        recorded = self.recorded if recorded is None else recorded
        n, scale = self.independent, scale[..., None, :]
        found: Array = 0.5 * n * np.log(scale) + 0.5 * (TAIL + n) * np.log1p(n * square / (TAIL * scale))
        return np.where(recorded, found, 0.0)

    def cost(self, square: Array) -> Array:
        """Minus the log likelihood (...) of mean squares (..., nw, nl) at their likeliest scales."""
        total: Array = self.costs(square, self.scale(square)).sum(axis=(-2, -1))
        return total

    def weights(self, square: Array) -> Array:
        """Slope (..., nw, nl) of twice the cost by the mean square, at the likeliest scales: those of least squares."""
        n, scale = self.independent, self.scale(square)[..., None, :]
        found: Array = (TAIL + n) * n / (TAIL * scale + n * square)
        return np.where(self.recorded, found, 0.0)

    def held_out(self, square: Array, fold: NDArray[np.int64], trained: Array) -> Array:
        """Costs (nw,) of held-out windows, NaN where ``fold`` (nw,) is -1.

        ``square`` (nw, nl) are mean squares under the fit that has not seen a window; ``trained`` (nf, nw, nl) those of
        all windows under each fold's fit.
        """
        found = np.full(len(fold), np.nan)
        for f, own in enumerate(trained):
            test = fold == f
            costs = self.costs(square, self.scale(own, ~test)).sum(axis=-1)
            found[test] = costs[test]
        return found

    def of(self, select: NDArray[np.int64]) -> Likelihood:
        """That of selected windows."""
        return Likelihood(self.recorded[select], self.independent)
