"""Which readings are believed, and a walk that begins anew."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from standing import NEUTRAL, ROBOT, SAMPLE, SERVOS
from test_supervisor import Walk

from nermo_hw.safety.new_walk import STAND_FOR
from nermo_hw.safety.rules import RULE_OF, Cause, State
from nermo_hw.safety.sensor_checks import Finding, SensorChecks, rotated, turn
from nermo_hw.safety.supervisor import SafetySettings

TICK = 5_000_000


class Robot:
    """Feeds samples, tick by tick; servos are where they shall be, the IMU has noise."""

    def __init__(self) -> None:
        self.checks = SensorChecks(ROBOT, 9.0)
        self.now = 0
        self.random = np.random.default_rng(0)

    def run(
        self, seconds: float, swing: float = 0.0, noise: float = 1e-3, tick: int = TICK, **values: Any
    ) -> dict[Cause, Finding]:
        """swing: of all servos [rad]. tick: between samples [ns]. Values of the sample may be functions of time [s]."""
        found: dict[Cause, Finding] = {}
        for _ in range(round(seconds * 1e9 / tick)):
            self.now += tick
            t = self.now * 1e-9
            positions = NEUTRAL + swing * math.sin(6.0 * t)
            given = {name: value(t) if callable(value) else value for name, value in values.items()}
            rate = given.pop("angular_velocity", np.zeros(3)) + noise * self.random.standard_normal(3)
            sample = replace(SAMPLE, **{"servo_positions": positions, "angular_velocity": rate, **given})
            found = self.checks.take(sample, positions, self.now)
        return found


def about_x(angle: float) -> np.ndarray:
    return np.array([math.cos(angle / 2), math.sin(angle / 2), 0.0, 0.0])


def test_what_stands_still_for_ever_without_noise_is_believed() -> None:
    assert Robot().run(30.0, noise=0.0) == {}


def test_a_robot_that_is_rolled_to_and_fro_is_believed() -> None:
    found = Robot().run(
        10.0,
        swing=0.3,
        orientation=lambda t: about_x(0.8 * math.sin(4.0 * t)),
        angular_velocity=lambda t: np.array([3.2 * math.cos(4.0 * t), 0.0, 0.0]),
        linear_acceleration=lambda t: rotated(about_x(-0.8 * math.sin(4.0 * t)), np.array([0.0, 0.0, 9.81])),
        battery_voltage=lambda t: 7.6 + 0.01 * math.sin(t),
    )
    assert found == {}


@pytest.mark.parametrize(
    ("cause", "words", "values"),
    [
        (Cause.IMU_INVALID, "no unit quaternion", {"orientation": np.zeros(4)}),
        (Cause.IMU_INVALID, "no unit quaternion", {"orientation": np.array([0.5, 0.0, 0.0, 0.0])}),
        (Cause.IMU_INVALID, "nan", {"linear_acceleration": np.array([math.nan, 0.0, 0.0])}),
        (Cause.IMU_FROZEN, "while front_left_hip has moved by", {"noise": 0.0, "swing": 0.3}),
        (Cause.IMU_FROZEN, "the gyroscope has turned by", {"angular_velocity": lambda t: np.sin([9 * t, 0, 0]) * 2.0}),
        (Cause.IMU_IMPLAUSIBLE, "which way is up", {"linear_acceleration": np.array([0.0, 0.0, -9.81])}),
        (Cause.IMU_IMPLAUSIBLE, "which way is up", {"orientation": about_x(1.0)}),
        (Cause.IMU_IMPLAUSIBLE, "which way is up", {"linear_acceleration": np.full(3, 1e300)}),
        (
            Cause.IMU_IMPLAUSIBLE,
            "gyroscope and orientation",
            {
                "orientation": lambda t: about_x(2.0 * t),
                "linear_acceleration": lambda t: rotated(about_x(-2.0 * t), np.array([0.0, 0.0, 9.81])),
            },
        ),
        (Cause.BATTERY_INVALID, "nan V", {"battery_voltage": math.nan}),
        (Cause.BATTERY_FROZEN, "while servos move", {"servo_velocities": np.ones(len(SERVOS))}),
        (Cause.BATTERY_IMPLAUSIBLE, "at most 9 V", {"battery_voltage": 12.6}),
        (Cause.SERVO_INVALID, "tail", {"servo_positions": np.where(np.array(SERVOS) == "tail", math.nan, NEUTRAL)}),
        (Cause.SERVO_FROZEN, "told to move", {"servo_positions": NEUTRAL, "swing": 0.3}),
        (Cause.SERVO_IMPLAUSIBLE, "it cannot be", {"servo_positions": NEUTRAL + 4.0}),
        (Cause.SERVO_IMPLAUSIBLE, "it cannot be", {"servo_velocities": np.full(len(SERVOS), -300.0)}),
    ],
)
def test_a_lie_is_found_and_said_and_forgotten_when_it_has_ended(cause: Cause, words: str, values: Any) -> None:
    robot = Robot()
    robot.run(1.0)
    found = robot.run(2.0, **values)
    assert words in found[cause].why
    assert robot.now - found[cause].since <= 2.0e9
    well = robot.run(2.0, swing=0.05, orientation=lambda t: about_x(1e-3 * math.sin(t)), battery_voltage=7.5)
    assert cause not in well


@given(
    st.lists(st.lists(st.floats(width=32), min_size=21, max_size=21), min_size=1, max_size=10),
    st.lists(st.integers(-(10**9), 10**9), min_size=10, max_size=10),
)
def test_any_numbers_are_taken_and_forgotten(readings: list[list[float]], pauses: list[int]) -> None:
    robot = Robot()
    for values, pause in zip(readings, pauses, strict=False):
        robot.now += pause
        numbers = np.array(values)
        sample = replace(
            SAMPLE,
            orientation=numbers[:4],
            angular_velocity=numbers[4:7],
            linear_acceleration=numbers[7:10],
            battery_voltage=float(numbers[10]),
            servo_positions=numbers[10:],
        )
        robot.checks.take(sample, NEUTRAL, robot.now)
    robot.now = 10**12
    slow = 10 * TICK  # a hundred robots recover, and each sample of all of them is looked at
    robot.run(6.0, tick=slow, battery_voltage=7.5)
    assert robot.run(1.0, tick=slow, battery_voltage=7.4) == {}


@given(st.lists(st.floats(-3.0, 3.0), min_size=6, max_size=6), st.lists(st.floats(-9.0, 9.0), min_size=3, max_size=3))
def test_rotations_are_those_of_scipy(angles: list[float], vector: list[float]) -> None:
    first, second = (Rotation.from_rotvec(part) for part in (angles[:3], angles[3:]))
    q1, q2 = (rotation.as_quat(scalar_first=True) for rotation in (first, second))
    np.testing.assert_allclose(rotated(q1, np.array(vector)), first.apply(vector), atol=1e-9)
    back = Rotation.from_rotvec(turn(q1, q2))
    assert (first * back * second.inv()).magnitude() < 1e-6


# A walk that begins anew


def silent_for(seconds: float, settings: SafetySettings | None = None) -> Walk:
    walk = Walk(settings).released()
    walk.commands = walk.heard = False
    walk.run(seconds)
    walk.commands = walk.heard = True
    return walk


def moving(walk: Walk, seconds: float) -> State:
    for _ in range(round(seconds * 200)):
        walk.target = NEUTRAL + 0.15 * math.sin(walk.now * 8e-9)
        state = walk.tick().state
    return state


def test_after_a_short_silence_it_follows_by_itself() -> None:
    assert moving(silent_for(4.5), 1.0) is State.FOLLOW


def test_after_a_long_silence_a_walk_that_just_goes_on_is_not_followed() -> None:
    walk = silent_for(6.0)
    assert moving(walk, 10.0) is State.CROUCH
    words = "let go of the stick until the commands stand, then walk anew, or release"
    assert walk.supervisor.reason(Cause.LONG_SILENCE) == f"long_silence (no servo_command for 6.0 s; {words})"


def test_a_walk_begun_anew_after_a_stand_is_followed() -> None:
    walk = silent_for(6.0)
    moving(walk, 1.0)
    walk.target = NEUTRAL
    assert walk.run(STAND_FOR + 5.0).state is State.CROUCH, "a stand alone lifts nothing"
    assert walk.supervisor.reason(Cause.LONG_SILENCE).endswith("; the commands stand: walk anew, or release)")
    assert moving(walk, 0.5) is State.FOLLOW


def test_a_release_is_a_deliberate_act_too() -> None:
    walk = silent_for(6.0)
    moving(walk, 1.0)
    assert walk.supervisor.release(walk.now) == ""
    assert moving(walk, 0.5) is State.FOLLOW
    walk = silent_for(6.0)
    assert "long_silence" in walk.supervisor.release(walk.now), "not while nothing comes"


@pytest.mark.parametrize(("after", "state"), [(0.0, State.FOLLOW), (20.0, State.FOLLOW), (3.0, State.CROUCH)])
def test_the_time_is_a_setting_and_zero_switches_it_off(after: float, state: State) -> None:
    assert moving(silent_for(10.0, SafetySettings(new_walk_after=after)), 1.0) is state


def test_a_robot_that_was_never_commanded_has_not_been_left_alone() -> None:
    walk = Walk()
    walk.commands = False
    walk.run(10.0)
    assert walk.supervisor.release(walk.now) == ""
    walk.commands = True
    assert walk.run(0.5).state is State.FOLLOW


def test_the_default_is_the_tables() -> None:
    assert SafetySettings().new_walk_after == RULE_OF[Cause.LONG_SILENCE].after
