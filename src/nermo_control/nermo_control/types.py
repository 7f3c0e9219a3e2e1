"""What the controller's parts hand to each other. Plain data without ROS; the messages of `nermo_interfaces` mirror it.

Times are integer nanoseconds, lengths m, angles rad. Legs stand in the order front left, front right, rear left, rear
right. Leg planes have their origin at the hip or shoulder axis, x forward and z up.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum
from typing import Literal

from nermo_control.spine.functions import SpineModes as SpineModes

TurningStrategy = Literal["leg", "spine", "mix"]
Four = tuple[float, float, float, float]


class Posture(IntEnum):
    """What the body is asked to do; values of `ControlCommand.POSTURE_*`.

    STOP freezes every servo; STILL ends walking on four feet, each where it came down; STAND is the neutral stance.
    LIFT_* is the stand with one leg lifted, as in the balance test (N 6.1.5). In DIRECT the servos follow
    `ServoTargets`, as long as they come.
    """

    WALK = 0
    STAND = 1
    SIT = 2
    CROUCH = 3
    STOP = 4
    STILL = 5
    LIFT_FRONT_LEFT = 6
    LIFT_FRONT_RIGHT = 7
    LIFT_REAR_LEFT = 8
    LIFT_REAR_RIGHT = 9
    DIRECT = 10


class TrajectoryMode(IntEnum):
    """Who decides on the path (N A.1.4); values of `ControlCommand.TRAJECTORY_*`."""

    EXTERNAL = 0
    STRAIGHT_LINE = 1
    PATH = 2


class Phase(IntEnum):
    """Phase of one leg; values of `LegStates.STANCE` and `SWING`."""

    STANCE = 0
    SWING = 1


@dataclass(frozen=True, slots=True)
class ControlCommand:
    """What the operator wants (c_m): arrow [a]."""

    stamp: int
    forward_velocity: float = 0.0
    turn_rate: float = 0.0
    posture: Posture = Posture.WALK
    trajectory_mode: TrajectoryMode = TrajectoryMode.EXTERNAL
    gait: str = ""
    gait_frequency: float = 0.0
    turning_strategy: str = ""
    spine_modes: SpineModes = field(default_factory=SpineModes)


@dataclass(frozen=True, slots=True)
class MotionCommand:
    """Target of the motion module (v_m, alpha_tr, g_m): arrow [b]."""

    stamp: int
    forward_velocity: float
    turn_rate_normalized: float
    posture: Posture
    gait: str
    gait_frequency: float
    turning_strategy: TurningStrategy = "leg"
    spine_modes: SpineModes = field(default_factory=SpineModes)


@dataclass(frozen=True, slots=True)
class Odometry:
    """Planar pose of base_link in odom and its velocity."""

    stamp: int
    x: float
    y: float
    yaw: float
    forward_velocity: float = 0.0
    turn_rate: float = 0.0


@dataclass(frozen=True, slots=True)
class Imu:
    """What the IMU says of base_link in the world."""

    stamp: int
    orientation: Four
    """Unit quaternion (w, x, y, z)."""
    angular_velocity: tuple[float, float, float]
    """[rad/s], base_link axes."""


@dataclass(frozen=True, slots=True)
class LegLoads:
    """What the feet bear."""

    stamp: int
    load: Four
    """Vertical [N], 0 or more."""


@dataclass(frozen=True, slots=True)
class ServoTargets:
    """What the servos are to follow in the posture DIRECT."""

    stamp: int
    positions: tuple[float | None, ...]
    """[rad], in the order of the robot's servos; None for one that stays where it is."""


@dataclass(frozen=True, slots=True)
class LegStates:
    """State of the legs (s_legs, v_legs) and the request for new trajectories; fields as in `LegStates.msg`."""

    stamp: int
    phases: tuple[Phase, Phase, Phase, Phase]
    phase_fractions: Four
    velocities: Four
    requested: tuple[bool, bool, bool, bool]
    next_phases: tuple[Phase, Phase, Phase, Phase]
    start_time: int
    durations: Four
    remaining_fractions: Four
    start_x: Four
    start_z: Four
    gait_frequency: float
    duty_factor: float


@dataclass(frozen=True, slots=True)
class FootTrajectory:
    """One foot's path for one phase (tr_foot, N (5.47)-(5.48)): two cubics in each of x and z."""

    leg: int
    phase: Phase
    start_time: int
    duration: float
    x_first: Four
    x_second: Four
    z_first: Four
    z_second: Four


@dataclass(frozen=True, slots=True)
class MotionOutput:
    """Result of one control tick of the motion module."""

    servo_positions: tuple[float, ...]
    """[rad], in the order of the robot's servos."""
    leg_states: LegStates
    warnings: tuple[str, ...] = field(default=())
    """What had to be clamped or refused in this tick, in words; empty when all is well."""
