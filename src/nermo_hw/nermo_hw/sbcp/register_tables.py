"""The registers of each kind of board: the second half of the data sheet in code, beside `boards` and `pwm_board`."""

from __future__ import annotations

from dataclasses import replace

from nermo_description.silence import WATCHDOG
from nermo_hw.sbcp.boards import BUS_BAUD, SLAVE_TIMEOUT
from nermo_hw.sbcp.packet import DeviceClass
from nermo_hw.sbcp.pwm_board import ROBOT
from nermo_hw.sbcp.registers import Access, Kind, Register

PROTOCOL_VERSION = 0x0102
"""1.2"""
FIRMWARE_VERSION = 0x0100

STANDARD = (
    Register(0x00, "device_class", Kind.U8, Access.READ_ONLY, "kind of device, first half of its address"),
    Register(
        0x01,
        "device_id",
        Kind.U8,
        Access.STORED,
        "second half of its address, from the next packet on",
        default=1,
        lower=1,
        upper=254,
    ),
    Register(
        0x02, "protocol_version", Kind.U16, Access.READ_ONLY, "major and minor, a byte each", default=PROTOCOL_VERSION
    ),
    Register(
        0x03, "firmware_version", Kind.U16, Access.READ_ONLY, "major and minor, a byte each", default=FIRMWARE_VERSION
    ),
    Register(0x04, "serial_number", Kind.U32, Access.READ_ONLY, "unique within a class"),
    Register(0x05, "uptime", Kind.U32, Access.READ_ONLY, "since the start", unit="ms"),
    Register(0x06, "bad_packets", Kind.U32, Access.READ_ONLY, "packets with a wrong checksum since the start"),
    Register(0x07, "faults", Kind.U16, Access.READ_WRITE, "see faults; writing 0 acknowledges", upper=0),
)
"""Registers that every device has (C 5.3.1.3)."""

SERVO_BOARD_REGISTERS = (
    *STANDARD,
    Register(
        0x10,
        "point_period",
        Kind.U16,
        Access.READ_WRITE,
        "time between two trajectory points, in loops of the board; at least two (C 5.3.3)",
        default=5,
        lower=2,
        upper=1000,
        unit="ms",
    ),
    Register(
        0x11,
        "heuristics",
        Kind.U8,
        Access.READ_WRITE,
        "over- and underflow heuristics of C 5.3.3 on (1) or off (0)",
        default=1,
        upper=1,
    ),
    Register(
        0x12,
        "watchdog",
        Kind.U16,
        Access.STORED,
        "servos go limp when no exchange came for so long",
        default=round(WATCHDOG.after * 1e3),
        lower=20,
        upper=10_000,
        unit="ms",
    ),
    Register(
        0x13,
        "current_limit",
        Kind.U16,
        Access.STORED,
        "a servo that draws more for over_current_time goes limp",
        default=1200,
        lower=50,
        upper=5000,
        unit="mA",
    ),
    Register(
        0x14,
        "over_current_time",
        Kind.U16,
        Access.STORED,
        "see current_limit",
        default=500,
        lower=1,
        upper=10_000,
        unit="ms",
    ),
    Register(0x18, "missed_points", Kind.U32, Access.READ_ONLY, "interpolation periods that had no point to go to"),
    Register(0x19, "filled_buffer_steps", Kind.U32, Access.READ_ONLY, "periods shortened because points were waiting"),
    Register(0x1A, "dropped_points", Kind.U32, Access.READ_ONLY, "points that were never gone to"),
)

BODY_BOARD_REGISTERS = (
    *STANDARD,
    Register(0x10, "robot", Kind.TEXT, Access.STORED, "name of the robot that this is built into", default="nermo"),
    Register(0x11, "battery_voltage", Kind.U16, Access.READ_ONLY, "at the terminals", unit="mV"),
    Register(
        0x12,
        "low_voltage",
        Kind.U16,
        Access.STORED,
        "below this the fault UNDER_VOLTAGE is on",
        default=6600,
        lower=4000,
        upper=9000,
        unit="mV",
    ),
)

BUS_CONTROLLER_REGISTERS = (
    *STANDARD,
    Register(0x10, "baud", Kind.U32, Access.READ_ONLY, "of the bus behind it", default=BUS_BAUD, unit="bit/s"),
    Register(
        0x11,
        "reply_timeout",
        Kind.U16,
        Access.READ_ONLY,
        "silence after which a slave is given up",
        default=round(SLAVE_TIMEOUT * 1e6),
        unit="us",
    ),
    Register(0x12, "forwarded", Kind.U32, Access.READ_ONLY, "packets given to slaves since the start"),
    Register(0x13, "unanswered", Kind.U32, Access.READ_ONLY, "of these, without an answer"),
)

_ONE_ALONE = {"device_id": "there is one on its line", "faults": "see faults; only an exchange acknowledges them"}
PWM_BOARD_REGISTERS = (
    *(
        replace(r, access=Access.READ_ONLY, upper=None, description=_ONE_ALONE[r.name]) if r.name in _ONE_ALONE else r
        for r in STANDARD
    ),
    Register(0x10, "robot", Kind.TEXT, Access.READ_ONLY, "name of the robot that this is built into", default=ROBOT),
    Register(0x11, "battery_voltage", Kind.U16, Access.READ_ONLY, "at the terminals", unit="mV"),
    Register(
        0x12,
        "watchdog",
        Kind.U16,
        Access.READ_WRITE,
        "servos go limp when no exchange was accepted for so long",
        default=round(WATCHDOG.after * 1e3),
        lower=20,
        upper=10_000,
        unit="ms",
    ),
    Register(0x13, "session", Kind.U16, Access.READ_ONLY, "what an exchange must say to be accepted"),
    Register(0x14, "last_sequence", Kind.U16, Access.READ_ONLY, "of the last exchange that was accepted"),
    Register(0x18, "stale_frames", Kind.U32, Access.READ_ONLY, "exchanges of another session, repeated or overtaken"),
    Register(0x19, "refused_frames", Kind.U32, Access.READ_ONLY, "exchanges that ask for what cannot be"),
    Register(0x1A, "clamped_targets", Kind.U32, Access.READ_ONLY, "targets that were brought into their servo's range"),
)

REGISTERS: dict[int, tuple[Register, ...]] = {
    DeviceClass.BUS_CONTROLLER: BUS_CONTROLLER_REGISTERS,
    DeviceClass.SERVO_BOARD: SERVO_BOARD_REGISTERS,
    DeviceClass.BODY_BOARD: BODY_BOARD_REGISTERS,
    DeviceClass.PWM_BOARD: PWM_BOARD_REGISTERS,
}
