"""Nermo's electronics as the line sees them: boards, and the payloads of the low-latency exchange.

This file, `pwm_board` and `register_tables` are the data sheet in code; docs/sbcp.md is generated from it in words and
a test holds the two together. All numbers are little-endian. Angles are those of the servos as mounted: the driver's
calibration makes joint angles of them.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nermo_description.parameters import LEGS
from nermo_hw.sbcp.packet import DeviceClass

CHANNELS = 4
"""Servo channels of a servo board."""
SERVO_BOARDS: dict[int, tuple[str | None, ...]] = {
    1: ("front_left_hip", "front_left_knee", "head_pan", None),
    2: ("front_right_hip", "front_right_knee", "head_tilt", None),
    3: ("rear_left_hip", "rear_left_knee", "spine_lateral", "spine_vertical"),
    4: ("rear_right_hip", "rear_right_knee", "tail", None),
}
"""ID of each servo board: its servos. One a leg, with its knee encoder and tactile cells; in the order of LEGS."""
TACTILE_CHANNELS = ("piezoresistive", "piezoelectric")
"""Cell of the foot on each tactile channel of a servo board."""
LEG_OF_BOARD = dict(zip(SERVO_BOARDS, LEGS, strict=True))
BODY_BOARD = (int(DeviceClass.BODY_BOARD), 1)
"""IMU and battery."""
BUS_CONTROLLER = (int(DeviceClass.BUS_CONTROLLER), 1)

BUS_BAUD = 3_333_333
"""Of the RS-485 bus behind the bus controller [bit/s] (C 5.3.1.1)."""
BITS_PER_BYTE = 10
"""With one start and one stop bit, no parity."""
REPLY_DELAY = 10e-6
"""From the end of a packet to the begin of the answer [s] (C 5.3.2)."""
SLAVE_TIMEOUT = 20e-6
"""Silence after which the bus controller gives a slave up [s] (C 5.3.2)."""
LOOP_PERIOD_NS = 1_000_000
"""Of a board's main loop: PID, sensors, trajectory interpolation."""

ANGLE = 1e-4
"""[rad] an increment of angles"""
SPEED = 1e-3
"""[rad/s]"""
CURRENT = 1e-3
"""[A]"""
TACTILE = 2e-4
"""[V]"""
QUATERNION = 1.0 / 16384.0
LARGEST_ROUNDING = 1e-3
"""A quaternion whose norm is further from 1 is not one that was rounded."""
RATE = 1e-3
"""[rad/s]"""
ACCELERATION = 2e-3
"""[m/s^2]"""
VOLTAGE = 1e-3
"""[V]"""
NO_READING, NO_UNSIGNED_READING = -0x8000, 0xFFFF
"""Stand for what a board cannot measure; numbers that its field cannot hold stop short of them."""

# Flags of an exchange with a servo board, above the four that energise its channels.
POINT = 0x10
"""The targets are a trajectory point; without it they are not looked at."""
ACKNOWLEDGE = 0x20
"""Latched faults are forgotten."""

_SERVO_REQUEST = struct.Struct("<BB4h")
_SERVO_ANSWER = struct.Struct(f"<BBHI4h4h4Hh{len(TACTILE_CHANNELS)}h")
_BODY_REQUEST = struct.Struct("<BB")
_BODY_ANSWER = struct.Struct("<BBHI4h3h3hHH")

SERVO_REQUEST_SIZE = _SERVO_REQUEST.size
SERVO_ANSWER_SIZE = _SERVO_ANSWER.size
BODY_REQUEST_SIZE = _BODY_REQUEST.size
BODY_ANSWER_SIZE = _BODY_ANSWER.size

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class ServoRequest:
    """Payload of an exchange to a servo board. `targets` [rad], four; `flags`: channels, POINT, ACKNOWLEDGE."""

    sequence: int
    flags: int
    targets: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)

    def encode(self) -> bytes:
        """The payload; angles beyond what 16 bits hold become the nearest."""
        return _SERVO_REQUEST.pack(self.sequence, self.flags, *(_signed(angle / ANGLE) for angle in self.targets))

    @classmethod
    def decode(cls, payload: bytes) -> ServoRequest:
        """Raises struct.error for a wrong size."""
        sequence, flags, a, b, c, d = _SERVO_REQUEST.unpack(payload)
        return cls(sequence, flags, (a * ANGLE, b * ANGLE, c * ANGLE, d * ANGLE))


