"""What numbers from outside may be: one function a kind of message, each returning what is wrong in words, or None.

Every node asks here before it looks at a message (`nermo_node.inputs`), and the controller before it obeys a command.
The ranges are those of any small legged robot and its sensors. They keep out what no robot does and no sensor says;
what one robot's servos or gait can do is judged, and clipped, behind this door. Messages are taken by their fields, so
that nothing here needs ROS.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence, Sized
from dataclasses import dataclass
from typing import Any

LONGEST_NAME = 64
"""Characters of a name; a refusal repeats it."""
MOST_NAMES = 256
"""Names, and values that go with them, in one message."""
MOST_POSES = 500
"""Places of a path: unpacking one and laying arcs through them takes 25 ms here."""
MOST_GAITS = 32
NOT_MEASURED = -1.0
"""First element of a covariance whose quantity is not measured (REP-145)."""


@dataclass(frozen=True, slots=True)
class Range:
    """Closed interval of a quantity. `or_nan`: NaN stands for what cannot be measured."""

    lower: float
    upper: float
    unit: str
    or_nan: bool = False

    def error(self, field: str, value: float) -> str | None:
        """What is wrong with the value of a field; None where nothing is."""
        if self.lower <= value <= self.upper or (self.or_nan and value != value):
            return None
        return f"{field} = {value:g}{self._unit}: allowed {self}"

    def __str__(self) -> str:
        return f"{self.lower:g} to {self.upper:g}{self._unit}"

    @property
    def _unit(self) -> str:
        return "" if self.unit == "1" else f" {self.unit}"

    def error_of_any(self, field: str, values: Iterable[float]) -> str | None:
        """The same for each of several values, named by their place."""
        lower, upper, or_nan = self.lower, self.upper, self.or_nan
        for place, value in enumerate(values):
            if not (lower <= value <= upper or (or_nan and value != value)):
                return self.error(f"{field}[{place}]", value)
        return None

    def error_of_vector(self, field: str, vector: Any) -> str | None:
        """The same for the parts x, y and z."""
        x, y, z = (self.error(f"{field}.{part}", getattr(vector, part)) for part in "xyz")
        return x or y or z


FORWARD_VELOCITY = Range(-10.0, 10.0, "m/s")
TURN_RATE = Range(-100.0, 100.0, "rad/s")
NORMALIZED = Range(-1.0, 1.0, "(normalized)")
PLACE = Range(-1000.0, 1000.0, "m")
SERVO_TARGET = Range(-10.0, 10.0, "rad")
SERVO_POSITION = Range(-10.0, 10.0, "rad", or_nan=True)
JOINT_POSITION = Range(-100.0, 100.0, "rad", or_nan=True)
VELOCITY = Range(-1000.0, 1000.0, "rad/s", or_nan=True)
TORQUE = Range(-100.0, 100.0, "N m", or_nan=True)
CURRENT = Range(-100.0, 100.0, "A", or_nan=True)
VOLTAGE = Range(0.0, 100.0, "V", or_nan=True)
CELL_VOLTAGE = Range(-100.0, 100.0, "V", or_nan=True)
ANGULAR_VELOCITY = Range(-100.0, 100.0, "rad/s")
"""Of the body: the fastest gyroscopes of its size reach 70 rad/s."""
ACCELERATION = Range(-1000.0, 1000.0, "m/s^2")
LOAD = Range(-100.0, 1000.0, "N")
FORCE = Range(-1000.0, 1000.0, "N")
"""Of a foot; an estimate may fall below 0."""
QUATERNION_NORM = Range(0.9, 1.1, "(norm)")
GAIT_FREQUENCY = Range(0.0, 100.0, "Hz")
SHARE = Range(0.0, 1.0, "(share)")
FOOT_PLACE = Range(-1.0, 1.0, "m")
FOOT_TRAVEL = Range(-1.0, 1.0, "m")
"""What one term of a foot's cubic may add over half its time."""
FOOT_VELOCITY = Range(-10.0, 10.0, "m/s")
PHASE_DURATION = Range(1e-6, 100.0, "s")
AXIS = Range(-1.0, 1.0, "(axis)")
STAMP_SECONDS = Range(0.0, 2**31 - 1 - 86_400, "s")
"""Of a stamp. What is reckoned a little ahead of it still fits into one."""


# What is commanded


def control_command_error(message: Any) -> str | None:
    """nermo_interfaces/ControlCommand. Velocity and turn rate within the range are clipped to what the gait can do;
    the gait's frequency is judged with the gait, which differs from robot to robot.
    """
    return (
        FORWARD_VELOCITY.error("forward_velocity", message.forward_velocity)
        or TURN_RATE.error("turn_rate", message.turn_rate)
        or name_error("gait", message.gait)
        or name_error("turning_strategy", message.turning_strategy)
    )


def twist_error(message: Any) -> str | None:
    """geometry_msgs/TwistStamped as `cmd_vel`: the two components that count."""
    return FORWARD_VELOCITY.error("twist.linear.x", message.twist.linear.x) or TURN_RATE.error(
        "twist.angular.z", message.twist.angular.z
    )


