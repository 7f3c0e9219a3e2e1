"""Messages of `nermo_interfaces` to the controller's plain data and back.

This is the door for what other processes send: names that are unknown, lengths that do not fit and enumerations that do
not exist are refused by name. Whether a number makes sense is judged where it is used, the same in both harnesses.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, TypeVar

from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry as OdometryMessage
from nav_msgs.msg import Path as PathMessage
from pydantic import ValidationError
from sensor_msgs.msg import Imu as ImuMessage
from std_msgs.msg import Header

from nermo_control import types
from nermo_control.gait.gaits import GaitDefinition
from nermo_control.gait.knowledge_base import GaitParameters, LegStride
from nermo_control.path import Path
from nermo_control.spine.functions import SPINE_FUNCTIONS
from nermo_control.types import Phase, Posture, TrajectoryMode
from nermo_description.parameters import LEGS, RobotParameters
from nermo_description.robots import AnyRobot
from nermo_interfaces import msg
from nermo_node.time import to_message, to_nanoseconds

Enumeration = TypeVar("Enumeration", Posture, TrajectoryMode, Phase)


class UnusableMessageError(ValueError):
    """A message that does not fit this robot; says which field and why."""


def header(stamp: int, frame_id: str = "") -> Header:
    """A header with a stamp [ns]."""
    return Header(stamp=to_message(stamp), frame_id=frame_id)


# [a]


def control_command_from_message(message: msg.ControlCommand) -> types.ControlCommand:
    """[a], from the operator. Raises UnusableMessageError."""
    return types.ControlCommand(
        to_nanoseconds(message.header.stamp),
        message.forward_velocity,
        message.turn_rate,
        _enumeration(Posture, "posture", message.posture),
        _enumeration(TrajectoryMode, "trajectory_mode", message.trajectory_mode),
        message.gait,
        message.gait_frequency,
        message.turning_strategy,
        _spine_modes_from_message(message.spine_modes),
    )


def control_command_to_message(command: types.ControlCommand) -> msg.ControlCommand:
    """[a]."""
    return msg.ControlCommand(
        header=header(command.stamp, "base_link"),
        forward_velocity=command.forward_velocity,
        turn_rate=command.turn_rate,
        posture=int(command.posture),
        trajectory_mode=int(command.trajectory_mode),
        gait=command.gait,
        gait_frequency=command.gait_frequency,
        turning_strategy=command.turning_strategy,
        spine_modes=_spine_modes_to_message(command.spine_modes),
    )


def control_command_from_twist(message: TwistStamped) -> types.ControlCommand:
    """[a], from `cmd_vel`: forward velocity and turn rate with the default gait. Other components do not count."""
    twist = message.twist
    return types.ControlCommand(to_nanoseconds(message.header.stamp), twist.linear.x, twist.angular.z)


# [b]


def motion_command_from_message(message: msg.MotionCommand) -> types.MotionCommand:
    """[b], to the motion module. Raises UnusableMessageError."""
    return types.MotionCommand(
        to_nanoseconds(message.header.stamp),
        message.forward_velocity,
        message.turn_rate_normalized,
        _enumeration(Posture, "posture", message.posture),
        message.gait,
        message.gait_frequency,
        message.turning_strategy,
        _spine_modes_from_message(message.spine_modes),
    )


def motion_command_to_message(command: types.MotionCommand) -> msg.MotionCommand:
    """[b]."""
    return msg.MotionCommand(
        header=header(command.stamp, "base_link"),
        forward_velocity=command.forward_velocity,
        turn_rate_normalized=command.turn_rate_normalized,
        posture=int(command.posture),
        gait=command.gait,
        gait_frequency=command.gait_frequency,
        turning_strategy=command.turning_strategy,
        spine_modes=_spine_modes_to_message(command.spine_modes),
    )


# [c] and [d]


class ServoArrays:
    """Puts servo values that come by name into the robot's order."""

    def __init__(self, robot: AnyRobot) -> None:
        self.names = list(robot.servos)
        self._seen: list[str] | None = None
        self._order: list[int] = []

    def positions(self, message: msg.ServoStates | msg.ServoCommand) -> list[float]:
        """Positions [rad] in the robot's order; NaN stands for a servo that cannot be measured.

        Raises UnusableMessageError for unknown, missing or repeated names, a wrong length and infinite positions.
        """
        names, values = message.name, message.position
        if len(names) != len(values):
            raise UnusableMessageError(f"{len(names)} servo names but {len(values)} positions")
        if names != self._seen:
            self._order = self._find_order(names)
            self._seen = list(names)
        positions = [values[place] for place in self._order]
        if not math.isfinite(sum(positions)):
            for name, position in zip(self.names, positions, strict=True):
                if math.isinf(position):
                    raise UnusableMessageError(f"position of {name} is {position} rad: must be finite")
        return positions

    def command(self, stamp: int, positions: Sequence[float]) -> msg.ServoCommand:
        """[c], from positions [rad] in the robot's order."""
        return msg.ServoCommand(header=header(stamp), name=self.names, position=positions)

    def targets(self, message: msg.ServoCommand) -> types.ServoTargets:
        """`servo_targets`; servos that are not named stay where they are.

        Raises UnusableMessageError for unknown or repeated names, a wrong length, and positions that are not finite.
        """
        names, values = message.name, message.position
        if len(names) != len(values):
            raise UnusableMessageError(f"{len(names)} servo names but {len(values)} positions")
        by_name = dict(zip(names, values, strict=True))
        if len(by_name) != len(names):
            raise UnusableMessageError(f"a servo is named twice: {', '.join(names)}")
        if not by_name:
            raise UnusableMessageError("no servo is named")
        self._refuse_unknown(names)
        for name, position in by_name.items():
            if not math.isfinite(position):
                raise UnusableMessageError(f"position of {name} is {position} rad: must be finite")
        positions = tuple(by_name.get(name) for name in self.names)
        return types.ServoTargets(to_nanoseconds(message.header.stamp), positions)

    def _refuse_unknown(self, names: Sequence[str]) -> None:
        unknown = sorted(set(names) - set(self.names))
        if unknown:
            raise UnusableMessageError(f"unknown servo {', '.join(unknown)}: the robot has {', '.join(self.names)}")

    def _find_order(self, names: Sequence[str]) -> list[int]:
        self._refuse_unknown(names)
        missing = [name for name in self.names if name not in names]
        if missing:
            raise UnusableMessageError(f"servo {', '.join(missing)} missing")
        if len(names) != len(self.names):
            raise UnusableMessageError(f"a servo is named twice: {', '.join(names)}")
        return [names.index(name) for name in self.names]


