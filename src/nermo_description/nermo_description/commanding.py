"""Who may command, and at what time a command counts: the same for the twin, the cable and the robot's end."""

from __future__ import annotations

from collections.abc import Hashable
from typing import Generic, TypeVar

from nermo_description.silence import OWNER

Sender = TypeVar("Sender", bound=Hashable)

WALL_CLOCK_FROM = 1_000_000_000 * 10**9
"""[ns] The wall clock passed this in 2001; no simulation runs for 31 years."""


class RefusedCommandError(ValueError):
    """A command that must not reach the robot; says why in words for who sent it."""


class Ownership(Generic[Sender]):
    """One sender at a time: the first whose command is usable owns the robot until it has been silent.

    Times are [ns] of a clock that never jumps nor stops, such as the monotonic one.
    """

    def __init__(self, silence: float = OWNER.after) -> None:
        self._silence_ns = round(silence * 1e9)
        self._owner: Sender | None = None
        self._heard_at = 0

    def owner(self, now: int) -> Sender | None:
        """Who commands at present; None where nobody has for a while."""
        return self._owner if now - self._heard_at <= self._silence_ns else None

    def admits(self, sender: Sender, now: int) -> bool:
        """Whether a command of this sender may be looked at."""
        return self.owner(now) in (None, sender)

    def heard(self, sender: Sender, now: int) -> None:
        """Takes note of a command that was admitted and found usable; what is not usable keeps nobody else out."""
        self._owner, self._heard_at = sender, now


def command_time(stamp: int, now: int, oldest: float, lead: float) -> int:
    """The time [ns] at which a command counts: its stamp, or `now` where it bears none.

    Args:
        stamp: [ns]; 0 stands for a command that was not stamped, unless the clock itself has only just begun.
        now: [ns] of the graph's clock.
        oldest: Age beyond which a command is stale [s].
        lead: How far its stamp may be ahead [s].

    Raises:
        RefusedCommandError: The stamp is another clock's, too old, or too far ahead; says what to do about it.
    """
    if -lead * 1e9 <= now - stamp <= oldest * 1e9:
        return stamp
    if stamp == 0:
        return now
    if stamp >= WALL_CLOCK_FROM > now:
        raise RefusedCommandError(
            "its stamp is the wall clock's, but this graph follows a simulation's /clock: start the sender with "
            "--ros-args -p use_sim_time:=true, or leave the stamp 0"
        )
    if stamp < WALL_CLOCK_FROM <= now:
        raise RefusedCommandError(
            "its stamp is a simulation's, but this graph follows the wall clock: start the sender with "
            "--ros-args -p use_sim_time:=false, or leave the stamp 0"
        )
    if stamp > now:
        raise RefusedCommandError(f"stamp is {(stamp - now) * 1e-9:.3f} s in the future, at most {lead:g} s")
    raise RefusedCommandError(f"stale: {(now - stamp) * 1e-9:.3f} s old, at most {oldest:g} s")
