"""What can be broken on purpose, while the emulator runs."""

from __future__ import annotations

import random
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, fields

from nermo_hw.sbcp.packet import checksum

REMEMBERED_ANSWERS = 32
"""Answers from which the oldest is replayed: several exchanges."""


class FaultError(ValueError):
    """A fault that cannot be injected; the text names it and what is allowed."""


@dataclass(slots=True)
class LineFaults:
    """Shares of packets, in both directions, that something happens to; each in [0, 1]."""

    drop: float = 0.0
    double: float = 0.0
    corrupt: float = 0.0
    """One byte is changed."""
    delay: float = 0.0
    """The packet comes `delay_s` later, behind those of later transfers."""
    delay_s: float = 0.02
    """[s], at most 10"""
    garbage: float = 0.0
    """Random bytes stand before the packet."""
    wrong_id: float = 0.0
    """The packet bears the ID of another board, with the checksum that goes with it."""
    replay: float = 0.0
    """Instead of an answer of the device an earlier one comes once more."""

    def set(self, name: str, value: float) -> None:
        """Raises FaultError for an unknown name or a value out of range."""
        known = [field.name for field in fields(self)]
        if name not in known:
            raise FaultError(f"fault {name!r} is unknown: known are {', '.join(known)}")
        upper = 10.0 if name == "delay_s" else 1.0
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 <= value <= upper:
            raise FaultError(f"fault {name} = {value!r}: must be within 0 and {upper:g}")
        setattr(self, name, float(value))


class FaultyLine:
    """Does to packets what `LineFaults` says; the same seed does the same again."""

    def __init__(self, faults: LineFaults, seed: int) -> None:
        self.faults = faults
        self._random = random.Random(seed)
        self.count = dict.fromkeys(("drop", "double", "corrupt", "delay", "garbage", "wrong_id", "replay"), 0)
        """How often each has happened."""
        self._answers: deque[bytes] = deque(maxlen=REMEMBERED_ANSWERS)

    def pass_on(self, packet: bytes, answer: bool = False) -> list[tuple[bytes, float]]:
        """What arrives instead of a packet: bytes, each with its additional delay [s].

        answer: whether it comes from the device.
        """
        f = self.faults
        if answer:
            self._answers.append(packet)
        if not (f.drop or f.double or f.corrupt or f.delay or f.garbage or f.wrong_id or f.replay):
            return [(packet, 0.0)]
        if self._happens("drop", f.drop):
            return []
        if answer and self._happens("replay", f.replay):
            packet = self._answers[0]
        if self._happens("wrong_id", f.wrong_id):
            packet = _with_another_id(packet)
        if self._happens("corrupt", f.corrupt):
            damaged = bytearray(packet)
            damaged[self._random.randrange(len(damaged))] ^= self._random.randrange(1, 256)
            packet = bytes(damaged)
        if self._happens("garbage", f.garbage):
            packet = self._random.randbytes(self._random.randrange(1, 40)) + packet
        delay = f.delay_s if self._happens("delay", f.delay) else 0.0
        return [(packet, delay)] * (2 if self._happens("double", f.double) else 1)

    def _happens(self, what: str, share: float) -> bool:
        happens = share > 0.0 and self._random.random() < share
        self.count[what] += happens
        return happens


def _with_another_id(packet: bytes) -> bytes:
    body = bytearray(packet[1:-1])
    body[1] = (body[1] + 1) & 0xFF
    return packet[:1] + bytes(body) + bytes((checksum(body),))


def names_only(what: str, given: Sequence[str], known: Sequence[str]) -> None:
    """Raises FaultError where a name is unknown."""
    if unknown := [name for name in given if name not in known]:
        raise FaultError(f"{what} {', '.join(unknown)} is unknown: known are {', '.join(known)}")
