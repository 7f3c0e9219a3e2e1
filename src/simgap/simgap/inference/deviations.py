"""How well a fit knows its nominal numbers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simgap.inference.fit import Fitter
from simgap.inference.hypothesis import Fit

Array = NDArray[np.float64]


def nuisance_deviation(fitter: Fitter, fit: Fit) -> Array:
    """Standard error (nz,) of each nuisance: that of the fit with its prior, or that of the folds where it is larger.

    The effects' parameters are free beside them.
    """
    ne, nn = len(fit.x), len(fit.z)
    weights = fitter.weights(fitter.mean_square(fit.residual))
    root = np.sqrt(np.broadcast_to(weights[:, None, :], fit.residual.shape)).reshape(-1)
    stacked = np.concatenate([fit.effect_jacobian, fitter.jacobian]).reshape(ne + nn, -1) * root
    prior = np.r_[np.full(ne, 1e-6), np.ones(nn)]
    own = np.sqrt(np.maximum(np.diag(np.linalg.inv(stacked @ stacked.T + np.diag(prior))), 0.0))[ne:]
    folds = len(fit.fold_z)
    if folds < 2:
        return own
    spread = np.sqrt((folds - 1) / folds * ((fit.fold_z - fit.fold_z.mean(axis=0)) ** 2).sum(axis=0))
    found: Array = np.maximum(own, spread)
    return found
