"""Stamps of messages as integer nanoseconds and back."""

from __future__ import annotations

from builtin_interfaces.msg import Time

NANOSECONDS = 1_000_000_000
_LATEST = 2**31 * NANOSECONDS - 1


def to_nanoseconds(stamp: Time) -> int:
    """Nanoseconds of a stamp."""
    return int(stamp.sec) * NANOSECONDS + int(stamp.nanosec)


def to_message(nanoseconds: int) -> Time:
    """Stamp of a time in ns. Raises ValueError outside what a stamp can hold, 0 to 2^31 s."""
    if not 0 <= nanoseconds <= _LATEST:
        raise ValueError(f"time {nanoseconds} ns: allowed 0 to {_LATEST} ns")
    seconds, rest = divmod(nanoseconds, NANOSECONDS)
    return Time(sec=seconds, nanosec=rest)
