"""Names a gait from when the feet touch down, and not from what was commanded."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from nermo_control.pantograph_gaits import PANTOGRAPH_GAITS
from nermo_sensors.bench.walk import steady_contact

Array = NDArray[np.float64]

LAGS = {
    "pronk": (0.0, 0.0, 0.0),
    **{
        name: tuple((gait.phase_offsets[2] - gait.phase_offsets[leg]) % 1.0 for leg in (0, 1, 3))
        for name, gait in PANTOGRAPH_GAITS.items()
    },
}
"""Touch-down of front left, front right and rear right after the rear left's, in cycles."""
STEADY = 0.7
"""Mean resultant length of the lags from which a gait is one [1]."""
NEAR = 0.125
"""Largest mean distance of the lags from those of a named gait, in cycles: half of an eighth apart is a walk's."""


def touch_down_lags(touch_downs: Sequence[Array]) -> tuple[Array, Array, float]:
    """Lags of three feet after the rear left one as in `LAGS`, their steadiness in [0, 1], and strides a second [Hz].

    `touch_downs`: times [s] of each foot's. Raises ValueError where the rear left foot has fewer than three.
    """
    reference = touch_downs[2]
    if len(reference) < 3:
        raise ValueError(f"the rear left foot touches down {len(reference)} times: at least 3 are needed")
    lags, steadiness = np.full(3, np.nan), np.zeros(3)
    for number, leg in enumerate((0, 1, 3)):
        times = touch_downs[leg]
        times = times[(times >= reference[0]) & (times < reference[-1])]
        if len(times) == 0:
            continue
        stride = np.searchsorted(reference, times, side="right") - 1
        shares = (times - reference[stride]) / (reference[stride + 1] - reference[stride])
        mean = np.mean(np.exp(2j * np.pi * shares))
        lags[number], steadiness[number] = np.angle(mean) / (2.0 * np.pi) % 1.0, abs(mean)
    return lags, steadiness, float((len(reference) - 1) / (reference[-1] - reference[0]))


def name_gait(touch_downs: Sequence[Array]) -> str:
    """The nearest gait of `LAGS`; `unsteady` where the lags wander, `between gaits` where none is near, `standing`."""
    if len(touch_downs[2]) < 3:
        return "standing"
    lags, steadiness, _ = touch_down_lags(touch_downs)
    if not np.all(steadiness >= STEADY):
        return "unsteady"
    distances = {}
    for name, pattern in LAGS.items():
        apart = np.abs((lags - np.array(pattern) + 0.5) % 1.0 - 0.5)
        distances[name] = float(apart.mean())
    nearest = min(distances, key=distances.__getitem__)
    return nearest if distances[nearest] <= NEAR else "between gaits"


def touch_downs(loads: Array, time: Array, threshold: float, bounce: float = 0.05) -> list[Array]:
    """Touch-downs [s] of each foot from its loads (n, 4) [N]; what is shorter than `bounce` [s] is not."""
    period = float(np.median(np.diff(time)))
    found = []
    for leg in range(loads.shape[1]):
        down = steady_contact(loads[:, leg] > threshold, period, bounce)
        found.append(time[1:][down[1:] & ~down[:-1]])
    return found
