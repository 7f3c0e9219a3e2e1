"""Which cells can be believed: what is missing, frozen, out of range, or contradicts everything else."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


class Fault(Enum):
    """What is wrong with a cell."""

    NONE = "none"
    MISSING = "no reading"
    FROZEN = "reads the same number all the time"
    IMPLAUSIBLE = "reads what it never should"
    INVERTED = "reads more in the air than on the ground"
    CONTRADICTION = "contradicts the other cells"


@dataclass(frozen=True, slots=True)
class HealthLimits:
    """When a cell is no longer believed."""

    missing_after: float = 0.1
    """[s] without a reading."""
    frozen_after: float = 0.5
    """[s] with exactly the same reading. Noise of half a count or more makes every healthy cell move."""
    surprise: float = 30.0
    """Mean squared residual over its expected variance; 1 is normal."""
    window: float = 0.5
    """Over which surprises are averaged [s]."""
    strides: float = 1.0
    """Over which readings in the air, and those on the ground, are averaged [s]; they are compared when there is as
    much of both. In a single stride a foot may well bear more in the air, where the robot turns or slips."""
    high_pass: float = 0.08
    """Both cells are compared as this high-pass leaves them, which is what a charge amplifier does [s]."""
    recover_after: float = 1.0
    """[s] of good readings before a cell is believed again."""


@dataclass(frozen=True, slots=True)
class Expected:
    """What is known of a cell beforehand."""

    feels_rest: bool = True
    """Whether it feels a load that rests, and not only its changes."""
    lowest: float = -np.inf
    """It never reads less, as no load is negative [V]."""
    span: float = np.inf
    """Of its readings [V]."""


class HealthMonitor:
    """Watches the C cells of B feet."""

    def __init__(self, cells: Sequence[Expected], count: int, limits: HealthLimits | None = None) -> None:
        self._limits, self._count = limits or HealthLimits(), count
        self._lowest, self._span = (np.array([[getattr(cell, name)] for cell in cells]) for name in ("lowest", "span"))
        self.feels_rest = np.array([cell.feels_rest for cell in cells])
        """(C,)"""
        self._reference = int(np.argmax(self.feels_rest)) if self.feels_rest.any() else None
        """The cell whose changes those are held against that feel nothing else."""
        self.clear()

    def clear(self) -> None:
        """Takes every cell for healthy."""
        shape = (len(self.feels_rest), self._count)
        self._last = np.full(shape, np.nan)
        self._absent, self._same, self._good = np.zeros(shape), np.zeros(shape), np.zeros(shape)
        self.surprise = np.ones(shape)
        """Running mean of squared residual over expected variance."""
        self._low = np.zeros(shape)
        self._slow, self._products = np.full(self._count, np.nan), np.zeros((3, *shape))
        self._ground_air, self._lasted = np.zeros((2, *shape)), np.zeros((2, *shape))
        self.faults: list[list[Fault]] = [[Fault.NONE] * self._count for _ in self.feels_rest]
        self._trusted = np.ones(shape, dtype=bool)

    @property
    def trusted(self) -> Mask:
        """(C, B): which cells to use."""
        return self._trusted

    def watch(self, period: float, readings: Array, surprise: Array, swing: Mask | None = None) -> None:
        """Takes in the readings (C, B) [V] after a period [s], and how surprising each was (C, B), NaN if unknown.

        `swing` (B,) says which feet are in the air by intention, where that is known and the robot walks.
        """
        limits = self._limits
        present = np.isfinite(readings)
        self._absent = np.where(present, 0.0, self._absent + period)
        self._same = np.where(present & (readings == self._last), self._same + period, 0.0)
        self._last = np.where(present, readings, self._last)
        share = min(1.0, period / limits.window)
        known = np.isfinite(surprise)
        # One wild residual, as at a foot strike, must not count for more than a few seconds of calm.
        step = np.where(known, np.minimum(surprise, 20.0 * limits.surprise), self.surprise) - self.surprise
        self.surprise = self.surprise + share * step
        with np.errstate(invalid="ignore"):
            below = present & (readings < self._lowest)
        self._low = np.where(below, self._low + period, 0.0)

        self._compare(period, readings, present)
        if swing is not None:
            for where, rows in enumerate((~swing & present, swing & present)):
                self._lasted[where] += np.where(rows, period, 0.0)
                share = period / np.clip(self._lasted[where], period, limits.strides)
                mean = self._ground_air[where]
                self._ground_air[where] = np.where(rows, mean + share * (readings - mean), mean)

        wrong = np.zeros(self._trusted.shape, dtype=bool)
        for cell in range(len(wrong)):
            for foot in range(self._count):
                fault = self._fault(cell, foot)
                if fault is not Fault.NONE:
                    self.faults[cell][foot] = fault
                    wrong[cell, foot] = True
        self._good = np.where(wrong, 0.0, self._good + period)
        for cell, foot in np.argwhere(~wrong & ~self._trusted & (self._good >= limits.recover_after)):
            self.faults[cell][foot] = Fault.NONE
        self._trusted = ~wrong & (self._trusted | (self._good >= limits.recover_after))

    def _compare(self, period: float, readings: Array, present: Mask) -> None:
        """Running correlation of every cell with the changes of the reference."""
        if self._reference is None:
            return
        limits, static, there = self._limits, readings[self._reference], present[self._reference]
        slow = np.where(np.isnan(self._slow), static, self._slow)
        slow = slow + min(1.0, period / limits.high_pass) * (static - slow)
        self._slow = np.where(there, slow, self._slow)
        x, y = np.broadcast_to(static - self._slow, readings.shape), readings
        products = np.stack([x * y, x * x, y * y])
        share = min(1.0, 0.5 * period / limits.window)
        both = present & there
        self._products = np.where(both, self._products + share * (products - self._products), self._products)

    @property
    def _opposed(self) -> Mask:
        """(C, B): which change against the reference, and far enough to be sure."""
        product, x2, y2 = self._products
        enough = x2 > (0.02 * self._span[self._reference]) ** 2
        return np.asarray(enough & (product < -0.3 * np.sqrt(x2 * y2)))

    def _fault(self, cell: int, foot: int) -> Fault:
        limits = self._limits
        if self._absent[cell, foot] >= limits.missing_after:
            return Fault.MISSING
        if self._same[cell, foot] >= limits.frozen_after:
            return Fault.FROZEN
        if self._low[cell, foot] >= limits.missing_after:
            return Fault.IMPLAUSIBLE
        ground, air = self._ground_air[:, cell, foot]
        if (self._lasted[:, cell, foot] >= limits.strides).all() and air - ground > 0.1 * self._span[cell, 0]:
            return Fault.INVERTED
        reference = self._reference
        if (
            reference is not None
            and not self.feels_rest[cell]
            and self._trusted[reference, foot]
            and self._opposed[cell, foot]
        ):
            return Fault.CONTRADICTION
        # If several surprise, the one that surprises most is blamed; the others are needed.
        others = self._trusted[:, foot].copy()
        others[cell] = False
        mine = self.surprise[cell, foot]
        if mine > limits.surprise and not (self.surprise[others, foot] > mine).any():
            return Fault.CONTRADICTION
        return Fault.NONE
