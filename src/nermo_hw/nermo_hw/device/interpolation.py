"""Trajectory interpolation on a board, with the over- and underflow heuristics of C 5.3.3."""

from __future__ import annotations

from collections import deque
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

Value = TypeVar("Value", float, NDArray[np.float64])

CAPACITY = 8
"""Points that a board can hold."""
GIVE_UP_AFTER = 10
"""Periods without a point after which the stream counts as ended: by then the speed has halved to a thousandth."""


class TrajectoryInterpolator(Generic[Value]):
    """Makes a set-point for every loop of the board out of points that come once in `period` loops, more or less.

    A point is reached at a constant speed within one period. With the heuristics (the start is our addition),

    - *underflow*: where a period ends and no point waits, the set-point goes on at half the speed; the next point to
      come is gone to at once, which starts the period anew;
    - *start*: the first point waits for one loop, so that later ones may come that much later and still be in time;
    - *overflow*: as long as another point waits when one is begun, the period is a loop shorter.

    Without them, a board keeps the newest point only, looks for it once a period, and stands still where there is none.

    position: where the set-point begins, a number or an array. period: loops from one point to the next, at least 2.
    """

    def __init__(self, position: Value, period: int, heuristics: bool = True) -> None:
        self.period = period
        self.heuristics = heuristics
        self.missed_points = 0
        """Periods that ended without a point to go on to, while points were coming."""
        self.filled_buffer_steps = 0
        """Periods that were made shorter because points were waiting."""
        self.dropped_points = 0
        """Points that were never gone to."""
        self._buffer: deque[Value] = deque()
        self.stop(position)

    @property
    def waiting(self) -> int:
        """Points in the buffer."""
        return len(self._buffer)

    @property
    def streaming(self) -> bool:
        """Whether points are coming."""
        return self._silent < GIVE_UP_AFTER

    def stop(self, position: Value) -> None:
        """Stays at a position until the next point; waiting ones are forgotten."""
        self.position: Value = position
        self.speed: Value = position * 0.0
        """Per loop."""
        self._goal: Value | None = None
        self._left = 0
        self._silent = GIVE_UP_AFTER
        self._waited = False
        self._buffer.clear()

    def add(self, point: Value) -> None:
        """Takes a point."""
        if not self.heuristics:
            self.dropped_points += len(self._buffer)
            self._buffer.clear()
        elif len(self._buffer) >= CAPACITY:
            self.dropped_points += 1
            self._buffer.popleft()
        self._buffer.append(point)

    def step(self) -> Value:
        """One loop of the board; returns the set-point."""
        at_once = self.heuristics and self._silent > 0 and len(self._buffer) > 0
        if self._left == 0 or at_once:
            if self._buffer and self.heuristics and not self.streaming and not self._waited:
                self._waited = True
                return self.position
            if self._buffer:
                self._begin(self._buffer.popleft())
            else:
                self._go_on()
        self._left -= 1
        if self._left == 0 and self._goal is not None:
            self.position = self._goal
        else:
            self.position = self.position + self.speed
        return self.position

    def _begin(self, point: Value) -> None:
        loops = self.period
        if self._buffer:
            self.filled_buffer_steps += 1
            loops = max(1, loops - 1)
        self._goal, self._left, self._silent, self._waited = point, loops, 0, False
        self.speed = (point - self.position) / loops

    def _go_on(self) -> None:
        self._goal, self._left = None, self.period
        self.speed = self.speed * (0.5 if self.heuristics else 0.0)
        if self._silent < GIVE_UP_AFTER:
            self._silent += 1
            self.missed_points += 1
        if self._silent == GIVE_UP_AFTER:
            self.speed = self.speed * 0.0
