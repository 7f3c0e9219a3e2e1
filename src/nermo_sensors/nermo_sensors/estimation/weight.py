"""The four loads as one: together they carry the body, as heavy as the IMU says that it is."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def share_weight(load: Array, variance: Array, weight: float, weight_variance: float) -> tuple[Array, Array]:
    """Loads (B,) [N] and variances [N^2] once their sum is known to be `weight` [N], up to `weight_variance` [N^2].

    The Gaussian of independent loads, conditioned on their sum: each foot takes of what is missing by its variance.
    It is for the answer only and never fed back into the filters, whose errors would then depend on each other.

    Raises ValueError for a variance of the weight that is not positive, or a weight that is not finite.
    """
    if not (np.isfinite(weight) and np.isfinite(weight_variance) and weight_variance > 0.0):
        raise ValueError(
            f"weight = {weight} N with variance {weight_variance} N^2: must be finite, the variance above 0"
        )
    share = variance / (float(variance.sum()) + weight_variance)
    return load + share * (weight - float(load.sum())), variance * (1.0 - share)


def felt_weight(mass: float, orientation: Sequence[float], acceleration: Sequence[float]) -> float:
    """What the feet bear [N] of a `mass` [kg]: mass times the upward acceleration that an IMU feels [m/s^2].

    orientation: of the IMU in the world, unit quaternion (w, x, y, z); acceleration: in its axes, +9.81 up at rest.
    """
    w, x, y, z = orientation
    ax, ay, az = acceleration
    return mass * (2.0 * (x * z - w * y) * ax + 2.0 * (y * z + w * x) * ay + (1.0 - 2.0 * (x * x + y * y)) * az)
