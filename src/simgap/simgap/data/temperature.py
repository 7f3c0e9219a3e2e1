"""The temperature of motors as it was measured beside a recording: what they lose goes with it."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from simgap.data.align import Aligned
from simgap.data.known import thermometers
from simgap.data.mapping import Map

Array = NDArray[np.float64]

WARMS = 1.0
"""[K] by which a motor has to warm (or cool), that torque may go with it; less is the thermometer's."""
_BEGINNING = 0.5
"""[s] of which the first temperature is the mean."""
_PARTS = 8
"""Of a recording, whose medians are compared."""


def measured_warming(aligned: Aligned, model: mujoco.MjModel, mapping: Map) -> dict[int, Array]:
    """{actuator: by how much its motor is warmer than at the start (n,) [K]}, where that was measured."""
    found = {}
    for actuator, (column, kelvins) in thermometers(model, mapping).items():
        # A recording that was only simulated has no such channels.
        values = aligned.auxiliary.get(column, np.zeros(0))
        known = np.flatnonzero(np.isfinite(values))
        if not len(known):
            continue
        first = known[: max(round(_BEGINNING / aligned.period), 1)]
        rows = np.arange(len(values))
        found[actuator] = kelvins * (np.interp(rows, known, values[known]) - values[first].mean())
    return found


def warms(warming: Array) -> bool:
    """Whether a motor became warmer or cooler."""
    return float(np.ptp([np.median(part) for part in np.array_split(warming, _PARTS)])) > WARMS
