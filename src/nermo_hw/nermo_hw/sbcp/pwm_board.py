"""Nermo-Lite's only board: hobby servos that report nothing, on a microcontroller that answers for itself (N A.2.1).

Like `boards`, this is the data sheet in code. The firmware's constants are made of it (`nermo_hw.firmware.header`), and
docs/sbcp.md says the same in words. An exchange with this board carries a CRC beside the packet's sum: no servo would
show that a wrong target came through. It also carries a session, which ends whenever the board makes its servos limp by
itself: what was sent before that, and is still on its way, moves nothing any more.
"""

from __future__ import annotations

import binascii
import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from nermo_description.silence import HOLD
from nermo_hw.sbcp.boards import ACKNOWLEDGE, ANGLE, NO_READING, NO_UNSIGNED_READING, POINT, VOLTAGE
from nermo_hw.sbcp.packet import DeviceClass

Array = NDArray[np.float64]

ADDRESS = (int(DeviceClass.PWM_BOARD), 1)
ROBOT = "nermo_lite"
"""What it is built into."""
SERVOS = (
    "front_left_hip",
    "front_left_knee",
    "front_right_hip",
    "front_right_knee",
    "rear_left_hip",
    "rear_left_knee",
    "rear_right_hip",
    "rear_right_knee",
    "spine_lateral",
    "tail",
    "head_pan",
)
"""Servo of each channel: all that Nermo-Lite has."""
CHANNELS = len(SERVOS)


def channels(names: Sequence[str]) -> list[int]:
    """Channel of each servo. Raises ValueError for one that the board has none for."""
    if unknown := [name for name in names if name not in SERVOS]:
        raise ValueError(f"a PWM board has no channel for {', '.join(unknown)}; it has {', '.join(SERVOS)}")
    return [SERVOS.index(name) for name in names]


BAUD = 921_600
"""Of its line [bit/s]: the fastest that the common USB adapters of such boards keep."""
BOOT_TIME = 2.0
"""[s] Chosen: most such boards start anew when their port is opened, which takes them less than a second."""

POWER = 0x01
"""Flag of an exchange: the servos get their pulses. POINT and ACKNOWLEDGE are as for servo boards."""
FLAGS = POWER | POINT | ACKNOWLEDGE
"""All that there are."""
LONGEST_WAY = HOLD.after
"""Longest time to a target [s]: without hearing more, a board does not drive for longer."""

PULSE = 1e-7
"""[s] an increment of pulse widths"""
PULSE_CENTRE = 1500e-6
"""[s] Pulse of a servo in the middle of its range in `servos` of the robot's file."""
PULSE_PER_RADIAN = 2000e-6 / math.pi
"""[s/rad] Chosen: 500 to 2500 us over 180 deg, as hobby servos that turn so far have. Yours has to be measured."""
PULSE_LOWER, PULSE_UPPER = 500e-6, 2500e-6
"""[s] Shorter or longer ones drive such a servo against its stops."""
PULSE_PERIOD = 0.02
"""[s] From pulse to pulse: 50 Hz, which every hobby servo takes."""
STAGGER = 0.02
"""[s] From the first pulse of one servo to that of the next, once there is power: all together would pull the supply
down, and the board with it."""
LOOP_PERIOD = 1e-3
"""[s] Of the firmware's loop."""
LARGEST_PAUSE = 2e-3
"""[s] A longer one within a packet ends it."""


class State(IntEnum):
    """What the board does."""

    LIMP = 0
    """No pulses: it was told so, or has not been told where to go."""
    HOLDING = 1
    """No point came for as long as `silence.HOLD` says: the servos stay where they are."""
    DRIVING = 2
    """The servos go where points say."""
    FAULT = 3
    """Limp by itself, until an exchange of the present session acknowledges."""


_REQUEST = struct.Struct(f"<HHBH{CHANNELS}hH")
_ANSWER = struct.Struct(f"<HHHBBHHHHHI{CHANNELS}HH")
_CRC = struct.Struct("<H")

REQUEST_SIZE = _REQUEST.size
ANSWER_SIZE = _ANSWER.size


def crc(data: bytes) -> int:
    """CRC-16/CCITT-FALSE: polynomial 0x1021, begun with 0xFFFF."""
    return binascii.crc_hqx(data, 0xFFFF)


class DamagedPayloadError(ValueError):
    """A payload of a right size whose CRC is wrong."""


@dataclass(frozen=True, slots=True)
class Request:
    """Payload of an exchange. Without POINT, targets and time are not looked at.

    session: as the board said last. sequence: above that of the exchange before, modulo 2^16. flags: of FLAGS.
    time: when the targets shall be reached, from now on [s]. targets: [rad], one a channel.
    """

    session: int
    sequence: int
    flags: int
    time: float = LOOP_PERIOD
    targets: tuple[float, ...] = (0.0,) * CHANNELS

    def encode(self) -> bytes:
        """The payload; angles beyond what 16 bits hold become the nearest, and NaN what the board refuses."""
        angles = (
            NO_READING if math.isnan(angle) else round(min(max(angle / ANGLE, NO_READING + 1), 0x7FFF))
            for angle in self.targets
        )
        body = _REQUEST.pack(self.session, self.sequence, self.flags, round(self.time * 1e3), *angles, 0)[: -_CRC.size]
        return body + _CRC.pack(crc(body))

    @classmethod
    def decode(cls, payload: bytes) -> Request:
        """Raises struct.error for a wrong size, DamagedPayloadError."""
        session, sequence, flags, milliseconds, *angles, _ = _REQUEST.unpack(payload)
        _check_crc(payload)
        return cls(session, sequence, flags, milliseconds * 1e-3, tuple(angle * ANGLE for angle in angles))


@dataclass(frozen=True, slots=True)
class Answer:
    """Payload of the answer, also to an exchange that was not accepted: `last` tells."""

    session: int
    echo: int
    """Sequence of the exchange that this answers."""
    last: int
    """Sequence of the last exchange that was accepted."""
    state: State
    faults: int
    """`Fault`"""
    voltage: float
    """Of the supply [V]; NaN where it is not measured."""
    bad_frames: int
    """Packets with a wrong checksum, and exchanges with a wrong CRC. All counts are since the start, modulo 2^16."""
    stale_frames: int
    """Exchanges of another session, repeated or overtaken."""
    refused_frames: int
    """Exchanges that ask for what cannot be: unknown flags, no time, no number."""
    clamped: int
    """Targets that were brought into their servo's range."""
    time: int
    """The board's clock [us], wraps at 2^32."""
    pulses: Array
    """Widths that are put out [s], one a channel; 0 where there is none."""

    @classmethod
    def decode(cls, payload: bytes) -> Answer:
        """Raises struct.error for a wrong size, DamagedPayloadError, ValueError for an unknown state."""
        session, echo, last, state, faults, millivolts, bad, stale, refused, clamped, time, *pulses, _ = _ANSWER.unpack(
            payload
        )
        _check_crc(payload)
        return cls(
            session,
            echo,
            last,
            State(state),
            faults,
            math.nan if millivolts == NO_UNSIGNED_READING else millivolts * VOLTAGE,
            bad,
            stale,
            refused,
            clamped,
            time,
            np.array(pulses, dtype=float) * PULSE,
        )


def _check_crc(payload: bytes) -> None:
    if crc(payload[: -_CRC.size]) != _CRC.unpack(payload[-_CRC.size :])[0]:
        raise DamagedPayloadError("the CRC is wrong")
