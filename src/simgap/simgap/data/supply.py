"""The supply as it was measured beside a recording: what servos give goes with it."""

from __future__ import annotations

from collections.abc import Sequence

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
    """Voltage (n,) on the grid as a share of its median, the mean of all `auxiliary` channels in volts; or None.

    Where the map says in what runs differ, which may be their supply, the share is of each run's own median.
    """
    # A recording that was only simulated has no such channels.
    volts = [row.column for row in mapping.auxiliary if _volts(row.unit) and row.column in aligned.auxiliary]
    several = any(run.setup for run in aligned.runs)
    parts = [slice(r.start, r.stop) for r in aligned.runs] if several else [slice(None)]
    found = [shares for column in volts if (shares := _shares(aligned.auxiliary[column], parts)) is not None]
    if not found:
        return None
    mean: Array = np.mean(found, axis=0)
    return mean


def _shares(volts: Array, parts: Sequence[slice]) -> Array | None:
    """Of the median of each part; 1 where nothing was measured; None of what is zero, or never measured."""
    shares = np.ones(len(volts))
    for part in parts:
        known = volts[part][np.isfinite(volts[part])]
        usual = float(np.median(known)) if len(known) else 0.0
        if usual == 0.0:
            return None
        shares[part] = np.where(np.isfinite(volts[part]), volts[part] / usual, 1.0)
    return shares


def sways(supply: Array | None) -> bool:
    """Whether a supply was measured that is not always the same."""
    return supply is not None and float(np.std(supply)) > SWAYS


def _volts(unit: str | None) -> bool:
    try:
        factor(unit, ("voltage",), "auxiliary")
    except GapInputError:
        return False
    return True
