"""The stamp at the head of a raw CDR message: read and moved without decoding the rest."""

from __future__ import annotations

import struct

_BILLION = 1_000_000_000
_OFFSET = 4
"""After the encapsulation header; `stamp` is the first field of std_msgs/Header."""
_SIZE = 8


def _layout(payload: bytes) -> struct.Struct:
    """Raises ValueError where this is no CDR message with a header."""
    if len(payload) < _OFFSET + _SIZE or payload[0] != 0 or payload[1] not in (0, 1):
        raise ValueError("no CDR message with a header")
    return _LITTLE if payload[1] == 1 else _BIG


_LITTLE, _BIG = struct.Struct("<iI"), struct.Struct(">iI")


def read(payload: bytes) -> int:
    """The stamp [ns]. Raises ValueError where there is none."""
    seconds, nanoseconds = _layout(payload).unpack_from(payload, _OFFSET)
    if nanoseconds >= _BILLION:
        raise ValueError(f"stamp with {nanoseconds} ns beside the seconds")
    return int(seconds) * _BILLION + int(nanoseconds)


def moved(payload: bytes, by: int) -> bytes:
    """The message with its stamp moved [ns], unless that leaves what a stamp can hold. Raises ValueError as `read`."""
    seconds, nanoseconds = divmod(read(payload) + by, _BILLION)
    if not 0 <= seconds < 2**31:
        return payload
    head = _layout(payload).pack(seconds, nanoseconds)
    return b"".join((payload[:_OFFSET], head, payload[_OFFSET + _SIZE :]))
