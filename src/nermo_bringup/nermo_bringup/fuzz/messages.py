"""Messages as nodes send them, and the same ones spoiled: numbers of all magnitudes, lengths, names, enumerations."""

from __future__ import annotations

import math
import random
import re
from array import array
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time

from nermo_control.gait.knowledge_base import GaitParameters
from nermo_control.nodes.conversions import gait_parameters_to_message
from nermo_description.feet import named_readings
from nermo_description.parameters import LEGS
from nermo_description.robots import AnyRobot
from nermo_hw.sbcp.boards import TACTILE_CHANNELS
from nermo_interfaces import msg
from nermo_node.time import to_message

HUGE = 20_000
"""Elements, or characters, of a message that is much too long."""
_NASTY_FLOATS = (0.0, -0.0, 1.0, -1.0, 1e308, -1e308, 1e-308, 5e-324, math.inf, -math.inf, math.nan)
_NASTY_TEXTS = ("", " ", "trot", "troot", "\x00", "ä" * 40, "../../etc/passwd", "a" * 65, "x" * 2000)
_LENGTHS = (0, 1, 2, 5, 17, 300, 2000)
_INTEGER = re.compile(r"(u?)int(\d+)")
_LIST = re.compile(r"(?:sequence<(?P<of>[^,>]+)(?:, \d+)?>|(?P<array>[^\[]+)\[\d+\])")


def usual(kind: type, robot: AnyRobot, now: int) -> Any:
    """A message of a kind as nodes take it, stamped with `now` [ns]; of a kind that is not known here, an empty one."""
    message = gait_parameters_to_message(now, GaitParameters(), 0) if kind is msg.GaitParameters else kind()
    fill = _USUAL.get(kind.__name__)
    if fill is not None:
        fill(message, robot)
    stamp(message, now)
    return message


def stamp(message: Any, now: int) -> None:
    """Stamps a message that can be stamped."""
    if hasattr(message, "header"):
        message.header.stamp = to_message(now)
    elif hasattr(message, "clock"):
        message.clock = to_message(now)


def spoil(message: Any, chance: random.Random) -> None:
    """Replaces one to four of the message's values."""
    for _ in range(chance.randint(1, 4)):
        spots = list(_spots(message))
        if spots:
            owner, field, kind = chance.choice(spots)
            setattr(owner, field, _wild(getattr(owner, field), kind, chance))


def swell(message: Any) -> bool:
    """Makes every list and text that has no length of its own much too long; false where there is none."""
    swollen = False
    for name, kind in message.get_fields_and_field_types().items():
        value = getattr(message, name)
        if kind == "string":
            setattr(message, name, "x" * HUGE)
        elif kind.startswith("sequence<"):
            setattr(message, name, _resized(value, kind, HUGE))
        else:
            swollen |= hasattr(value, "get_fields_and_field_types") and swell(value)
            continue
        swollen = True
    return swollen


def _spots(message: Any) -> Iterator[tuple[Any, str, str]]:
    """Every value of a message: the message it belongs to, its field and that field's type."""
    for name, kind in message.get_fields_and_field_types().items():
        value = getattr(message, name)
        if hasattr(value, "get_fields_and_field_types"):
            yield from _spots(value)
            continue
        yield message, name, kind
        if (of := _LIST.fullmatch(kind)) is not None and "/" in kind and of is not None:
            for element in list(value)[:4]:
                yield from _spots(element)


def _wild(value: Any, kind: str, chance: random.Random) -> Any:
    found = _LIST.fullmatch(kind)
    if found is None:
        return _wild_value(kind, chance)
    if found["of"] is not None and chance.random() < 0.5:
        return _resized(value, kind, chance.choice(_LENGTHS))
    of = found["of"] or found["array"]
    if "/" in of or len(value) == 0:
        return value
    changed = list(value)
    for place in chance.sample(range(len(changed)), chance.randint(1, len(changed))):
        changed[place] = _wild_value(of, chance)
    return _like(value, changed)


def _wild_value(kind: str, chance: random.Random) -> Any:
    if kind in ("double", "float"):
        return wild_float(chance, largest=308 if kind == "double" else 38)
    if kind == "boolean":
        return chance.random() < 0.5
    if (integer := _INTEGER.fullmatch(kind)) is not None:
        bits = int(integer[2])
        lowest, highest = (0, 2**bits - 1) if integer[1] else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
        return chance.choice((lowest, highest, 0, min(chance.randint(0, 20), highest), chance.randint(lowest, highest)))
    if kind == "octet":
        return bytes([chance.randint(0, 255)])
    return chance.choice(_NASTY_TEXTS)


