"""Two clocks: how far apart they are, and how long a message takes, from heartbeats that go to and fro."""

from __future__ import annotations

import time
from collections import deque

import numpy as np

STEP = 1_000_000
"""The offset in use follows the measured one in steps [ns], so that messages of one tick keep one stamp."""


class SteadyClock:
    """The machine's time of day at the start, and from then on steady: a clock set by NTP later does not jump here."""

    def __init__(self) -> None:
        self._offset = time.time_ns() - time.monotonic_ns()

    def __call__(self) -> int:
        """Nanoseconds since 1970."""
        return time.monotonic_ns() + self._offset


class LinkClock:
    """Offset and delay from (sent here, answered there, received here), all in ns.

    Of the last `window` round trips the shortest tells the offset best: its two ways had the least to wait for, and
    the error is at most half of it.
    """

    def __init__(self, window: int = 64) -> None:
        self._trips: deque[tuple[int, int]] = deque(maxlen=window)
        self._offset: int | None = None

    def add(self, sent: int, answered: int, received: int) -> None:
        """One round trip; an impossible one is left out."""
        if received < sent:
            return
        self._trips.append((received - sent, answered - (sent + received) // 2))
        measured = min(self._trips)[1]
        if self._offset is None or abs(measured - self._offset) >= STEP:
            self._offset = round(measured / STEP) * STEP

    def clear(self) -> None:
        """The far end is another one now."""
        self._trips.clear()
        self._offset = None

    @property
    def offset(self) -> int | None:
        """Far clock minus this one [ns], in steps; None before the first round trip."""
        return self._offset

    def statistics(self) -> dict[str, float]:
        """Offset, its bound, and one-way delay (half a round trip) in ms; empty before the first round trip."""
        if not self._trips:
            return {}
        shortest, offset = min(self._trips)
        delays = np.array([trip / 2 for trip, _ in self._trips]) * 1e-6
        p50, p99 = np.percentile(delays, [50.0, 99.0])
        return {
            "clock_offset_ms": offset * 1e-6,
            "clock_offset_error_ms": shortest / 2 * 1e-6,
            "delay_p50_ms": float(p50),
            "delay_p99_ms": float(p99),
        }
