"""What becomes of servo commands on their way in a mouse that deviates: delay, zero, speed limit, play, dead band."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from nermo_description.parameters import RobotDescription

Array = NDArray[np.float64]


class CommandPath:
    """The way of the commands to the servos, tick by tick.

    servos: in the order of the commands. period: of the control ticks [s].
    """

    def __init__(self, robot: RobotDescription, servos: Sequence[str], period: float) -> None:
        count = len(servos)
        self._delay, self._offset = np.zeros(count), np.zeros(count)
        self._step, self._band, self._play = np.full(count, np.inf), np.zeros(count), np.zeros(count)
        for deviation in robot.deviations:
            rows, values = [servos.index(site) for site in deviation.sites if site in servos], deviation.values
            match deviation.effect:
                case "servo_delay":
                    self._delay[rows] += values["delay"] / period
                case "servo_offset":
                    self._offset[rows] += values["offset"]
                case "servo_rate_limit":
                    self._step[rows] = np.minimum(self._step[rows], values["limit"] * period)
                case "servo_dead_band":
                    self._band[rows] += values["half_width"]
                case "servo_backlash":
                    self._play[rows] += 0.5 * values["width"]
        self._past: deque[Array] = deque(maxlen=int(np.ceil(self._delay.max(initial=0.0))) + 2)
        self._now: Array | None = None

    @property
    def neutral(self) -> bool:
        """Whether commands arrive as they were given."""
        changed = self._delay.any() or self._offset.any() or self._band.any() or self._play.any()
        return not changed and bool(np.isinf(self._step).all())

    def clear(self) -> None:
        """Forgets the past, as after a reset."""
        self._past.clear()
        self._now = None

    def __call__(self, commands: Array, positions: Array) -> Array:
        """What the servos act on in this tick: commands and measured positions [rad], shape (servos,)."""
        self._past.appendleft(np.array(commands, dtype=np.float64))
        last = len(self._past) - 1
        near = np.minimum(self._delay.astype(np.int64), last)
        share = self._delay - self._delay.astype(np.int64)
        past = np.stack(self._past)
        columns = np.arange(len(commands))
        wanted = (1.0 - share) * past[near, columns] + share * past[np.minimum(near + 1, last), columns]
        if self._now is None:
            self._now = wanted.copy()
        moved = np.clip(wanted, self._now - self._step, self._now + self._step)
        # A play carries its output along at its flanks only.
        self._now = np.where(self._play > 0.0, np.clip(self._now, moved - self._play, moved + self._play), moved)
        target: Array = self._now + self._offset
        return np.where(np.abs(target - positions) < self._band, positions, target)
