"""The high-level controller: stick, straight line, limits, silence and bad input."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nermo_control.gait.knowledge_base import GaitParameters
from nermo_control.high_level_controller import HighLevelController, HighLevelControllerConfig
from nermo_control.types import ControlCommand, MotionCommand, Odometry, Posture, SpineModes, TrajectoryMode
from nermo_description.parameters import RobotParameters

PERIOD = 5_000_000
DIAGONAL = math.hypot(0.0615 + 0.005 + 0.0604, 0.0368 + 0.0428)
"""Foot to diagonally opposite foot [m], N tables A.5 and A.7."""
WALK = ControlCommand(0, forward_velocity=0.08)
LINE = replace(WALK, trajectory_mode=TrajectoryMode.STRAIGHT_LINE)


@pytest.fixture
def controller(robot: RobotParameters) -> HighLevelController:
    return HighLevelController(robot, GaitParameters())


def at(stamp: int, x: float = 0.0, y: float = 0.0, yaw: float = 0.0) -> Odometry:
    return Odometry(stamp, x, y, yaw)


def test_defaults_come_from_the_knowledge_base(controller: HighLevelController) -> None:
    command = controller.step(0, WALK, None)
    assert command == MotionCommand(0, 0.08, 0.0, Posture.WALK, "trot", 0.8, "leg", SpineModes())


def test_what_the_operator_names_is_passed_on(controller: HighLevelController) -> None:
    modes = SpineModes(turning=True)
    wish = replace(WALK, gait="lateral_walk", gait_frequency=0.5, turning_strategy="mix", spine_modes=modes)
    command = controller.step(0, replace(wish, forward_velocity=0.04), None)
    assert command == MotionCommand(0, 0.04, 0.0, Posture.WALK, "lateral_walk", 0.5, "mix", modes)


def test_no_velocity_is_standing_still(controller: HighLevelController) -> None:
    assert controller.step(0, ControlCommand(0), None).posture is Posture.STILL


@pytest.mark.parametrize("posture", [Posture.STAND, Posture.SIT, Posture.CROUCH, Posture.STOP, Posture.STILL])
def test_postures_are_passed_on_and_outlast_the_command(controller: HighLevelController, posture: Posture) -> None:
    command = replace(WALK, posture=posture)
    assert controller.step(0, command, None).posture is posture
    assert controller.step(5_000_000_000, command, None).posture is posture


@given(st.floats(0.01, 0.09), st.floats(0.0, 1.0), st.sampled_from([-1.0, 1.0]), st.floats(1.0, 3.0))
def test_the_stick_gives_the_turn_rate_of_the_leg_model(
    robot: RobotParameters, velocity: float, share: float, side: float, exponent: float
) -> None:
    """Path speed over the radius of (5.40)-(5.42) for small strides: v (1 - delta_m / 2) delta_m / d_diag."""
    controller = HighLevelController(robot, GaitParameters(turn_response_exponent=exponent))
    turn_rate = 0.5 * side * share * velocity / DIAGONAL
    alpha = controller.step(0, replace(WALK, forward_velocity=velocity, turn_rate=turn_rate), None).turn_rate_normalized
    difference = abs(alpha) ** exponent
    assert velocity * (1.0 - 0.5 * difference) * difference / DIAGONAL == pytest.approx(
        abs(turn_rate), rel=1e-3, abs=2e-4
    )
    assert alpha * turn_rate >= 0.0
    assert controller.warnings == ()


def test_backwards_the_other_side_is_slowed_for_the_same_turn(controller: HighLevelController) -> None:
    assert controller.step(0, replace(WALK, forward_velocity=-0.08, turn_rate=0.1), None).turn_rate_normalized < 0.0


def test_too_fast_is_clipped_and_said(controller: HighLevelController) -> None:
    command = controller.step(0, replace(WALK, forward_velocity=-1.0, turn_rate=9.0), None)
    assert command.forward_velocity == pytest.approx(-0.096)
    assert command.turn_rate_normalized == -1.0
    assert ["forward_velocity" in controller.warnings[0], "turn_rate" in controller.warnings[1]] == [True, True]


def test_legs_alone_and_a_turning_spine_contradict(controller: HighLevelController) -> None:
    turning = replace(WALK, turn_rate=0.1, spine_modes=SpineModes(turning=True))
    assert controller.step(0, replace(turning, turning_strategy="leg"), None).turning_strategy == "mix"
    assert "contradicts the spine mode turning" in controller.warnings[0]
    assert controller.step(PERIOD, replace(turning, stamp=PERIOD), None).turning_strategy == "mix"
    assert not controller.warnings


def test_turning_without_velocity_walks_the_tightest_circle(controller: HighLevelController) -> None:
    command = controller.step(0, replace(WALK, forward_velocity=0.0, turn_rate=-0.3), None)
    assert command.posture is Posture.WALK
    assert command.turn_rate_normalized == pytest.approx(-1.0)
    assert 0.0 < command.forward_velocity <= 0.096
    assert "on the spot" in controller.warnings[0]


def test_a_gait_without_stride_steps_on_the_spot(controller: HighLevelController) -> None:
    parameters = GaitParameters()
    front = parameters.front.model_copy(update={"max_stride_length": 0.0})
    controller.set_parameters(parameters.model_copy(update={"front": front}))
    command = controller.step(0, WALK, None)
    assert (command.posture, command.forward_velocity) == (Posture.WALK, 0.0)


def test_the_trim_is_added_only_while_walking(robot: RobotParameters) -> None:
    controller = HighLevelController(robot, GaitParameters(), HighLevelControllerConfig(trim=-0.1))
    assert controller.step(0, WALK, None).turn_rate_normalized == pytest.approx(-0.1)
    assert controller.step(PERIOD, ControlCommand(PERIOD), None).turn_rate_normalized == 0.0
    controller.set_config(HighLevelControllerConfig(trim=0.2))
    assert controller.step(2 * PERIOD, WALK, None).turn_rate_normalized == pytest.approx(0.2)


# The straight line


@pytest.mark.parametrize(("pose", "sign"), [((0.0, 0.01, 0.0), -1), ((0.0, -0.01, 0.0), 1), ((0.0, 0.0, 0.1), -1)])
def test_the_line_is_where_the_mouse_stood_when_the_mode_began(
    controller: HighLevelController, pose: tuple[float, float, float], sign: int
) -> None:
    start = (1.0, 2.0, math.pi / 2)
    assert controller.step(0, LINE, at(0, *start)).turn_rate_normalized == 0.0
    x, y, yaw = pose
    moved = at(PERIOD, start[0] - y, start[1] + x, start[2] + yaw)
    assert math.copysign(1.0, controller.step(PERIOD, LINE, moved).turn_rate_normalized) == sign


def test_the_turn_rate_of_the_stick_is_ignored_on_the_line(controller: HighLevelController) -> None:
    assert controller.step(0, replace(LINE, turn_rate=1.0), at(0)).turn_rate_normalized == 0.0


def test_a_new_line_begins_when_the_mode_does(controller: HighLevelController) -> None:
    controller.step(0, LINE, at(0))
    controller.step(PERIOD, WALK, at(PERIOD, 0.0, 0.1))
    assert controller.step(2 * PERIOD, LINE, at(2 * PERIOD, 0.0, 0.1)).turn_rate_normalized == 0.0


@pytest.mark.parametrize("velocity", [0.08, -0.08])
@settings(max_examples=15, deadline=None)
@given(st.floats(-0.05, 0.05), st.floats(-0.4, 0.4))
def test_the_mouse_comes_back_to_the_line(robot: RobotParameters, velocity: float, y: float, yaw: float) -> None:
    """A mouse that turns as the leg model says, set down beside its line, forwards and backwards."""
    controller = HighLevelController(robot, GaitParameters())
    x, dt = 0.0, 0.02
    command = replace(LINE, forward_velocity=velocity)
    controller.step(0, command, at(0))
    for tick in range(1, 1500):
        stamp = round(tick * dt * 1e9)
        alpha = controller.step(stamp, replace(command, stamp=stamp), at(stamp, x, y, yaw)).turn_rate_normalized
        yaw += velocity * alpha / DIAGONAL * dt
        x, y = x + velocity * math.cos(yaw) * dt, y + velocity * math.sin(yaw) * dt
    assert abs(y) < 1e-3
    assert abs(yaw) < 5e-3


@pytest.mark.parametrize("odometry", [None, at(0, math.nan), at(-10_000_000_000)])
def test_without_usable_odometry_the_line_is_not_held_and_that_is_said(
    controller: HighLevelController, odometry: Odometry | None
) -> None:
    command = controller.step(0, LINE, odometry)
    assert (command.turn_rate_normalized, command.forward_velocity) == (0.0, 0.08)
    assert "odometry" in controller.warnings[0]


# Silence, resets and bad input


def test_silence_ends_walking(controller: HighLevelController) -> None:
    assert controller.step(0, WALK, None).posture is Posture.WALK
    assert controller.step(300_000_000, WALK, None).posture is Posture.WALK
    assert not controller.warnings
    assert controller.step(305_000_000, WALK, None).posture is Posture.STILL
    assert controller.warnings == ("no command for 0.3 s: the mouse stops",)
    assert controller.step(306_000_000, WALK, None).posture is Posture.STILL
    assert not controller.warnings, "told once"
    assert controller.step(310_000_000, replace(WALK, stamp=310_000_000), None).posture is Posture.WALK


def test_before_any_command_the_mouse_stands_still(controller: HighLevelController) -> None:
    assert controller.step(0, None, None).posture is Posture.STILL


def test_in_lockstep_the_stamp_of_a_command_is_not_looked_at(robot: RobotParameters) -> None:
    controller = HighLevelController(robot, GaitParameters(), HighLevelControllerConfig(lockstep=True))
    assert controller.step(9_000_000_000, WALK, None).posture is Posture.WALK


def test_a_reset_ends_the_line_and_the_command(controller: HighLevelController) -> None:
    stamp = 9_000_000_000
    controller.step(stamp, replace(LINE, stamp=stamp), at(stamp, 5.0, 5.0))
    assert controller.step(0, replace(LINE, stamp=stamp), at(0)).posture is Posture.STILL
    assert controller.step(PERIOD, LINE, at(PERIOD)).turn_rate_normalized == 0.0


@pytest.mark.parametrize(
    ("bad", "words"),
    [
        ({"forward_velocity": math.nan}, "forward_velocity = nan"),
        ({"turn_rate": -math.inf}, "turn_rate = -inf"),
        ({"gait": "lateral_wolk"}, "did you mean lateral_walk"),
        ({"gait_frequency": 50.0}, "allowed 0.1 to 3.0 Hz"),
        ({"gait_frequency": math.nan}, "allowed 0.1 to 3.0 Hz"),
        ({"posture": 99}, "posture = 99 is unknown"),
        ({"turn_rate": -1e308}, "turn_rate = -1e+308 rad/s: allowed -100 to 100 rad/s"),
        ({"forward_velocity": 1e308, "turn_rate": -1e308}, "forward_velocity = 1e+308 m/s: allowed -10 to 10 m/s"),
        ({"trajectory_mode": 9}, "trajectory_mode = 9 is unknown"),
        ({"turning_strategy": "wheels"}, "turning_strategy = 'wheels' is unknown"),
    ],
)
def test_a_bad_command_is_refused_in_words_and_ends_walking(
    controller: HighLevelController, bad: dict[str, object], words: str
) -> None:
    controller.step(0, WALK, None)
    command = controller.step(PERIOD, replace(WALK, stamp=PERIOD, **bad), None)  # type: ignore[arg-type]
    assert words in controller.warnings[0]
    assert command.forward_velocity == 0.08, "the last valid command holds until it times out"
    later = 400_000_000
    command = controller.step(later, replace(WALK, stamp=later, **bad), None)  # type: ignore[arg-type]
    assert command.posture is Posture.STILL


@given(st.floats(), st.floats(), st.floats(), st.floats(), st.floats(), st.floats())
def test_nothing_gives_a_command_that_is_not_finite(
    robot: RobotParameters, velocity: float, turn_rate: float, frequency: float, x: float, y: float, yaw: float
) -> None:
    controller = HighLevelController(robot, GaitParameters())
    for mode in TrajectoryMode:
        wish = ControlCommand(0, velocity, turn_rate, trajectory_mode=mode, gait_frequency=frequency)
        command = controller.step(0, wish, at(0, x, y, yaw))
        assert math.isfinite(command.forward_velocity)
        assert -1.0 <= command.turn_rate_normalized <= 1.0
        assert command.gait_frequency > 0.0
