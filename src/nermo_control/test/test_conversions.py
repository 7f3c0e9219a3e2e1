"""Messages and plain data: what goes out comes back the same, also over the wire; what does not fit is named."""

from __future__ import annotations

import math
from typing import Any, TypeVar

import pytest
from geometry_msgs.msg import PoseStamped, TwistStamped
from hypothesis import given
from hypothesis import strategies as st
from nav_msgs.msg import Path as PathMessage
from rclpy.serialization import deserialize_message, serialize_message

from nermo_control.gait.gaits import GaitDefinition
from nermo_control.gait.knowledge_base import GaitParameters, LegStride
from nermo_control.nodes import conversions as convert
from nermo_control.spine.functions import SPINE_FUNCTIONS
from nermo_control.types import (
    ControlCommand,
    FootTrajectory,
    LegStates,
    MotionCommand,
    Odometry,
    Phase,
    Posture,
    SpineModes,
    TrajectoryMode,
)
from nermo_description.parameters import RobotParameters
from nermo_interfaces import msg

Message = TypeVar("Message")

numbers = st.floats(allow_nan=False, width=64)
finite = st.floats(allow_nan=False, allow_infinity=False)
stamps = st.integers(0, 2**31 * 10**9 - 1)
names = st.text("abcdefghijklmnopqrstuvwxyz_", max_size=20)
four = st.tuples(numbers, numbers, numbers, numbers)
flags = st.tuples(st.booleans(), st.booleans(), st.booleans(), st.booleans())
phase = st.sampled_from(Phase)
phases = st.tuples(phase, phase, phase, phase)
strategies = st.sampled_from(["leg", "spine", "mix"])
spine_modes = st.builds(SpineModes, st.booleans(), st.booleans(), st.booleans(), st.booleans())


def over_the_wire(message: Message) -> Message:
    result: Message = deserialize_message(serialize_message(message), type(message))
    return result


@given(
    st.builds(
        ControlCommand,
        stamps,
        numbers,
        numbers,
        st.sampled_from(Posture),
        st.sampled_from(TrajectoryMode),
        names,
        numbers,
        names,
        spine_modes,
    )
)
def test_control_commands_come_back(command: ControlCommand) -> None:
    message = over_the_wire(convert.control_command_to_message(command))
    assert convert.control_command_from_message(message) == command
    assert message.header.frame_id == "base_link"


@given(
    st.builds(
        MotionCommand, stamps, numbers, numbers, st.sampled_from(Posture), names, numbers, strategies, spine_modes
    )
)
def test_motion_commands_come_back(command: MotionCommand) -> None:
    assert convert.motion_command_from_message(over_the_wire(convert.motion_command_to_message(command))) == command


@given(
    st.builds(
        LegStates,
        stamp=stamps,
        phases=phases,
        phase_fractions=four,
        velocities=four,
        requested=flags,
        next_phases=phases,
        start_time=stamps,
        durations=four,
        remaining_fractions=four,
        start_x=four,
        start_z=four,
        gait_frequency=numbers,
        duty_factor=numbers,
    )
)
def test_leg_states_come_back(states: LegStates) -> None:
    assert convert.leg_states_from_message(over_the_wire(convert.leg_states_to_message(states))) == states


@given(
    stamps,
    st.lists(st.builds(FootTrajectory, st.integers(0, 3), phase, stamps, numbers, four, four, four, four), max_size=4),
)
def test_foot_trajectories_come_back(stamp: int, trajectories: list[FootTrajectory]) -> None:
    message = over_the_wire(convert.foot_trajectories_to_message(stamp, trajectories))
    assert convert.foot_trajectories_from_message(message) == tuple(trajectories)
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == divmod(stamp, 10**9)


@given(st.builds(Odometry, stamps, finite, finite, st.floats(-3.14, 3.14), finite, finite))
def test_odometry_comes_back(odometry: Odometry) -> None:
    message = over_the_wire(convert.odometry_to_message(odometry, "mouse/"))
    back = convert.odometry_from_message(message)
    assert (back.stamp, back.x, back.y) == (odometry.stamp, odometry.x, odometry.y)
    assert (back.forward_velocity, back.turn_rate) == (odometry.forward_velocity, odometry.turn_rate)
    assert back.yaw == pytest.approx(odometry.yaw, abs=1e-12)
    assert (message.header.frame_id, message.child_frame_id) == ("mouse/odom", "mouse/base_link")


