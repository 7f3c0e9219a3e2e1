"""Samples that no motion explains: each stands alone, far from those before and after it.

A line that mistakes a bit, a tracker that takes one tag for another for a picture: one sample in a thousand, and as far
off as the robot reaches. Nothing that has mass does that.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

QUANTITIES = ("angle", "length")
"""What has mass behind it. A rate, a force or an acceleration may well jump for one sample, at an impact."""
_FAR = 5.0
"""How far beyond two samples before and two behind, in what lies between those four and the usual step."""


def glitches(values: Array) -> NDArray[np.bool_]:
    """Which of a channel's values (n,) stand alone. A value that is not finite is none, and is nobody's neighbour.

    A corner of a motion stands out by a step at most, noise by a few of its deviations; both are in the steps around.
    """
    found = np.zeros(len(values), dtype=bool)
    rows = np.flatnonzero(np.isfinite(values))
    sampled = values[rows]
    steps = np.abs(np.diff(sampled))
    if len(rows) < 5 or not steps.any():
        return found
    usual = float(np.median(steps[steps > 0.0]))
    around = np.stack([sampled[:-4], sampled[1:-3], sampled[3:-1], sampled[4:]])
    low, high = around.min(axis=0), around.max(axis=0)
    beyond = np.maximum(sampled[2:-2] - high, low - sampled[2:-2])
    found[rows[2:-2]] = beyond > _FAR * (high - low + usual)
    return found
