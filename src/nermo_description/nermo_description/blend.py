"""Smooth moves from one servo position to another."""

from __future__ import annotations

from collections.abc import Sequence


def smooth(share: float) -> float:
    """Minimum-jerk blend from 0 to 1: at rest and without acceleration at both ends; flat outside [0, 1]."""
    s = 0.0 if share < 0.0 else 1.0 if share > 1.0 else share
    return s * s * s * (10.0 + s * (6.0 * s - 15.0))


PEAK_VELOCITY = 1.875
"""Largest slope of `smooth`, in its middle."""


class Approach:
    """From `start` [rad] to a goal that may itself move: smoothly to begin with, and as it is from then on.

    It takes as long as a `Blend` to the first goal, none of whose servos is faster than `velocity` [rad/s].
    """

    def __init__(self, start: Sequence[float], velocity: float, stamp: int) -> None:
        self._start, self._velocity, self._stamp = tuple(start), velocity, stamp
        self._duration: float | None = None

    def at(self, stamp: int, goal: Sequence[float]) -> list[float]:
        """Servo positions [rad] at a time [ns], where the goal is now there."""
        if self._duration is None:
            farthest = max(abs(b - a) for a, b in zip(self._start, goal, strict=True))
            self._duration = PEAK_VELOCITY * farthest / self._velocity
        elapsed = (stamp - self._stamp) * 1e-9
        if elapsed >= self._duration:
            return list(goal)
        share = smooth(elapsed / self._duration)
        return [a + share * (b - a) for a, b in zip(self._start, goal, strict=True)]


class Blend:
    """A move of all servos from `start` to `end` [rad], none faster than `velocity` [rad/s]."""

    def __init__(self, start: Sequence[float], end: Sequence[float], velocity: float, stamp: int) -> None:
        farthest = max(abs(b - a) for a, b in zip(start, end, strict=True))
        self._start, self._end, self._stamp = tuple(start), tuple(end), stamp
        self._duration = PEAK_VELOCITY * farthest / velocity

    def done(self, stamp: int) -> bool:
        """Whether the move is over at a time [ns]."""
        return (stamp - self._stamp) * 1e-9 >= self._duration

    def at(self, stamp: int) -> list[float]:
        """Servo positions [rad] at a time [ns]."""
        if self.done(stamp):
            return list(self._end)
        share = smooth((stamp - self._stamp) * 1e-9 / self._duration)
        return [a + share * (b - a) for a, b in zip(self._start, self._end, strict=True)]
