"""The packet of C figure 5.5: header, class, ID, size, instruction or status, payload, checksum."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

HEADER = 0xA5
"""First byte of every packet."""
PREAMBLE = 5
"""Bytes before the payload: header, class, ID, size, instruction or status."""
OVERHEAD = PREAMBLE + 1
"""Bytes of a packet beside its payload, as C (5.1) counts them."""
MAX_PAYLOAD = 64
"""Longest payload; a size byte above that is no packet."""


class DeviceClass(IntEnum):
    """First half of an address. IDs count from 1 within a class."""

    BUS_CONTROLLER = 0x01
    SERVO_BOARD = 0x02
    BODY_BOARD = 0x03
    PWM_BOARD = 0x04


class Instruction(IntEnum):
    """Fifth byte of a packet from the master."""

    GET = 0x01
    """Payload: register address. Answer: its value."""
    SET = 0x02
    """Payload: register address, value. Answer: nothing."""
    RESTART = 0x03
    """As a power reset: volatile registers get their defaults. Answered before it happens."""
    EXCHANGE = 0x10
    """The low-latency instruction of C 5.3.2: targets there, sensor data back."""


class Status(IntEnum):
    """Fifth byte of a packet from a slave."""

    OK = 0x00
    UNKNOWN_INSTRUCTION = 0x01
    WRONG_SIZE = 0x02
    UNKNOWN_REGISTER = 0x03
    READ_ONLY = 0x04
    OUT_OF_RANGE = 0x05
    NO_ANSWER = 0x10
    """Said by the bus controller in the name of a slave that kept silent."""
    DAMAGED_ANSWER = 0x11
    """Said by the bus controller in the name of a slave whose answer had a wrong checksum."""


@dataclass(frozen=True, slots=True)
class Packet:
    """One packet. `code` is an instruction on the way to a slave and a status on the way back.

    Raises ValueError for a field that does not fit its byte, or a payload above MAX_PAYLOAD bytes.
    """

    device_class: int
    device_id: int
    code: int
    payload: bytes = b""

    def __post_init__(self) -> None:
        for name in ("device_class", "device_id", "code"):
            value = getattr(self, name)
            if not 0 <= value <= 0xFF:
                raise ValueError(f"{name} = {value}: must be within 0 and 255")
        if len(self.payload) > MAX_PAYLOAD:
            raise ValueError(f"payload of {len(self.payload)} bytes: at most {MAX_PAYLOAD}")

    def encode(self) -> bytes:
        """The packet as it goes over the line."""
        body = bytes((self.device_class, self.device_id, len(self.payload), self.code)) + self.payload
        return bytes((HEADER,)) + body + bytes((checksum(body),))

    @property
    def address(self) -> tuple[int, int]:
        """Class and ID."""
        return self.device_class, self.device_id


def checksum(body: bytes | bytearray) -> int:
    """8-bit sum of all bytes of a packet but its header and the checksum itself (C 5.3.1.3)."""
    return sum(body) & 0xFF


def status_name(code: int) -> str:
    """A status in words, as in "no answer"; an unknown one as its number."""
    try:
        return Status(code).name.lower().replace("_", " ")
    except ValueError:
        return f"status 0x{code:02X}"
