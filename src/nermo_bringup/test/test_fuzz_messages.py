"""What is thrown at the nodes, and that no number of theirs is without a range."""

from __future__ import annotations

import importlib
import math
import random
from typing import Any

import pytest
from rclpy.serialization import deserialize_message, serialize_message

from nermo_bringup.fuzz.messages import _spots, spoil, swell, usual, wild_float
from nermo_description.ranges import CHECKS, message_error
from nermo_description.robots import load_any_robot

ROBOT = load_any_robot("nermo_lite")
NOW = 42 * 10**9


def message_type(kind: str) -> type:
    package, name = kind.split("/")
    found: type = getattr(importlib.import_module(f"{package}.msg"), name)
    return found


def floats(message: Any, way: str = "") -> list[tuple[str, Any, str, str]]:
    """Way, owner, field and type of every floating-point number or list of them."""
    found = []
    for name, kind in message.get_fields_and_field_types().items():
        value = getattr(message, name)
        here = f"{way}.{name}" if way else name
        if hasattr(value, "get_fields_and_field_types"):
            found += floats(value, here)
        elif "/" in kind:
            for number, element in enumerate(value):
                found += floats(element, f"{here}[{number}]")
        elif "double" in kind or "float" in kind:
            found.append((here, message, name, kind))
    return found


USED_BY_NOBODY = {
    "geometry_msgs/TwistStamped": ("linear.y", "linear.z", "angular.x", "angular.y"),
    "nav_msgs/Odometry": ("covariance", "linear.y", "linear.z", "angular.x", "angular.y"),
    "nav_msgs/Path": ("position.z", "orientation"),
    "nermo_interfaces/ControlCommand": ("gait_frequency",),
    "nermo_interfaces/GaitParameters": ("",),
    "nermo_interfaces/LegLoads": ("variance", "contact_probability"),
    "nermo_interfaces/LegStates": ("phase_fractions",),
    "nermo_interfaces/MotionCommand": ("gait_frequency",),
    "sensor_msgs/BatteryState": ("temperature", "current", "charge", "capacity", "percentage", "cell_"),
    "sensor_msgs/Imu": ("covariance",),
    "sensor_msgs/JointState": ("velocity", "effort"),
}
"""Parts of the ways of numbers that no node looks at, or that are judged with the gait they belong to."""


@pytest.mark.parametrize("kind", sorted(CHECKS))
def test_every_number_that_a_node_looks_at_has_a_range(kind: str) -> None:
    usual_one = usual(message_type(kind), ROBOT, NOW)
    assert message_error(kind, usual_one) is None
    for number in range(len(floats(usual_one))):
        message = usual(message_type(kind), ROBOT, NOW)
        way, owner, field, its_kind = floats(message)[number]
        if any(part in way for part in USED_BY_NOBODY.get(kind, ())):
            continue
        value = getattr(owner, field)
        huge = 1e308 if "double" in its_kind else 3e38
        if its_kind in ("double", "float"):
            setattr(owner, field, huge)
        elif len(value) or its_kind.startswith("sequence"):
            setattr(owner, field, [huge] * max(len(value), 1))
        assert message_error(kind, message) is not None, f"{kind}: {way} = {huge} is let through"


@pytest.mark.parametrize("kind", sorted(CHECKS))
def test_spoiled_messages_can_be_sent_and_differ(kind: str) -> None:
    chance = random.Random(1)
    seen = set()
    for _ in range(200):
        message = usual(message_type(kind), ROBOT, NOW)
        spoil(message, chance)
        packed = serialize_message(message)
        assert type(deserialize_message(packed, message_type(kind))) is message_type(kind)
        seen.add(bytes(packed))
    assert len(seen) > (1 if kind == "std_msgs/Bool" else 50)


def test_the_same_seed_spoils_alike() -> None:
    messages = [usual(message_type("sensor_msgs/Imu"), ROBOT, NOW) for _ in range(2)]
    for message in messages:
        spoil(message, random.Random(7))
    # Not by their bytes: between fields these hold whatever lay there.
    assert repr(messages[0]) == repr(messages[1])


def test_a_swollen_path_is_beyond_every_limit() -> None:
    path = usual(message_type("nav_msgs/Path"), ROBOT, NOW)
    assert swell(path)
    assert len(path.poses) == 20_000
    assert not swell(message_type("std_msgs/Bool")())


def test_numbers_of_all_magnitudes_come() -> None:
    chance = random.Random(0)
    numbers = [wild_float(chance) for _ in range(5000)]
    finite = [abs(number) for number in numbers if math.isfinite(number) and number != 0.0]
    assert max(finite) > 1e300 and min(finite) < 1e-300
    assert any(map(math.isnan, numbers)) and math.inf in numbers and -math.inf in numbers
    assert all(
        abs(number) < 3.5e38 or not math.isfinite(number) for number in (wild_float(chance, 38) for _ in range(5000))
    )


def test_spots_reach_into_lists_of_messages() -> None:
    path = usual(message_type("nav_msgs/Path"), ROBOT, NOW)
    fields = {field for _, field, _ in _spots(path)}
    assert {"frame_id", "poses", "x", "w", "sec"} <= fields