@dataclass(frozen=True, slots=True)
class ServoAnswer:
    """Payload of the answer of a servo board; arrays have an element a channel. NaN is a value without a reading."""

    sequence: int
    energised: int
    """Channels with power: low four bits. High four: channels that are silent."""
    faults: int
    """Low byte: `Fault`. High byte: channels that drew too much (low four bits), points waiting (high four bits)."""
    time: int
    """The board's clock [us], wraps at 2^32."""
    positions: Array
    velocities: Array
    currents: Array
    knee_angle: float
    cells: Array
    """[V], one of each of TACTILE_CHANNELS"""

    def encode(self) -> bytes:
        """The payload; values beyond what their field holds become the nearest."""
        return _SERVO_ANSWER.pack(
            self.sequence,
            self.energised,
            self.faults,
            self.time & 0xFFFFFFFF,
            *_signed_all(self.positions, ANGLE),
            *_signed_all(self.velocities, SPEED),
            *(_unsigned(value / CURRENT) for value in self.currents.tolist()),
            _signed(self.knee_angle / ANGLE),
            *_signed_all(self.cells, TACTILE),
        )

    @classmethod
    def decode(cls, payload: bytes) -> ServoAnswer:
        """Raises struct.error for a wrong size."""
        sequence, energised, faults, time, *values = _SERVO_ANSWER.unpack(payload)
        return cls(
            sequence,
            energised,
            faults,
            time,
            _readings(values[0:4], ANGLE),
            _readings(values[4:8], SPEED),
            _readings(values[8:12], CURRENT, NO_UNSIGNED_READING),
            float(_readings(values[12:13], ANGLE)[0]),
            _readings(values[13:], TACTILE),
        )


@dataclass(frozen=True, slots=True)
class BodyRequest:
    """Payload of an exchange to the body board; `flags`: ACKNOWLEDGE."""

    sequence: int
    flags: int = 0

    def encode(self) -> bytes:
        """The payload."""
        return _BODY_REQUEST.pack(self.sequence, self.flags)

    @classmethod
    def decode(cls, payload: bytes) -> BodyRequest:
        """Raises struct.error for a wrong size."""
        return cls(*_BODY_REQUEST.unpack(payload))


@dataclass(frozen=True, slots=True)
class BodyAnswer:
    """Payload of the answer of the body board. SI units; NaN is a value without a reading."""

    sequence: int
    faults: int
    time: int
    """The board's clock [us], wraps at 2^32."""
    orientation: Array
    angular_velocity: Array
    linear_acceleration: Array
    voltage: float
    current: float

    def encode(self) -> bytes:
        """The payload; values beyond what their field holds become the nearest."""
        return _BODY_ANSWER.pack(
            self.sequence,
            0,
            self.faults,
            self.time & 0xFFFFFFFF,
            *_signed_all(self.orientation, QUATERNION),
            *_signed_all(self.angular_velocity, RATE),
            *_signed_all(self.linear_acceleration, ACCELERATION),
            _unsigned(self.voltage / VOLTAGE),
            _unsigned(self.current / CURRENT),
        )

    @classmethod
    def decode(cls, payload: bytes) -> BodyAnswer:
        """Raises struct.error for a wrong size. An orientation that is none comes as it is."""
        sequence, _, faults, time, *values = _BODY_ANSWER.unpack(payload)
        orientation = _readings(values[0:4], QUATERNION)
        norm = float(np.linalg.norm(orientation))
        rounded = abs(norm - 1.0) < LARGEST_ROUNDING
        return cls(
            sequence,
            faults,
            time,
            orientation / norm if rounded else orientation,
            _readings(values[4:7], RATE),
            _readings(values[7:10], ACCELERATION),
            *_readings(values[10:11], VOLTAGE, NO_UNSIGNED_READING).tolist(),
            *_readings(values[11:12], CURRENT, NO_UNSIGNED_READING).tolist(),
        )


def minimum_baud(boards: int, payload: int, frequency: float) -> float:
    """Least baud rate of a bus [bit/s], C (5.1).

    payload: bytes to and from one board together; every board takes one packet each way. frequency: of the cycle [Hz].
    """
    return boards * (payload + 2 * 6) * frequency * BITS_PER_BYTE


def board_name(address: tuple[int, int]) -> str:
    """An address in words, as in "servo board 3"."""
    device_class, device_id = address
    try:
        kind = DeviceClass(device_class).name.lower().replace("_", " ")
    except ValueError:
        kind = f"class 0x{device_class:02X}"
    return f"{kind} {device_id}"


def _signed(value: float) -> int:
    return NO_READING if math.isnan(value) else round(min(max(value, NO_READING + 1), 0x7FFF))


def _signed_all(values: Array, unit: float) -> list[int]:
    return [_signed(value / unit) for value in values.tolist()]


def _unsigned(value: float) -> int:
    return NO_UNSIGNED_READING if math.isnan(value) else round(min(max(value, 0), NO_UNSIGNED_READING - 1))


def _readings(raw: Sequence[int], unit: float, none: int = NO_READING) -> Array:
    values = np.array(raw)
    return np.where(values == none, math.nan, values * unit)