strides = st.builds(
    LegStride,
    swing_amplitude=st.floats(0.0, 0.03),
    stance_amplitude=st.floats(0.0, 0.02),
    max_stride_length=st.floats(0.0, 0.1),
    neutral_stance_height=st.floats(-0.12, -0.01),
    neutral_stride_position=st.floats(-0.05, 0.05),
    touch_down_angle=st.floats(0.8, 2.4),
    take_off_angle=st.floats(0.8, 2.4),
)
offset = st.floats(0.0, 0.99)
gaits = st.builds(
    GaitDefinition, duty_factor=st.floats(0.2, 0.95), phase_offsets=st.tuples(offset, offset, offset, offset)
)
gait_parameters = st.builds(
    GaitParameters,
    gaits=st.dictionaries(st.sampled_from(["pace", "bound", "walk"]), gaits).map(
        lambda extra: {**GaitParameters().gaits, **extra}
    ),
    default_gait_frequency=st.floats(0.1, 3.0),
    default_turning_strategy=strategies,
    front=strides,
    rear=strides,
    foot_path=st.sampled_from(["splines", "locus"]),
    turn_response_exponent=st.floats(0.0, 10.0),
    fusion_exponent=st.floats(0.0, 10.0),
    max_spine_flexion=st.floats(0.0, 0.2),
    settle_duration=st.floats(0.05, 0.18),
)


@given(stamps, gait_parameters, st.integers(0, 2**64 - 1))
def test_gait_parameters_come_back(stamp: int, parameters: GaitParameters, revision: int) -> None:
    message = over_the_wire(convert.gait_parameters_to_message(stamp, parameters, revision))
    assert convert.gait_parameters_from_message(message) == parameters
    assert message.revision == revision


def test_robot_parameters_tell_all_of_the_robot(robot: RobotParameters) -> None:
    message = over_the_wire(convert.robot_parameters_to_message(5, robot))
    assert message.robot == robot.name
    assert message.mass == robot.masses.total
    assert len(message.digest) == 64
    assert {servo.name: (servo.lower, servo.upper, servo.neutral) for servo in message.servos} == {
        name: (servo.lower, servo.upper, servo.neutral) for name, servo in robot.servos.items()
    }
    assert [tuple(leg.hip_position) for leg in message.legs] == list(robot.hip_positions)
    assert [leg.upper_length for leg in message.legs] == [robot.front_leg.upper_length] * 2 + [
        robot.rear_leg.upper_length
    ] * 2
    assert math.isnan(message.legs[0].routing_distance)
    assert tuple(message.spine.theta) == robot.spine.theta
    other = robot.model_copy(update={"name": "other"})
    assert convert.robot_parameters_to_message(5, other).digest != message.digest


# Servo values, by name


@given(st.data())
def test_servo_values_are_matched_by_name_in_any_order(robot: RobotParameters, data: st.DataObject) -> None:
    arrays = convert.ServoArrays(robot)
    positions = data.draw(st.lists(finite, min_size=len(robot.servos), max_size=len(robot.servos)))
    command = over_the_wire(arrays.command(7, positions))
    assert arrays.positions(command) == positions
    order = data.draw(st.permutations(range(len(positions))))
    shuffled = msg.ServoStates(
        name=[command.name[place] for place in order], position=[command.position[place] for place in order]
    )
    assert arrays.positions(over_the_wire(shuffled)) == positions


def states(robot: RobotParameters, **change: Any) -> msg.ServoStates:
    return msg.ServoStates(**{"name": list(robot.servos), "position": [0.0] * len(robot.servos), **change})


def test_servo_values_that_do_not_fit_are_refused_by_name(robot: RobotParameters) -> None:
    arrays = convert.ServoArrays(robot)
    servos = list(robot.servos)
    for change, words in (
        ({"position": [0.0]}, f"{len(servos)} servo names but 1 positions"),
        ({"name": ["front_left_wing", *servos[1:]]}, "unknown servo front_left_wing"),
        ({"name": servos[:-1], "position": [0.0] * (len(servos) - 1)}, f"servo {servos[-1]} missing"),
        ({"name": [*servos, servos[0]], "position": [0.0] * (len(servos) + 1)}, "named twice"),
        ({"name": [], "position": []}, "missing"),
        ({"position": [0.0, math.inf, *[0.0] * (len(servos) - 2)]}, f"position of {servos[1]} is inf"),
    ):
        with pytest.raises(convert.UnusableMessageError, match=words):
            arrays.positions(states(robot, **change))
    assert arrays.positions(states(robot)) == [0.0] * len(servos)


