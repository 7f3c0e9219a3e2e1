"""When the next control tick is due, and how well the ticks and the commands keep their time."""

from __future__ import annotations

import numpy as np

LARGEST_DEBT = 10
"""Ticks that may be caught up; what is more than that is dropped, and the simulation runs late."""
FIRST_RESPITE, LONGEST_RESPITE = 200, 12_800
"""Ticks that wait for no command after one that waited in vain."""


class Pacer:
    """Says when a tick is due so that simulated time runs `real_time_factor` times as fast as the wall clock.

    period_ns: control period. real_time_factor: 0 is as fast as possible: then a tick is always due.
    """

    def __init__(self, period_ns: int, real_time_factor: float) -> None:
        self._wall_period = period_ns / real_time_factor if real_time_factor > 0.0 else 0.0
        self._next = 0.0
        self.dropped = 0
        """Ticks of delay that were given up because the machine is too slow."""

    def restart(self, wall_ns: int) -> None:
        """Starts counting anew: the next tick is due one period from now."""
        self._next = wall_ns + self._wall_period

    def due(self, wall_ns: int) -> bool:
        """Whether a tick is due; if so it counts as taken."""
        if wall_ns < self._next:
            return False
        if self._wall_period > 0.0:
            debt = int((wall_ns - self._next) / self._wall_period)
            if debt > LARGEST_DEBT:
                self.dropped += debt
                self._next += debt * self._wall_period
            self._next += self._wall_period
        return True


class Patience:
    """Says whether a due tick waits for the command that answers the one before it.

    On a machine that is too slow for the graph, the simulation then runs slower than real time instead of leaving the
    robot without commands. A wait in vain is followed by ticks without any, at first `FIRST_RESPITE`, then twice as
    many: a commander with a lower rate of its own, or one that has died, holds up next to nothing.

    seconds: the longest wait, wall time; 0 is none.
    """

    def __init__(self, seconds: float) -> None:
        self._limit_ns = seconds * 1e9
        self._respite = 0
        self._next_respite = FIRST_RESPITE
        self._answered = 0

    def tick(self, answered: bool) -> None:
        """Counts a tick that was taken, with the command for it or without."""
        self._respite = max(self._respite - 1, 0)
        self._answered = self._answered + 1 if answered else 0
        if self._answered >= FIRST_RESPITE:
            self._next_respite = FIRST_RESPITE

    def waits(self, waited_ns: int) -> bool:
        """Whether to wait on, the last tick having been published `waited_ns` ago."""
        if self._respite > 0 or self._limit_ns == 0.0:
            return False
        if waited_ns < self._limit_ns:
            return True
        self._respite = self._next_respite
        self._next_respite = min(2 * self._next_respite, LONGEST_RESPITE)
        return False


class Latency:
    """Distribution of a delay in bins of 0.01 ms up to 1 s, in constant memory and time."""

    _BIN_MS = 0.01
    _BINS = 100_000

    def __init__(self) -> None:
        self._counts = np.zeros(self._BINS, dtype=np.int64)
        self.count = 0
        self.maximum_ms = 0.0

    def add(self, delay_ns: float) -> None:
        """Counts one delay."""
        milliseconds = delay_ns * 1e-6
        self._counts[min(max(int(milliseconds / self._BIN_MS), 0), self._BINS - 1)] += 1
        self.count += 1
        self.maximum_ms = max(self.maximum_ms, milliseconds)

    def percentile_ms(self, percent: float) -> float:
        """Delay [ms] that `percent` of all stay below, to the bin's upper edge; NaN without any."""
        if self.count == 0:
            return float("nan")
        number = int(np.searchsorted(np.cumsum(self._counts), percent / 100.0 * self.count))
        return min((number + 1) * self._BIN_MS, self.maximum_ms)
