"""What this recording can tell apart: angles between what effects change, once nuisances have taken their part."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simgap.inference.fit import Fitter
from simgap.inference.hypothesis import Fit
from simgap.inference.screen import Screened, informative_windows

Array = NDArray[np.float64]

SEPARATE = 20.0
"""[deg] Effects whose responses lie closer than this are hard to tell apart in this recording."""
_SHOWN = 16
_REPEATS = 40
"""Simulated recordings for each truth of the confusion matrix."""
_CONFUSED = 6


def isolability(screened: Sequence[Screened], winner: Sequence[str]) -> dict[str, Any]:
    """Angles [deg] between the responses of the strongest candidates and of the winner, and its near neighbours.

    An angle is taken between lines (0 to 90): an effect and its opposite are one direction.
    """
    first = [s for s in screened if s.effect.key in winner]
    rest = [s for s in screened if s.effect.key not in winner]
    shown: list[Screened] = []
    for s in [*first, *rest]:
        if s.effect.key not in {t.effect.key for t in shown} and len(shown) < _SHOWN:
            shown.append(s)
    matrix = angle_matrix([s.response for s in shown])
    names = [s.effect.key for s in shown]
    near = {
        name: [names[j] for j in np.argsort(matrix[i]) if j != i and matrix[i, j] < SEPARATE]
        for i, name in enumerate(names)
        if name in winner
    }
    return {"effects": names, "angle_deg": np.round(matrix, 1).tolist(), "near": near, "near_below_deg": SEPARATE}


def angle_matrix(responses: Sequence[Array]) -> Array:
    """Angles [deg] between lines, (n, n); 90 for a response that is nil."""
    if not len(responses):
        return np.zeros((0, 0))
    stacked = np.array(responses)
    norms = np.linalg.norm(stacked, axis=1)
    unit = np.divide(stacked, norms[:, None], out=np.zeros_like(stacked), where=norms[:, None] > 0)
    cosine = np.abs(unit @ unit.T)
    angles: Array = np.degrees(np.arccos(np.clip(cosine, 0.0, 1.0)))
    np.fill_diagonal(angles, 0.0)
    return angles


def confusion(fitter: Fitter, fits: Sequence[Fit], seed: int = 0) -> dict[str, Any]:
    """How often a recording like this one, made by the model in the row, would be won by the model in the column.

    The recordings are simulated: what a fitted model predicts, plus what the first fit leaves, dealt to other windows
    with random signs. Every model is refitted to each, linearly, nuisances and priors included.
    """
    fits = list({f.hypothesis.key: f for f in fits}.values())[:_CONFUSED]
    if not fits:
        return {"effects": [], "probability": []}
    select = informative_windows(fitter, fits[0], 30)
    left = fits[0].residual[select].astype(float)
    root = np.sqrt(fitter.weights(fitter.mean_square(left, select), select))[:, None, :]
    shared = (fitter.jacobian[:, select] * root).reshape(len(fitter.jacobian), left.size).astype(float)
    solvers = []
    for fit in fits:
        own = (fitter.complete(fit).effect_jacobian[:, select] * root).reshape(len(fit.x), left.size)
        stacked = np.concatenate([own, shared])
        prior = np.concatenate([np.full(len(own), 1e-6), np.ones(len(shared))])
        pull = np.concatenate([np.zeros(len(own)), fit.z])
        solvers.append((stacked, np.linalg.cholesky(stacked @ stacked.T + np.diag(prior)), pull))
    rng = np.random.default_rng(seed)
    won = np.zeros((len(fits), len(fits)))
    for i, truth in enumerate(fits):
        for _ in range(_REPEATS):
            noise = left[rng.permutation(len(left))] * rng.choice([-1.0, 1.0], (len(left), 1, 1))
            costs = []
            for fit, (stacked, factor, pull) in zip(fits, solvers, strict=True):
                seen = ((fit.residual[select] - truth.residual[select] + noise) * root).reshape(-1)
                step = np.linalg.solve(factor, stacked @ seen + pull)
                price = float(fit.hypothesis.size)
                costs.append(0.5 * float(seen @ seen) + 0.5 * float(fit.z @ fit.z) - 0.5 * float(step @ step) + price)
            won[i, int(np.argmin(costs))] += 1.0 / _REPEATS
    return {"effects": [f.hypothesis.key for f in fits], "probability": np.round(won, 3).tolist()}
