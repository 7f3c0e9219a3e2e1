"""Samples that no motion explains: each stands alone, or two of them do, far from those before and after.

A line that mistakes a bit, a tracker that takes one tag for another for a picture: one sample in a thousand, and as far
off as the robot reaches; two in a log that asks twice as often as the sensor answers. Nothing that has mass does that.
"""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

Array = NDArray[np.float64]

QUANTITIES = ("angle", "length")
"""What has mass behind it. A rate, a force or an acceleration may well jump for one sample, at an impact."""
_LONGEST = 2
"""Samples of one glitch."""
_FAR = 5.0
"""How far beyond two samples before and two behind, in what lies between those four and the usual step."""


def glitches(values: Array) -> NDArray[np.bool_]:
    """Which of a channel's values (n,) stand alone, or two together.

    A value that is not finite is none, and is nobody's neighbour. A corner of a motion stands out by a
    step at most, noise by a few of its deviations; both are in the steps around.
    """
    found = np.zeros(len(values), dtype=bool)
    rows = np.flatnonzero(np.isfinite(values))
    sampled = values[rows]
    steps = np.abs(np.diff(sampled))
    if len(rows) < _LONGEST + 4 or not steps.any():
        return found
    usual = float(np.median(steps[steps > 0.0]))
    for length in range(1, _LONGEST + 1):
        seen = sliding_window_view(sampled, length + 4)
        around, inside = seen[:, [0, 1, -2, -1]], seen[:, 2:-2]
        low, high = around.min(axis=1), around.max(axis=1)
        beyond = np.maximum(inside.min(axis=1) - high, low - inside.max(axis=1))
        (first,) = np.nonzero(beyond > _FAR * (high - low + usual))
        found[rows[first[:, None] + 2 + np.arange(length)]] = True
    return found
