"""The door's ranges: every number beyond one is refused by its name, every number within is let through."""

from __future__ import annotations

import math
from types import SimpleNamespace as Fields
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from nermo_description import ranges
from nermo_description.ranges import Range, message_error

any_float = st.floats() | st.sampled_from([1e308, -1e308, 5e-324, math.inf, -math.inf, math.nan, 0.0, -0.0])
allowed = st.sampled_from([value for value in vars(ranges).values() if isinstance(value, Range)])


def vector(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Fields:
    return Fields(x=x, y=y, z=z)


def header(sec: int = 1, nanosec: int = 0) -> Fields:
    return Fields(stamp=Fields(sec=sec, nanosec=nanosec), frame_id="odom")


def level() -> Fields:
    return Fields(w=1.0, x=0.0, y=0.0, z=0.0)


def control_command(**changes: Any) -> Fields:
    usual = {"forward_velocity": 0.1, "turn_rate": 0.0, "gait": "trot", "turning_strategy": "leg"}
    return Fields(header=header(), **{**usual, **changes})


def imu(covariance: float = 0.0, **changes: Any) -> Fields:
    usual = {
        "orientation": level(),
        "angular_velocity": vector(),
        "linear_acceleration": vector(z=9.81),
        "orientation_covariance": [covariance],
        "angular_velocity_covariance": [covariance],
        "linear_acceleration_covariance": [covariance],
    }
    return Fields(header=header(), **{**usual, **changes})


def servo_states(**changes: Any) -> Fields:
    usual = {"name": ["hip", "knee"], "position": [0.1, math.nan], "velocity": [], "torque": [], "current": []}
    return Fields(header=header(), **{**usual, **changes})


def path(places: list[tuple[float, float]]) -> Fields:
    return Fields(header=header(), poses=[Fields(pose=Fields(position=vector(x, y))) for x, y in places])


def trajectories(duration: float = 0.5, terms: tuple[float, ...] = (0.0, 0.0, 0.1, -0.05)) -> Fields:
    cubics = dict.fromkeys(("x_first", "x_second", "z_first", "z_second"), np.array(terms))
    one = Fields(duration=duration, start_time=Fields(sec=1, nanosec=0), **cubics)
    return Fields(header=header(), trajectories=[one])


@given(allowed, any_float)
def test_a_range_lets_through_exactly_what_it_says(allowed: Range, value: float) -> None:
    within = allowed.lower <= value <= allowed.upper or (allowed.or_nan and math.isnan(value))
    sentence = allowed.error("field", value)
    assert (sentence is None) == within
    assert sentence is None or sentence.startswith(f"field = {value:g} {allowed.unit}: allowed {allowed.lower:g} to ")
    assert (allowed.error_of_any("field", [value]) is None) == within
    assert (ranges.named_error(allowed, "field", ["hip"], [value]) is None) == within


@given(any_float, any_float)
def test_commanded_velocities_are_physical(forward: float, turn: float) -> None:
    command = control_command(forward_velocity=forward, turn_rate=turn)
    wrong = message_error("nermo_interfaces/ControlCommand", command)
    assert (wrong is None) == (abs(forward) <= 10.0 and abs(turn) <= 100.0)
    twist = Fields(header=header(), twist=Fields(linear=vector(x=forward), angular=vector(z=turn)))
    assert (message_error("geometry_msgs/TwistStamped", twist) is None) == (wrong is None)


def test_the_sentence_names_field_value_and_range() -> None:
    wrong = message_error("nermo_interfaces/ControlCommand", control_command(turn_rate=-1e308))
    assert wrong == "turn_rate = -1e+308 rad/s: allowed -100 to 100 rad/s"


@given(st.integers(-(2**31), 2**31 - 1), st.integers(0, 2**32 - 1))
def test_stamps_leave_room_for_what_is_reckoned_ahead(sec: int, nanosec: int) -> None:
    command = control_command()
    command.header = header(sec, nanosec)
    wrong = message_error("nermo_interfaces/ControlCommand", command)
    assert (wrong is None) == (0 <= sec < 2**31 - 86_400 and nanosec < 10**9)
    assert wrong is None or wrong.startswith("header.stamp")


@given(st.text(max_size=200))
def test_names_are_short_and_long_ones_are_not_repeated(name: str) -> None:
    wrong = message_error("nermo_interfaces/ControlCommand", control_command(gait=name))
    assert (wrong is None) == (len(name) <= 64)
    assert wrong is None or len(wrong) < 100


@given(st.tuples(any_float, any_float, any_float, any_float))
def test_an_orientation_is_a_unit_quaternion_unless_nobody_measures_it(parts: tuple[float, ...]) -> None:
    orientation = Fields(**dict(zip("wxyz", parts, strict=True)))
    norm = math.hypot(*parts)
    assert (message_error("sensor_msgs/Imu", imu(orientation=orientation)) is None) == (0.9 <= norm <= 1.1)
    assert message_error("sensor_msgs/Imu", imu(-1.0, orientation=orientation)) is None


@given(st.sampled_from(["angular_velocity", "linear_acceleration"]), st.sampled_from("xyz"), any_float)
def test_an_imu_feels_what_a_small_body_can_do(field: str, axis: str, value: float) -> None:
    limit = 100.0 if field == "angular_velocity" else 1000.0
    wrong = message_error("sensor_msgs/Imu", imu(**{field: vector(**{axis: value})}))
    assert (wrong is None) == (abs(value) <= limit)
    assert wrong is None or wrong.startswith(f"{field}.{axis} = ")


@given(any_float, any_float, st.sampled_from(["position", "velocity", "torque", "current"]))
def test_servo_states_may_lack_what_cannot_be_measured(first: float, second: float, field: str) -> None:
    limit = {"position": 10.0, "velocity": 1000.0}.get(field, 100.0)
    wrong = message_error("nermo_interfaces/ServoStates", servo_states(**{field: [first, second]}))
    assert (wrong is None) == all(math.isnan(value) or abs(value) <= limit for value in (first, second))
    assert wrong is None or wrong.startswith(f"{field} of ")


@given(st.integers(0, 300), st.integers(0, 300))
def test_names_and_values_come_in_pairs(names: int, values: int) -> None:
    assume(values > 0)
    states = servo_states(name=[f"servo_{n}" for n in range(names)], position=[0.0] * values)
    assert (message_error("nermo_interfaces/ServoStates", states) is None) == (names == values <= ranges.MOST_NAMES)


@given(st.integers(0, 1000))
def test_paths_have_a_length_that_is_followed_in_time(places: int) -> None:
    wrong = message_error("nav_msgs/Path", path([(0.1 * n, 0.0) for n in range(places)]))
    assert (wrong is None) == (places <= ranges.MOST_POSES)


@given(any_float, any_float)
def test_places_are_on_this_earth(x: float, y: float) -> None:
    wrong = message_error("nav_msgs/Path", path([(0.0, 0.0), (x, y)]))
    assert (wrong is None) == (abs(x) <= 1000.0 and abs(y) <= 1000.0)
    pose = Fields(position=vector(x, y), orientation=level())
    odometry = Fields(
        header=header(), pose=Fields(pose=pose), twist=Fields(twist=Fields(linear=vector(), angular=vector()))
    )
    assert (message_error("nav_msgs/Odometry", odometry) is None) == (wrong is None)


@given(any_float, st.tuples(any_float, any_float, any_float, any_float))
def test_a_foot_stays_near_its_hip(duration: float, terms: tuple[float, float, float, float]) -> None:
    wrong = message_error("nermo_interfaces/FootTrajectories", trajectories(duration, terms))
    if wrong is None:
        half = 0.5 * duration
        a, b, c, d = terms
        for t in (0.0, 0.3 * half, half):
            assert abs(((a * t + b) * t + c) * t + d) <= 4.0 + 1e-9
    elif 1e-6 <= duration <= 100.0:
        assert "over half its time" in wrong


def test_a_usual_step_is_let_through() -> None:
    assert message_error("nermo_interfaces/FootTrajectories", trajectories()) is None


@pytest.mark.parametrize("kind", sorted(ranges.CHECKS))
def test_kinds_are_named_as_ros_names_them(kind: str) -> None:
    package, name = kind.split("/")
    assert package.endswith(("_msgs", "_interfaces")) and name[0].isupper()