def odometry_from_message(message: OdometryMessage) -> types.Odometry:
    """Planar pose and velocity of base_link. A pose that is not finite is left to who uses it."""
    position, velocity = message.pose.pose.position, message.twist.twist
    return types.Odometry(
        to_nanoseconds(message.header.stamp),
        position.x,
        position.y,
        _yaw(message.pose.pose.orientation),
        velocity.linear.x,
        velocity.angular.z,
    )


def path_from_message(message: PathMessage, corner_radius: float) -> Path | None:
    """The path through the poses' places, its corners rounded off; None for a message without poses.

    Raises UnusableMessageError where the frame is not odom or no path goes through the places.
    """
    frame = message.header.frame_id
    if frame and frame.rsplit("/", 1)[-1] != "odom":
        raise UnusableMessageError(f"path: header.frame_id = {frame!r}: must be odom")
    if not message.poses:
        return None
    places = [(stamped.pose.position.x, stamped.pose.position.y) for stamped in message.poses]
    try:
        return Path.polyline(places, corner_radius)
    except ValueError as error:
        raise UnusableMessageError(f"path: {error}") from error


def odometry_to_message(odometry: types.Odometry, frame_prefix: str = "") -> OdometryMessage:
    """The planar pose as a message, at height 0."""
    message = OdometryMessage(header=header(odometry.stamp, f"{frame_prefix}odom"))
    message.child_frame_id = f"{frame_prefix}base_link"
    pose, twist = message.pose.pose, message.twist.twist
    pose.position.x, pose.position.y = odometry.x, odometry.y
    pose.orientation.z, pose.orientation.w = math.sin(0.5 * odometry.yaw), math.cos(0.5 * odometry.yaw)
    twist.linear.x, twist.angular.z = odometry.forward_velocity, odometry.turn_rate
    return message


