"""Smooth moves from one servo position to another."""

from __future__ import annotations

from collections.abc import Sequence


def smooth(share: float) -> float:
    """Minimum-jerk blend from 0 to 1: at rest and without acceleration at both ends; flat outside [0, 1]."""
    s = 0.0 if share < 0.0 else 1.0 if share > 1.0 else share
    return s * s * s * (10.0 + s * (6.0 * s - 15.0))


PEAK_VELOCITY = 1.875
"""Largest slope of `smooth`, in its middle."""


BRAKING = 0.05
"""What moves when a move begins comes to rest within this time [s]."""
_ASIDE = 16.0 / 81.0
"""Largest value of the polynomial in `coast`, after a third of the time."""


def coast(speed: float, elapsed: float) -> float:
    """How far off its way [rad] a servo is that had a speed [rad/s] when the way began, some time [s] ago.

    It leaves with that speed and no acceleration, is never on the other side, and is back at rest after `BRAKING`.
    """
    s = elapsed / BRAKING
    if s >= 1.0:
        return 0.0
    return speed * BRAKING * s * (1.0 + s * s * (s * (8.0 - 3.0 * s) - 6.0))


def fastest_braked(room: float, delay: float) -> float:
    """Speed [rad/s] from which a servo comes to rest within a room [rad] if it coasts after a delay [s]."""
    return max(room, 0.0) / (delay + _ASIDE * BRAKING)


class Approach:
    """From `start` [rad] to a goal that may itself move: smoothly to begin with, and as it is from then on.

    It takes as long as a `Blend` to the first goal, none of whose servos is faster than `velocity` [rad/s]; servos
    that move at `speeds` [rad/s] `coast` beside.
    """

    def __init__(self, start: Sequence[float], speeds: Sequence[float], velocity: float, stamp: int) -> None:
        self._start, self._speeds, self._velocity, self._stamp = tuple(start), tuple(speeds), velocity, stamp
        self._duration: float | None = None

    def at(self, stamp: int, goal: Sequence[float]) -> list[float]:
        """Servo positions [rad] at a time [ns], where the goal is now there."""
        if self._duration is None:
            farthest = max(abs(b - a) for a, b in zip(self._start, goal, strict=True))
            self._duration = max(PEAK_VELOCITY * farthest / self._velocity, _braking(self._speeds))
        elapsed = (stamp - self._stamp) * 1e-9
        if elapsed >= self._duration:
            return list(goal)
        share = smooth(elapsed / self._duration)
        return _between(self._start, goal, share, self._speeds, elapsed)


class Blend:
    """A move of all servos from `start` to `end` [rad], none faster than `velocity` [rad/s].

    Servos that move at `speeds` [rad/s] as it begins do not stop at once: they `coast` beside the way.
    """

    def __init__(
        self, start: Sequence[float], speeds: Sequence[float], end: Sequence[float], velocity: float, stamp: int
    ) -> None:
        farthest = max(abs(b - a) for a, b in zip(start, end, strict=True))
        self._start, self._speeds, self._end, self._stamp = tuple(start), tuple(speeds), tuple(end), stamp
        self._duration = max(PEAK_VELOCITY * farthest / velocity, _braking(speeds))

    def done(self, stamp: int) -> bool:
        """Whether the move is over at a time [ns]."""
        return (stamp - self._stamp) * 1e-9 >= self._duration

    def at(self, stamp: int) -> list[float]:
        """Servo positions [rad] at a time [ns]."""
        if self.done(stamp):
            return list(self._end)
        elapsed = (stamp - self._stamp) * 1e-9
        return _between(self._start, self._end, smooth(elapsed / self._duration), self._speeds, elapsed)


def _braking(speeds: Sequence[float]) -> float:
    return BRAKING if any(speeds) else 0.0


def _between(
    start: Sequence[float], end: Sequence[float], share: float, speeds: Sequence[float], elapsed: float
) -> list[float]:
    return [a + share * (b - a) + coast(v, elapsed) for a, b, v in zip(start, end, speeds, strict=True)]