def test_a_servo_that_cannot_be_measured_is_nan(robot: RobotParameters) -> None:
    positions = convert.ServoArrays(robot).positions(
        states(robot, position=[math.nan] + [0.5] * (len(robot.servos) - 1))
    )
    assert math.isnan(positions[0])
    assert positions[1:] == [0.5] * (len(robot.servos) - 1)


# What else cannot be


@given(finite, finite)
def test_cmd_vel_is_a_command_with_the_default_gait(velocity: float, turn_rate: float) -> None:
    twist = TwistStamped(header=convert.header(9))
    twist.twist.linear.x, twist.twist.angular.z, twist.twist.linear.y = velocity, turn_rate, 3.0
    assert convert.control_command_from_twist(twist) == ControlCommand(9, velocity, turn_rate)


@pytest.mark.parametrize(
    ("read", "message", "words"),
    [
        (convert.control_command_from_message, msg.ControlCommand(posture=77), r"posture = 77 .* 0 \(WALK\)"),
        (convert.control_command_from_message, msg.ControlCommand(trajectory_mode=9), "trajectory_mode = 9"),
        (convert.motion_command_from_message, msg.MotionCommand(posture=77), "posture = 77"),
        (convert.leg_states_from_message, msg.LegStates(phases=[0, 1, 2, 0]), "phase = 2"),
        (
            convert.foot_trajectories_from_message,
            msg.FootTrajectories(trajectories=[msg.FootTrajectory(leg=4)]),
            "leg = 4: allowed 0 to 3",
        ),
    ],
)
def test_what_does_not_exist_is_refused_by_name(read: Any, message: Any, words: str) -> None:
    with pytest.raises(convert.UnusableMessageError, match=words):
        read(message)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"default_gait_frequency": math.nan}, "default_gait_frequency = nan"),
        ({"settle_duration": 7.0}, "settle_duration = 7.0"),
        ({"default_gait": "gallop"}, "gallop"),
        ({"gaits": [msg.GaitDefinition(name="trot", duty_factor=1.5)]}, "duty_factor = 1.5"),
        ({"front": msg.LegStride(neutral_stance_height=math.nan)}, "neutral_stance_height = nan"),
    ],
)
def test_gait_parameters_out_of_range_are_refused_by_name(change: dict[str, Any], words: str) -> None:
    message = convert.gait_parameters_to_message(0, GaitParameters(), 0)
    for name, value in change.items():
        setattr(message, name, value)
    with pytest.raises(convert.UnusableMessageError, match=words):
        convert.gait_parameters_from_message(message)


def path_message(*places: tuple[float, float], frame: str = "odom") -> PathMessage:
    message = PathMessage(header=convert.header(0, frame))
    for x, y in places:
        stamped = PoseStamped()
        stamped.pose.position.x, stamped.pose.position.y = x, y
        message.poses.append(stamped)
    return message


def test_a_path_goes_through_the_poses_with_round_corners() -> None:
    path = convert.path_from_message(path_message((0.0, 0.0), (1.0, 0.0), (1.0, 1.0), frame="nermo/odom"), 0.2)
    assert path is not None
    assert path.smallest_radius == pytest.approx(0.2)
    assert path.pose(path.length) == pytest.approx((1.0, 1.0, math.pi / 2))
    assert convert.path_from_message(path_message(), 0.2) is None


@pytest.mark.parametrize(
    ("message", "words"),
    [
        (path_message((0.0, 0.0), (1.0, 0.0), frame="map"), "frame_id = 'map'"),
        (path_message((0.0, 0.0), (math.nan, 0.0)), "finite"),
        (path_message((0.0, 0.0), (0.1, 0.0), (0.1, 0.1)), "no room at point"),
        (path_message((0.0, 0.0)), "at least two"),
    ],
)
def test_a_path_that_is_none_is_refused_in_words(message: PathMessage, words: str) -> None:
    with pytest.raises(convert.UnusableMessageError, match=words):
        convert.path_from_message(message, 0.2)


def test_the_message_has_every_spine_function_and_no_other() -> None:
    assert set(msg.SpineModes.get_fields_and_field_types()) == set(SPINE_FUNCTIONS)
