"""The door for servo commands from outside: matched by name, refused in words."""

from __future__ import annotations

from collections.abc import Sequence

from nermo_description.commanding import RefusedCommandError, command_time
from nermo_description.ranges import SERVO_TARGET, named_error

__all__ = ["RefusedCommandError", "ServoCommandDoor"]


class ServoCommandDoor:
    """Lets through each command once, complete, in range and not too old.

    servos: the robot's servos, in the order of the result. oldest: age beyond which a command is stale [s]. lead: how
    far its stamp may be ahead [s], where it comes from another clock.
    """

    def __init__(self, servos: Sequence[str], oldest: float, lead: float = 0.0) -> None:
        self._servos = tuple(servos)
        self._known = frozenset(servos)
        self._oldest, self._lead = oldest, lead
        self._last_stamp: int | None = None

    def open(self, stamp: int, names: Sequence[str], positions: Sequence[float], now: int) -> list[float]:
        """Servo positions [rad] in the robot's order.

        stamp and now [ns] are on the same clock; a stamp of 0 counts as now.
        Raises RefusedCommandError, which says why.
        """
        if len(names) != len(positions):
            raise RefusedCommandError(f"{len(names)} names but {len(positions)} positions")
        by_name = dict(zip(names, positions, strict=True))
        if by_name.keys() != self._known or len(names) != len(self._servos):
            raise RefusedCommandError(self._naming(names))
        result = [by_name[name] for name in self._servos]
        if (wrong := named_error(SERVO_TARGET, "position", self._servos, result)) is not None:
            raise RefusedCommandError(wrong)
        stamp = command_time(stamp, now, self._oldest, self._lead)
        if self._last_stamp is not None and stamp <= self._last_stamp:
            word = "repeated" if stamp == self._last_stamp else "out of order"
            raise RefusedCommandError(
                f"{word}: stamp {stamp * 1e-9:.6f} s, the last one was {self._last_stamp * 1e-9:.6f} s"
            )
        self._last_stamp = stamp
        return result

    def _naming(self, names: Sequence[str]) -> str:
        unknown = sorted(set(names) - self._known)
        if unknown:
            return f"unknown servo {', '.join(unknown)}: the robot has {', '.join(self._servos)}"
        lacking = [name for name in self._servos if name not in names]
        if lacking:
            return f"{len(names)} servos named, {len(self._servos)} needed: {', '.join(lacking)} missing"
        return f"a servo is named twice in {', '.join(names)}"