def motion_command_error(message: Any) -> str | None:
    """nermo_interfaces/MotionCommand. As for a ControlCommand."""
    return (
        FORWARD_VELOCITY.error("forward_velocity", message.forward_velocity)
        or NORMALIZED.error("turn_rate_normalized", message.turn_rate_normalized)
        or name_error("gait", message.gait)
        or name_error("turning_strategy", message.turning_strategy)
    )


def servo_command_error(message: Any) -> str | None:
    """nermo_interfaces/ServoCommand. Positions within the range are held to that of each servo."""
    return names_error(message.name) or named_error(SERVO_TARGET, "position", message.name, message.position)


def path_error(message: Any) -> str | None:
    """nav_msgs/Path: the places; orientations do not count."""
    if (long := length_error("poses", message.poses, MOST_POSES)) is not None:
        return long
    for number, stamped in enumerate(message.poses):
        place = stamped.pose.position
        wrong = PLACE.error(f"poses[{number}] x", place.x) or PLACE.error(f"poses[{number}] y", place.y)
        if wrong is not None:
            return wrong
    return name_error("header.frame_id", message.header.frame_id)


def joy_error(message: Any) -> str | None:
    """sensor_msgs/Joy."""
    return (
        length_error("axes", message.axes, MOST_NAMES)
        or length_error("buttons", message.buttons, MOST_NAMES)
        or AXIS.error_of_any("axes", message.axes)
    )


# What is measured or estimated


def servo_states_error(message: Any) -> str | None:
    """nermo_interfaces/ServoStates. NaN stands for what a robot cannot measure."""
    names = message.name
    return (
        names_error(names)
        or named_error(SERVO_POSITION, "position", names, message.position)
        or optional_error(VELOCITY, "velocity", names, message.velocity)
        or optional_error(TORQUE, "torque", names, message.torque)
        or optional_error(CURRENT, "current", names, message.current)
    )


def joint_state_error(message: Any) -> str | None:
    """sensor_msgs/JointState: names and positions."""
    return names_error(message.name) or optional_error(JOINT_POSITION, "position", message.name, message.position)


def imu_error(message: Any) -> str | None:
    """sensor_msgs/Imu. What a covariance of -1 says is not measured may be anything."""
    wrong = None
    if message.orientation_covariance[0] != NOT_MEASURED:
        wrong = rotation_error("orientation", message.orientation)
    if wrong is None and message.angular_velocity_covariance[0] != NOT_MEASURED:
        wrong = ANGULAR_VELOCITY.error_of_vector("angular_velocity", message.angular_velocity)
    if wrong is None and message.linear_acceleration_covariance[0] != NOT_MEASURED:
        wrong = ACCELERATION.error_of_vector("linear_acceleration", message.linear_acceleration)
    return wrong


def odometry_error(message: Any) -> str | None:
    """nav_msgs/Odometry: the pose, forward velocity and turn rate."""
    pose, twist = message.pose.pose, message.twist.twist
    return (
        PLACE.error_of_vector("pose.position", pose.position)
        or rotation_error("pose.orientation", pose.orientation)
        or FORWARD_VELOCITY.error("twist.linear.x", twist.linear.x)
        or TURN_RATE.error("twist.angular.z", twist.angular.z)
    )


def tactile_error(message: Any) -> str | None:
    """nermo_interfaces/Tactile."""
    return names_error(message.name) or named_error(CELL_VOLTAGE, "voltage", message.name, message.voltage)


def leg_loads_error(message: Any) -> str | None:
    """nermo_interfaces/LegLoads: the loads."""
    return LOAD.error_of_any("load", message.load.tolist())


def foot_forces_error(message: Any) -> str | None:
    """nermo_interfaces/FootForces: the forces."""
    wrong = (FORCE.error_of_vector(f"force[{foot}]", force) for foot, force in enumerate(message.force))
    return next(filter(None, wrong), None)


def battery_error(message: Any) -> str | None:
    """sensor_msgs/BatteryState: the voltage."""
    return VOLTAGE.error("voltage", message.voltage)


# What the controller's nodes tell each other


def leg_states_error(message: Any) -> str | None:
    """nermo_interfaces/LegStates; what nobody requests may be anything finite."""
    wrong = (
        GAIT_FREQUENCY.error("gait_frequency", message.gait_frequency)
        or SHARE.error("duty_factor", message.duty_factor)
        or stamp_error("start_time", message.start_time)
    )
    for leg in range(4):
        if wrong is None and message.requested[leg]:
            wrong = (
                PHASE_DURATION.error(f"durations[{leg}]", message.durations[leg])
                or SHARE.error(f"remaining_fractions[{leg}]", message.remaining_fractions[leg])
                or FOOT_VELOCITY.error(f"velocities[{leg}]", message.velocities[leg])
                or FOOT_PLACE.error(f"start_x[{leg}]", message.start_x[leg])
                or FOOT_PLACE.error(f"start_z[{leg}]", message.start_z[leg])
            )
    return wrong