def _yaw(q: Any) -> float:
    return math.atan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y * q.y + q.z * q.z))


def leg_loads_from_message(message: msg.LegLoads) -> types.LegLoads:
    """Loads of the feet. Raises UnusableMessageError where one is not finite."""
    load = _four(message.load)
    if not all(map(math.isfinite, load)):
        raise UnusableMessageError(f"load = {list(load)} N: must be finite")
    return types.LegLoads(to_nanoseconds(message.header.stamp), load)


def imu_from_message(message: ImuMessage) -> types.Imu:
    """Orientation and rates; an orientation that is not measured (REP-145) becomes NaN, which nobody uses."""
    q, rate = message.orientation, message.angular_velocity
    known = message.orientation_covariance[0] != -1.0
    return types.Imu(
        to_nanoseconds(message.header.stamp),
        (q.w, q.x, q.y, q.z) if known else (math.nan,) * 4,
        (rate.x, rate.y, rate.z),
    )


# Between motion module and trajectory generator


def leg_states_from_message(message: msg.LegStates) -> types.LegStates:
    """State of the legs and their requests. Raises UnusableMessageError."""
    return types.LegStates(
        stamp=to_nanoseconds(message.header.stamp),
        phases=_phases(message.phases),
        phase_fractions=_four(message.phase_fractions),
        velocities=_four(message.velocities),
        requested=_flags(message.requested),
        next_phases=_phases(message.next_phases),
        start_time=to_nanoseconds(message.start_time),
        durations=_four(message.durations),
        remaining_fractions=_four(message.remaining_fractions),
        start_x=_four(message.start_x),
        start_z=_four(message.start_z),
        gait_frequency=message.gait_frequency,
        duty_factor=message.duty_factor,
    )


def leg_states_to_message(states: types.LegStates) -> msg.LegStates:
    """State of the legs and their requests."""
    return msg.LegStates(
        header=header(states.stamp),
        phases=[int(phase) for phase in states.phases],
        phase_fractions=states.phase_fractions,
        velocities=states.velocities,
        requested=states.requested,
        next_phases=[int(phase) for phase in states.next_phases],
        start_time=to_message(states.start_time),
        durations=states.durations,
        remaining_fractions=states.remaining_fractions,
        start_x=states.start_x,
        start_z=states.start_z,
        gait_frequency=states.gait_frequency,
        duty_factor=states.duty_factor,
    )


def foot_trajectories_from_message(message: msg.FootTrajectories) -> tuple[types.FootTrajectory, ...]:
    """tr_foot. Raises UnusableMessageError."""
    return tuple(_foot_trajectory_from_message(trajectory) for trajectory in message.trajectories)


def foot_trajectories_to_message(stamp: int, trajectories: Iterable[types.FootTrajectory]) -> msg.FootTrajectories:
    """tr_foot, in answer to the leg states with this stamp [ns]."""
    return msg.FootTrajectories(
        header=header(stamp),
        trajectories=[
            msg.FootTrajectory(
                leg=trajectory.leg,
                phase=int(trajectory.phase),
                start_time=to_message(trajectory.start_time),
                duration=trajectory.duration,
                x_first=trajectory.x_first,
                x_second=trajectory.x_second,
                z_first=trajectory.z_first,
                z_second=trajectory.z_second,
            )
            for trajectory in trajectories
        ],
    )


def _foot_trajectory_from_message(message: msg.FootTrajectory) -> types.FootTrajectory:
    if message.leg >= len(LEGS):
        raise UnusableMessageError(f"leg = {message.leg}: allowed 0 to {len(LEGS) - 1}")
    return types.FootTrajectory(
        leg=message.leg,
        phase=_enumeration(Phase, "phase", message.phase),
        start_time=to_nanoseconds(message.start_time),
        duration=message.duration,
        x_first=_four(message.x_first),
        x_second=_four(message.x_second),
        z_first=_four(message.z_first),
        z_second=_four(message.z_second),
    )


# Knowledge-base and robot


