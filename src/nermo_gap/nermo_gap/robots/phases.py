"""Gait phases of a channel: swing, touch-down and stance of the leg that it belongs to."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nermo_description.parameters import LEGS
from nermo_gap.robots.channels import phase
from simgap.data.align import Aligned
from simgap.data.channels import OutputChannel

Mask = NDArray[np.bool_]

TOUCH_DOWN = 0.08
"""[s] from the end of a swing on."""


def gait_phases(aligned: Aligned, channel: OutputChannel) -> dict[str, Mask] | None:
    """Rows of the grid in each phase of the channel's leg; of the whole body, by how many legs swing.

    None where the recording does not say what the legs do.
    """
    if any(phase(leg) not in aligned.auxiliary for leg in LEGS):
        return None
    swings = {leg: np.nan_to_num(aligned.auxiliary[phase(leg)]) > 0.5 for leg in LEGS}
    leg = next((leg for leg in LEGS if channel.name.startswith(leg)), None)
    if leg is not None:
        swing = swings[leg]
        landing = ~swing & _after(swing, max(round(TOUCH_DOWN / aligned.period), 1))
        return {"swing": swing, "touch-down": landing, "stance": ~swing & ~landing}
    count = np.stack(list(swings.values())).sum(axis=0)
    return {"all legs down": count == 0, "one leg up": count == 1, "two or more legs up": count >= 2}


def _after(condition: Mask, rows: int) -> Mask:
    """Rows within ``rows`` after the condition held."""
    reached = np.convolve(condition, np.ones(rows + 1), mode="full")[: len(condition)]
    result: Mask = reached > 0.5
    return result
