"""The heartbeat: clocks, who is there, and the emergency stops of the workstation as a state that is told each time."""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass

from pydantic import BaseModel, ConfigDict, Field

from nermo_description.emergency_stops import Stop

_PING = struct.Struct("<Iq8s")
"""Sequence, the sender's clock [ns], the end that sends it; a JSON text follows."""
_PONG = struct.Struct("<Iqq8s")
"""The ping's sequence and time, the answering clock [ns], the end that is answered."""


class _Text(BaseModel):
    model_config = ConfigDict(strict=True, extra="ignore")

    name: str = Field(max_length=200)
    stops: list[tuple[str, str, bool, int]] = Field(max_length=200)


@dataclass(frozen=True, slots=True)
class Ping:
    """What the workstation's end says in each heartbeat."""

    sequence: int
    sent: int
    """By the sender's clock [ns]."""
    end: bytes
    """Eight random bytes: one end of a link from its start to its close."""
    name: str
    """What people read."""
    stops: tuple[Stop, ...]

    def encode(self) -> bytes:
        """As bytes."""
        stops = [[stop.source, stop.name, stop.saying, stop.number] for stop in self.stops]
        text = json.dumps({"name": self.name, "stops": stops}, separators=(",", ":"))
        return _PING.pack(self.sequence, self.sent, self.end) + text.encode()

    @classmethod
    def decode(cls, payload: bytes) -> Ping:
        """Raises ValueError where this is none."""
        if len(payload) < _PING.size:
            raise ValueError(f"a heartbeat of {len(payload)} bytes")
        text = _Text.model_validate_json(payload[_PING.size :])
        sequence, sent, end = _PING.unpack_from(payload)
        return cls(sequence, sent, end, text.name, tuple(Stop(*stop) for stop in text.stops))


@dataclass(frozen=True, slots=True)
class Pong:
    """What the robot's end answers."""

    sequence: int
    sent: int
    """As the ping said."""
    answered: int
    """By the robot's clock [ns]."""
    end: bytes
    """Whose ping it was."""

    def encode(self) -> bytes:
        """As bytes."""
        return _PONG.pack(self.sequence, self.sent, self.answered, self.end)

    @classmethod
    def decode(cls, payload: bytes) -> Pong:
        """Raises ValueError where this is none."""
        if len(payload) != _PONG.size:
            raise ValueError(f"an answer of {len(payload)} bytes")
        return cls(*_PONG.unpack(payload))
