"""The supply as it was measured beside a recording: what servos give goes with it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simgap.data.align import Aligned
from simgap.data.errors import GapInputError
from simgap.data.mapping import Map
from simgap.data.units import factor

Array = NDArray[np.float64]

SWAYS = 0.01
"""Scatter of a voltage, as a share of it, from which on torque may go with it; less is the voltmeter's."""


def measured_supply(aligned: Aligned, mapping: Map) -> Array | None:
    """Voltage (n,) on the grid as a share of its median, the mean of all `auxiliary` channels in volts; or None."""
    volts = [row.column for row in mapping.auxiliary if _volts(row.unit)]
    # A recording that was only simulated has none.
    found = [aligned.auxiliary[column] for column in volts if column in aligned.auxiliary]
    found = [v / float(np.nanmedian(v)) for v in found if abs(float(np.nanmedian(v))) > 0.0]
    if not found:
        return None
    mean: Array = np.nan_to_num(np.mean(found, axis=0), nan=1.0)
    return mean


def sways(supply: Array | None) -> bool:
    """Whether a supply was measured that is not always the same."""
    return supply is not None and float(np.std(supply)) > SWAYS


def _volts(unit: str | None) -> bool:
    try:
        factor(unit, ("voltage",), "auxiliary")
    except GapInputError:
        return False
    return True