def gait_parameters_from_message(message: msg.GaitParameters) -> GaitParameters:
    """k_g. Raises UnusableMessageError naming field, value and what is allowed."""
    try:
        return GaitParameters(
            gaits={
                gait.name: GaitDefinition(duty_factor=gait.duty_factor, phase_offsets=_four(gait.phase_offsets))
                for gait in message.gaits
            },
            front=_leg_stride_from_message(message.front),
            rear=_leg_stride_from_message(message.rear),
            **{name: getattr(message, name) for name in _PLAIN_GAIT_PARAMETERS},
        )
    except ValidationError as error:
        faults = (f"{'.'.join(map(str, e['loc']))} = {e['input']!r}: {e['msg'].lower()}" for e in error.errors())
        raise UnusableMessageError("; ".join(faults)) from error


def gait_parameters_to_message(stamp: int, parameters: GaitParameters, revision: int) -> msg.GaitParameters:
    """k_g, `revision` counting its changes."""
    return msg.GaitParameters(
        header=header(stamp),
        revision=revision,
        gaits=[
            msg.GaitDefinition(name=name, duty_factor=gait.duty_factor, phase_offsets=gait.phase_offsets)
            for name, gait in parameters.gaits.items()
        ],
        front=msg.LegStride(**parameters.front.model_dump()),
        rear=msg.LegStride(**parameters.rear.model_dump()),
        **{name: getattr(parameters, name) for name in _PLAIN_GAIT_PARAMETERS},
    )


_PLAIN_GAIT_PARAMETERS = tuple(name for name in GaitParameters.model_fields if name not in ("gaits", "front", "rear"))


def robot_parameters_to_message(stamp: int, robot: RobotParameters) -> msg.RobotParameters:
    """[e]: what is known of the robot's limits and geometry."""
    spine = robot.spine.model_dump()
    return msg.RobotParameters(
        header=header(stamp, "base_link"),
        robot=robot.name,
        digest=hashlib.sha256(robot.model_dump_json().encode()).hexdigest(),
        mass=robot.masses.total,
        servos=[
            msg.ServoParameters(name=name, **_fields(msg.ServoParameters, servo.model_dump(), leave_out="name"))
            for name, servo in robot.servos.items()
        ],
        legs=[_leg_parameters_to_message(robot, leg) for leg in range(len(LEGS))],
        spine=msg.SpineParameters(**_fields(msg.SpineParameters, spine)),
    )


def _leg_parameters_to_message(robot: RobotParameters, leg: int) -> msg.LegParameters:
    values = (robot.front_leg if leg < 2 else robot.rear_leg).model_dump()
    values["routing_distance"] = math.nan if values["routing_distance"] is None else values["routing_distance"]
    return msg.LegParameters(name=LEGS[leg], hip_position=robot.hip_positions[leg], **values)


def _fields(kind: type, values: Mapping[str, Any], leave_out: str = "") -> dict[str, Any]:
    """Those of `values` that the message has."""
    return {name: values[name] for name in kind.get_fields_and_field_types() if name != leave_out}  # type: ignore[attr-defined]


def _leg_stride_from_message(message: msg.LegStride) -> LegStride:
    return LegStride(**{name: getattr(message, name) for name in LegStride.model_fields})


# Parts


def _spine_modes_from_message(message: msg.SpineModes) -> types.SpineModes:
    return types.SpineModes(*(getattr(message, name) for name in SPINE_FUNCTIONS))


def _spine_modes_to_message(modes: types.SpineModes) -> msg.SpineModes:
    return msg.SpineModes(**{name: getattr(modes, name) for name in SPINE_FUNCTIONS})


def _enumeration(kind: type[Enumeration], field: str, value: int) -> Enumeration:
    try:
        return kind(value)
    except ValueError:
        allowed = ", ".join(f"{member.value} ({member.name})" for member in kind)
        raise UnusableMessageError(f"{field} = {value} is unknown; allowed: {allowed}") from None


def _phases(values: Any) -> tuple[Phase, Phase, Phase, Phase]:
    a, b, c, d = values.tolist()
    return _phase(a), _phase(b), _phase(c), _phase(d)


def _phase(value: int) -> Phase:
    return _enumeration(Phase, "phase", value)


def _four(values: Any) -> types.Four:
    a, b, c, d = values.tolist()
    return a, b, c, d


def _flags(values: Sequence[bool]) -> tuple[bool, bool, bool, bool]:
    a, b, c, d = values
    return a, b, c, d