def foot_trajectories_error(message: Any) -> str | None:
    """nermo_interfaces/FootTrajectories: times, and how far each term of a cubic leads."""
    wrong = length_error("trajectories", message.trajectories, 4)
    for number, trajectory in enumerate(message.trajectories):
        field = f"trajectories[{number}]"
        wrong = (
            wrong
            or PHASE_DURATION.error(f"{field}.duration", trajectory.duration)
            or stamp_error(f"{field}.start_time", trajectory.start_time)
        )
        if wrong is not None:
            return wrong
        half = 0.5 * trajectory.duration
        powers = (half * half * half, half * half, half, 1.0)
        for name in ("x_first", "x_second", "z_first", "z_second"):
            terms = (c * power for c, power in zip(getattr(trajectory, name).tolist(), powers, strict=True))
            if (far := FOOT_TRAVEL.error_of_any(f"{field}.{name} over half its time", terms)) is not None:
                return far
    return wrong


def gait_parameters_error(message: Any) -> str | None:
    """nermo_interfaces/GaitParameters: how much there is of it. The knowledge-base itself knows the ranges."""
    wrong = length_error("gaits", message.gaits, MOST_GAITS)
    for name in ("default_gait", "default_turning_strategy", "foot_path"):
        wrong = wrong or name_error(name, getattr(message, name))
    for number, gait in enumerate(message.gaits[:MOST_GAITS]):
        wrong = wrong or name_error(f"gaits[{number}].name", gait.name)
    return wrong


def nothing_to_check(message: Any) -> str | None:
    """A message in which every value is allowed."""
    return None


def clock_error(message: Any) -> str | None:
    """rosgraph_msgs/Clock."""
    return stamp_error("clock", message.clock)


# Parts


def stamp_error(field: str, stamp: Any) -> str | None:
    """A builtin_interfaces/Time."""
    if stamp.nanosec >= 10**9:
        return f"{field}.nanosec = {stamp.nanosec}: allowed 0 to 999999999"
    return STAMP_SECONDS.error(field, stamp.sec)


def rotation_error(field: str, quaternion: Any) -> str | None:
    """A unit quaternion, as far as whoever made it rounds."""
    norm = math.hypot(quaternion.w, quaternion.x, quaternion.y, quaternion.z)
    return QUATERNION_NORM.error(field, norm)


def length_error(field: str, values: Sized, most: int) -> str | None:
    """How many there are."""
    return f"{field}: {len(values)} of them, allowed are {most}" if len(values) > most else None


def name_error(field: str, name: str) -> str | None:
    """How long a name is."""
    return f"{field}: {len(name)} characters, allowed are {LONGEST_NAME}" if len(name) > LONGEST_NAME else None


def names_error(names: Sequence[str]) -> str | None:
    """How many names there are, and how long."""
    if len(names) > MOST_NAMES:
        return length_error("name", names, MOST_NAMES)
    long = (name_error(f"name[{place}]", name) for place, name in enumerate(names))
    return next((wrong for wrong in long if wrong is not None), None)


def named_error(allowed: Range, field: str, names: Sequence[str], values: Sequence[float]) -> str | None:
    """Values that go with names."""
    if len(names) != len(values):
        return f"{len(names)} names but {len(values)} values of {field}"
    for name, value in zip(names, values, strict=True):
        if not allowed.lower <= value <= allowed.upper and (wrong := allowed.error(f"{field} of {name}", value)):
            return wrong
    return None


def optional_error(allowed: Range, field: str, names: Sequence[str], values: Sequence[float]) -> str | None:
    """Values that go with names, or none at all."""
    return named_error(allowed, field, names, values) if len(values) else None


CHECKS: dict[str, Callable[[Any], str | None]] = {
    "geometry_msgs/TwistStamped": twist_error,
    "nav_msgs/Odometry": odometry_error,
    "nav_msgs/Path": path_error,
    "nermo_interfaces/ControlCommand": control_command_error,
    "nermo_interfaces/FootForces": foot_forces_error,
    "nermo_interfaces/FootTrajectories": foot_trajectories_error,
    "nermo_interfaces/GaitParameters": gait_parameters_error,
    "nermo_interfaces/LegLoads": leg_loads_error,
    "nermo_interfaces/LegStates": leg_states_error,
    "nermo_interfaces/MotionCommand": motion_command_error,
    "nermo_interfaces/ServoCommand": servo_command_error,
    "nermo_interfaces/ServoStates": servo_states_error,
    "nermo_interfaces/Tactile": tactile_error,
    "rosgraph_msgs/Clock": clock_error,
    "sensor_msgs/BatteryState": battery_error,
    "sensor_msgs/Imu": imu_error,
    "sensor_msgs/JointState": joint_state_error,
    "sensor_msgs/Joy": joy_error,
    "std_msgs/Bool": nothing_to_check,
}
"""By package and name. A kind that is missing here can be subscribed by no node."""


def message_error(kind: str, message: Any) -> str | None:
    """What is wrong with a message of a kind such as sensor_msgs/Imu: its stamp, or what it says."""
    stamp = getattr(getattr(message, "header", None), "stamp", None)
    if stamp is not None and (wrong := stamp_error("header.stamp", stamp)) is not None:
        return wrong
    return CHECKS[kind](message)
