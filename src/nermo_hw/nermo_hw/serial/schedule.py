"""A cycle in fixed steps of time that tells the truth about itself (C 5.2.2.3)."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

REMEMBERED = 4096
"""Cycles of which the lateness is kept."""


@dataclass(frozen=True, slots=True)
class Tick:
    """The begin of a cycle."""

    number: int
    """Step of the grid that this is; it jumps where steps were missed."""
    elapsed: float
    """Since the begin of the cycle before [s]; 0 for the first."""
    lateness: float
    """Behind the grid [s]."""
    missed: int
    """Steps that passed while the cycle before was still running."""


class FixedStepSchedule:
    """Waits for the next step of a grid in time.

    A cycle that takes too long does not shift the grid: its missed steps are counted and told, and the next cycle
    begins at the next step to come. Whoever works with the ticks uses `elapsed`, not the period.

    period: [s]. clock and sleep: in ns and s, to run it in another time than the machine's.
    """

    def __init__(
        self,
        period: float,
        clock: Callable[[], int] = time.monotonic_ns,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        if not 1e-4 <= period <= 10.0:
            raise ValueError(f"period = {period} s: must be within 0.0001 s and 10 s")
        self.period = period
        self._clock, self._sleep = clock, sleep
        self._lateness: deque[float] = deque(maxlen=REMEMBERED)
        self.cycles = self.overruns = self.missed = 0
        """Cycles begun, cycles that took longer than a period, steps that passed meanwhile."""
        self.restart()

    def restart(self) -> None:
        """Starts a new grid now; the next cycle begins at once."""
        self._origin, self._number = self._clock(), -1
        self._last_begin: int | None = None

    def wait(self) -> Tick:
        """Sleeps until the next step."""
        now, period = self._clock(), self.period * 1e9
        number = self._number + 1
        # Being late by less than a period is jitter of this step; from then on the step is missed.
        behind = int((now - (self._origin + number * period)) // period)
        missed = max(behind, 0)
        if missed:
            self.overruns += 1
            self.missed += missed
            number += missed
        due = self._origin + round(number * period)
        while (now := self._clock()) < due:
            self._sleep((due - now) * 1e-9)
        elapsed = 0.0 if self._last_begin is None else (now - self._last_begin) * 1e-9
        self._number, self._last_begin = number, now
        self.cycles += 1
        lateness = (now - due) * 1e-9
        self._lateness.append(lateness)
        return Tick(number, elapsed, lateness, missed)

    def jitter(self) -> dict[str, float]:
        """Lateness of the last cycles: `p50`, `p99` and `max` [s]; NaN before the first."""
        if not self._lateness:
            return dict.fromkeys(("p50", "p99", "max"), float("nan"))
        p50, p99, largest = np.percentile(np.array(self._lateness), [50.0, 99.0, 100.0]).tolist()
        return {"p50": p50, "p99": p99, "max": largest}
