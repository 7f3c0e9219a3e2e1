"""The firmware's constants, out of the same description that the driver reads: nothing is written down twice.

python -m nermo_hw.firmware.header > firmware/lib/pwm_board/constants.hpp
"""

from __future__ import annotations

import enum
from collections.abc import Iterable

from nermo_description.robots import load_robot
from nermo_description.silence import HOLD
from nermo_hw.safety.rules import RULE_OF, Cause
from nermo_hw.sbcp import packet, pwm_board, register_tables
from nermo_hw.sbcp.boards import ACKNOWLEDGE, ANGLE, NO_READING, NO_UNSIGNED_READING, POINT, VOLTAGE
from nermo_hw.sbcp.packet import Instruction, Status
from nermo_hw.sbcp.pwm_board import CHANNELS, ROBOT, SERVOS
from nermo_hw.sbcp.register_tables import PWM_BOARD_REGISTERS
from nermo_hw.types import LATCHED, Fault

FINE = 1000
"""Set-points are counted in this share of an increment of angles, so that slow ones move too."""


def header() -> str:
    """The C++ header."""
    parts = [
        "// Made by `python -m nermo_hw.firmware.header` out of nermo_hw/sbcp/ and nermo_lite.yaml. Change those.",
        "#pragma once\n\n#include <cstdint>\n\nnamespace nermo {\n",
        _numbers(),
        _enum("Instruction", Instruction, (i.value for i in Instruction)),
        _enum("Status", Status, (s.value for s in Status)),
        _enum("State", pwm_board.State, (s.value for s in pwm_board.State)),
        _faults(),
        _registers(),
        _channels(),
        "}  // namespace nermo",
    ]
    return "\n".join(parts) + "\n"


def _numbers() -> str:
    watchdog = next(register for register in PWM_BOARD_REGISTERS if register.name == "watchdog")
    rows: tuple[tuple[str, str, int, str], ...] = (
        ("uint8_t", "HEADER", packet.HEADER, "first byte of a packet"),
        ("uint8_t", "DEVICE_CLASS", pwm_board.ADDRESS[0], ""),
        ("uint8_t", "DEVICE_ID", pwm_board.ADDRESS[1], ""),
        ("int", "PREAMBLE", packet.PREAMBLE, "bytes before the payload"),
        ("int", "OVERHEAD", packet.OVERHEAD, "bytes beside the payload"),
        ("int", "REQUEST_SIZE", pwm_board.REQUEST_SIZE, "payload of an exchange"),
        ("int", "ANSWER_SIZE", pwm_board.ANSWER_SIZE, "payload of its answer"),
        ("uint32_t", "BAUD", pwm_board.BAUD, "bit/s"),
        ("uint16_t", "PROTOCOL_VERSION", register_tables.PROTOCOL_VERSION, "major and minor, a byte each"),
        ("uint16_t", "FIRMWARE_VERSION", register_tables.FIRMWARE_VERSION, "likewise"),
        ("uint8_t", "POWER", pwm_board.POWER, "flag of an exchange"),
        ("uint8_t", "POINT", POINT, "likewise"),
        ("uint8_t", "ACKNOWLEDGE", ACKNOWLEDGE, "likewise"),
        ("uint8_t", "FLAGS", pwm_board.FLAGS, "all that there are"),
        ("int16_t", "NO_NUMBER", NO_READING, "target that is none"),
        ("uint16_t", "NO_READING", NO_UNSIGNED_READING, "voltage that is not measured"),
        ("uint16_t", "LONGEST_WAY_MS", round(pwm_board.LONGEST_WAY * 1e3), "to a target"),
        ("uint32_t", "HOLD_US", round(HOLD.after * 1e6), "without a point, then the servos hold"),
        ("uint16_t", "WATCHDOG_MS", int(watchdog.default), "without an exchange, then the servos are limp"),
        ("uint16_t", "WATCHDOG_LOWER_MS", watchdog.lower, "what may be set"),
        ("uint16_t", "WATCHDOG_UPPER_MS", int(watchdog.upper or 0), "likewise"),
        ("uint32_t", "LARGEST_PAUSE_US", round(pwm_board.LARGEST_PAUSE * 1e6), "within a packet"),
        ("uint32_t", "LOOP_PERIOD_US", round(pwm_board.LOOP_PERIOD * 1e6), "of the firmware"),
        ("uint32_t", "PULSE_PERIOD_US", round(pwm_board.PULSE_PERIOD * 1e6), "from pulse to pulse"),
        ("uint32_t", "STAGGER_US", round(pwm_board.STAGGER * 1e6), "from the first pulse of one servo to the next's"),
        ("uint16_t", "LOW_MV", round(RULE_OF[Cause.LOW_BATTERY].limit / VOLTAGE), "below: UNDER_VOLTAGE"),
        ("uint16_t", "EMPTY_MV", round(RULE_OF[Cause.EMPTY_BATTERY].limit / VOLTAGE), "below: limp"),
        ("uint32_t", "EMPTY_AFTER_US", round(RULE_OF[Cause.EMPTY_BATTERY].after * 1e6), "for so long"),
        ("int32_t", "FINE", FINE, "a set-point's increments in one of an angle (0.1 mrad)"),
        ("int32_t", "PULSE_CENTRE", _pulse(pwm_board.PULSE_CENTRE), "0.1 us, in the middle of a servo's range"),
        ("int32_t", "PULSE_LOWER", _pulse(pwm_board.PULSE_LOWER), "0.1 us"),
        ("int32_t", "PULSE_UPPER", _pulse(pwm_board.PULSE_UPPER), "0.1 us"),
        ("int32_t", "PULSE_PER_RADIAN", _pulse(pwm_board.PULSE_PER_RADIAN), "0.1 us/rad"),
        ("int32_t", "ANGLES_PER_RADIAN", round(1.0 / ANGLE), "increments of an angle in a radian"),
    )
    lines = [
        f"constexpr {kind} {name} = {value};{f'  // {comment}' if comment else ''}"
        for kind, name, value, comment in rows
    ]
    return "\n".join(lines) + "\n"


