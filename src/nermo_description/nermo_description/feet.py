"""Readings of tactile feet, by cell inside the code and by name in messages, without mujoco or ROS."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

from nermo_description.parameters import LEGS


def reading_names(cells: Iterable[str]) -> list[str]:
    """Names of what the cells of all feet read: cell after cell, legs in the order of LEGS, as front_left_CELL."""
    return [f"{leg}_{cell}" for cell in cells for leg in LEGS]


def named_readings(readings: Mapping[str, Iterable[float]]) -> tuple[list[str], list[float]]:
    """Names and voltages [V] of readings by cell, each in the order of LEGS: what a Tactile message says."""
    return reading_names(readings), [float(volts) for values in readings.values() for volts in values]


def readings_by_cell(names: Sequence[str], voltages: Sequence[float]) -> dict[str, list[float]]:
    """The other way: by cell, in the order of LEGS, NaN where a foot says nothing. Names of no leg are left out."""
    readings: dict[str, list[float]] = {}
    for name, volts in zip(names, voltages, strict=True):
        for foot, leg in enumerate(LEGS):
            if name.startswith(f"{leg}_"):
                readings.setdefault(name.removeprefix(f"{leg}_"), [math.nan] * len(LEGS))[foot] = volts
    return readings