def wild_float(chance: random.Random, largest: int = 308) -> float:
    """A number of any magnitude up to a power of ten, or none."""
    if chance.random() < 0.4:
        nasty = chance.choice(_NASTY_FLOATS)
        return nasty if largest == 308 or not math.isfinite(nasty) else math.copysign(min(abs(nasty), 3e38), nasty)
    return float(chance.choice((-1.0, 1.0)) * chance.random() * 10.0 ** chance.uniform(-largest, largest))


def _resized(value: Any, kind: str, length: int) -> Any:
    found = _LIST.fullmatch(kind)
    assert found is not None and found["of"] is not None, f"{kind} has a length of its own"
    elements = list(value)
    if "/" in found["of"]:
        # One element many times: nobody but the sender can tell.
        return (elements * length)[:length] if elements else []
    filler = "x" if found["of"].startswith("string") else False if found["of"] == "boolean" else 0
    return _like(value, (elements or [filler]) * length, length)


def _like(value: Any, elements: list[Any], length: int | None = None) -> Any:
    elements = elements[:length]
    if isinstance(value, np.ndarray):
        return np.array(elements, dtype=value.dtype)
    return array(value.typecode, elements) if isinstance(value, array) else elements


def _servo_states(message: Any, robot: AnyRobot) -> None:
    message.name = list(robot.servos)
    message.position = [servo.neutral for servo in robot.servos.values()]


def _control_command(message: msg.ControlCommand, robot: AnyRobot) -> None:
    message.forward_velocity, message.turn_rate = 0.05, 0.1


def _motion_command(message: msg.MotionCommand, robot: AnyRobot) -> None:
    message.forward_velocity, message.turn_rate_normalized = 0.05, 0.1
    message.gait, message.gait_frequency, message.turning_strategy = "trot", 0.8, "leg"


def _twist(message: Any, robot: AnyRobot) -> None:
    message.twist.linear.x, message.twist.angular.z = 0.05, 0.1


def _imu(message: Any, robot: AnyRobot) -> None:
    message.linear_acceleration.z = 9.81


def _leg_states(message: msg.LegStates, robot: AnyRobot) -> None:
    message.requested, message.next_phases = [True] * 4, [1, 0, 0, 1]
    message.durations, message.remaining_fractions = [0.6] * 4, [1.0] * 4
    message.start_z, message.velocities = [-0.05] * 4, [0.05] * 4
    message.gait_frequency, message.duty_factor = 0.8, 0.5


def _foot_trajectories(message: msg.FootTrajectories, robot: AnyRobot) -> None:
    message.trajectories = [
        msg.FootTrajectory(leg=leg, phase=1, duration=0.6, z_first=[0.0, 0.0, 0.03, -0.05], start_time=Time(sec=1))
        for leg in range(len(LEGS))
    ]


def _path(message: Any, robot: AnyRobot) -> None:
    from geometry_msgs.msg import PoseStamped

    message.header.frame_id = "odom"
    message.poses = [PoseStamped() for _ in range(5)]
    for number, stamped in enumerate(message.poses):
        stamped.pose.position.x, stamped.pose.position.y = float(number), 0.5 * (number % 2)


def _joint_state(message: Any, robot: AnyRobot) -> None:
    message.name = [f"{leg}_knee_joint" for leg in LEGS]
    message.position = [0.0] * 4


def _joy(message: Any, robot: AnyRobot) -> None:
    message.axes, message.buttons = [0.0] * 8, [0] * 15


def _battery(message: Any, robot: AnyRobot) -> None:
    message.voltage = 7.4


def _leg_loads(message: msg.LegLoads, robot: AnyRobot) -> None:
    message.load = [0.5] * 4


def _tactile(message: msg.Tactile, robot: AnyRobot) -> None:
    message.name, message.voltage = named_readings({cell: [1.2] * len(LEGS) for cell in TACTILE_CHANNELS})


_USUAL: dict[str, Callable[[Any, AnyRobot], None]] = {
    "BatteryState": _battery,
    "ControlCommand": _control_command,
    "FootTrajectories": _foot_trajectories,
    "Imu": _imu,
    "JointState": _joint_state,
    "Joy": _joy,
    "LegLoads": _leg_loads,
    "LegStates": _leg_states,
    "MotionCommand": _motion_command,
    "Path": _path,
    "ServoCommand": _servo_states,
    "ServoStates": _servo_states,
    "Tactile": _tactile,
    "TwistStamped": _twist,
}