def _pulse(seconds: float) -> int:
    return round(seconds / pwm_board.PULSE)


def _enum(name: str, kind: type[enum.IntEnum], values: Iterable[int]) -> str:
    lines = [f"    {kind(value).name} = 0x{value:02X}," for value in values]
    return "\n".join([f"enum class {name} : uint8_t {{", *lines, "};\n"])


def _faults() -> str:
    lines = [f"constexpr uint8_t {fault.name} = 0x{fault.value:02X};" for fault in Fault]
    return "\n".join(["namespace fault {", *lines, f"constexpr uint8_t LATCHED = 0x{LATCHED.value:02X};", "}\n"])


def _registers() -> str:
    """Their addresses."""
    lines = [f"    {r.name.upper()} = 0x{r.address:02X},  // {r.kind.name}, {r.access}" for r in PWM_BOARD_REGISTERS]
    return "\n".join(
        [
            f'constexpr char ROBOT_NAME[17] = "{ROBOT}";\n',
            "enum class Register : uint8_t {",
            *lines,
            "};\n",
        ]
    )


def _channels() -> str:
    """Range and speed of each channel's servo, in increments of angles."""
    servos = load_robot(ROBOT).servos
    if tuple(servos) != SERVOS:
        raise ValueError(f"{ROBOT} has the servos {', '.join(servos)}; the board has {', '.join(SERVOS)}")
    lines = []
    for name, servo in servos.items():
        numbers = (round(value / ANGLE) for value in (servo.lower, servo.upper, servo.max_velocity))
        lines.append(f"    {{{', '.join(map(str, numbers))}}},  // {name}")
    return "\n".join(
        [
            "struct Range {",
            "    int16_t lower;   // 0.1 mrad",
            "    int16_t upper;   // 0.1 mrad",
            "    int32_t speed;   // 0.1 mrad/s",
            "};\n",
            f"constexpr int CHANNELS = {CHANNELS};",
            "constexpr Range RANGES[CHANNELS] = {",
            *lines,
            "};\n",
        ]
    )


if __name__ == "__main__":
    print(header(), end="")
