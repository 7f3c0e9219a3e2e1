"""The high-level controller: what the operator wants -> v_m, alpha_tr and g_m for the motion module (N A.1.4)."""

from __future__ import annotations

import math

from pydantic import BaseModel, ConfigDict, Field

from nermo_control.gait.knowledge_base import GaitParameters
from nermo_control.heading import HeadingHold
from nermo_control.inbox import Inbox
from nermo_control.path import CycleMean, Path, PathFollower, PathStatus, Pose
from nermo_control.spine.kinematics import SpineKinematics
from nermo_control.turning import TurningModel
from nermo_control.types import ControlCommand, MotionCommand, Odometry, Posture, TrajectoryMode, TurningStrategy
from nermo_control.validation import control_command_error
from nermo_description.parameters import RobotParameters
from nermo_description.silence import WALK


class HighLevelControllerConfig(BaseModel):
    """Settings of the high-level controller."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    command_timeout: float = Field(
        WALK.after,
        ge=0.05,
        le=1.0,
        description="Age at which commands and odometry no longer count",
        json_schema_extra={"unit": "s", "readOnly": True},
    )
    trim: float = Field(
        0.0,
        ge=-0.5,
        le=0.5,
        description="Added to the normalized turn rate while walking, against drift; positive left",
        json_schema_extra={"unit": "1"},
    )
    heading_hold: bool = Field(
        True,
        description="External mode: keep the heading while the stick is centred and reach the turn rate asked for, by "
        "odometry; without fresh odometry the turning model alone decides",
    )
    heading_hold_gain: float = Field(
        0.5,
        ge=0.0,
        le=3.0,
        description="Turn rate for each radian off the heading to be held",
        json_schema_extra={"unit": "1/s"},
    )
    cross_track_gain: float = Field(
        25.0,
        ge=0.0,
        le=300.0,
        description="Curvature for each metre beside the path",
        json_schema_extra={"unit": "1/m^2"},
    )
    heading_gain: float = Field(
        10.0,
        ge=0.0,
        le=100.0,
        description="Curvature for each radian off the path's heading; the derivative part, since the heading is how "
        "fast the distance to the path grows",
        json_schema_extra={"unit": "1/(m rad)"},
    )
    integral_gain: float = Field(
        2.0,
        ge=0.0,
        le=20.0,
        description="Curvature for each metre beside the path and second: finds the turn rate that an arc really "
        "needs; not used for the straight line",
        json_schema_extra={"unit": "1/(m^2 s)"},
    )
    steering_window: float = Field(
        1.0,
        ge=0.0,
        le=2.0,
        description="Gait cycles over which distance and heading are averaged before they steer; 0 takes them as they "
        "are. Legs steer by shortening strides: against the body's swing within a cycle that is stride lost",
    )
    steering_window_spine: float = Field(
        0.0,
        ge=0.0,
        le=2.0,
        description="The same where the spine alone turns and extends no stride: it steers without a stride lost",
    )
    path_preview: float = Field(
        0.04,
        ge=0.0,
        le=0.2,
        description="How far ahead the path's curvature is read: half a gait cycle, in which legs and spine answer",
        json_schema_extra={"unit": "m"},
    )
    path_tolerance: float = Field(
        0.1,
        ge=0.01,
        le=1.0,
        description="Distance from the path beyond which it counts as lost",
        json_schema_extra={"unit": "m"},
    )
    path_corner_radius: float = Field(
        0.15,
        ge=0.01,
        le=2.0,
        description="Radius to which the corners of a path given by its points are rounded off",
        json_schema_extra={"unit": "m"},
    )
    lockstep: bool = Field(
        False,
        description="The robot waits for each answer, so nothing is ever silent",
        json_schema_extra={"readOnly": True},
    )


_GOES_ON = (Posture.WALK, Posture.DIRECT)
"""Postures in which the mouse goes on moving, so that somebody has to go on asking for them."""


class HighLevelController:
    """Obeys the stick (external trajectory mode), holds a straight line or follows a path (internal trajectory mode).

    Lines and paths are followed with a point on the shoulder axis, where N takes the turning radius (5.3.2): curvature
    of the path ahead, less what the distance to it, its integral and the heading ask for, and from the curvature
    alpha_tr through `TurningModel`. Where legs steer, distance and heading are means over a gait cycle.
    """

    def __init__(
        self, robot: RobotParameters, gait_parameters: GaitParameters, config: HighLevelControllerConfig | None = None
    ) -> None:
        self._robot = robot
        self._config = config or HighLevelControllerConfig()
        self._timeout = round(self._config.command_timeout * 1e9)
        self._inbox: Inbox[ControlCommand] = Inbox(
            lambda command: control_command_error(command, self._parameters),
            self._config.command_timeout,
            self._config.lockstep,
        )
        self._guide = robot.hip_positions[0][0]
        self._path: Path | None = None
        self._follower: PathFollower | None = None
        self._heading = HeadingHold()
        self._mean = CycleMean()
        self._integral = 0.0
        self.path_status = PathStatus.IDLE
        """What has become of the path given to `follow`."""
        self.cross_track = 0.0
        """Distance from the line or path in the last step [m], positive left of it."""
        self._turn, self._turn_clipped = 0.0, False
        self._last_stamp: int | None = None
        self._late = False
        self.warnings: tuple[str, ...] = ()
        """What had to be clipped or refused in the last step, in words."""
        self._adopt(gait_parameters)

    def set_parameters(self, parameters: GaitParameters) -> None:
        """Takes new gait parameters; the same ones again change nothing."""
        if parameters != self._parameters:
            self._adopt(parameters)
            self._inbox.recheck()

    def _adopt(self, parameters: GaitParameters) -> None:
        self._parameters = parameters
        self._turning = TurningModel(
            SpineKinematics(self._robot.spine),
            min(parameters.max_spine_flexion, self._robot.spine.max_flexion),
            self._robot.hip_positions,
            (parameters.front.neutral_stride_position, parameters.rear.neutral_stride_position),
        )
        self._solved_turn: tuple[float, float, str] | None = None

    def set_config(self, config: HighLevelControllerConfig) -> None:
        """Takes new gains and trim; the time-out and lockstep stay as they were."""
        self._config = config

    def follow(self, path: Path | None) -> None:
        """Takes the path of the trajectory mode PATH, in the frame of the odometry; None takes it away."""
        self._path, self._follower = path, None
        self.path_status = PathStatus.IDLE

    def guide_pose(self, odometry: Odometry) -> Pose:
        """The point that is led along paths: the middle of the shoulder axis, with the heading of base_link."""
        cos, sin = math.cos(odometry.yaw), math.sin(odometry.yaw)
        return odometry.x + cos * self._guide, odometry.y + sin * self._guide, odometry.yaw

    def turn_rate(self, motion: MotionCommand) -> float:
        """[rad/s] that a motion command promises, positive left: what an operator would have to ask for."""
        exponent = self._parameters.turn_response_exponent
        return self._turning.turn_rate(
            motion.turn_rate_normalized, motion.forward_velocity, motion.turning_strategy, exponent
        )

    def step(self, stamp: int, command: ControlCommand | None, odometry: Odometry | None) -> MotionCommand:
        """Motion command of the tick at `stamp` [ns], from the newest command and the newest odometry (None: none yet).

        Before the first valid command, and once the last one is too old, the mouse stands still.
        """
        warnings: list[str] = []
        if self._last_stamp is not None and stamp < self._last_stamp:
            self._inbox.clear()
            self._leave_path()
        elapsed = 0.0 if self._last_stamp is None else max(0, stamp - self._last_stamp) * 1e-9
        self._last_stamp = stamp
        self._inbox.take(stamp, command, warnings)

        wish = self._inbox.command
        late = wish is not None and wish.posture in _GOES_ON and not self._inbox.fresh(stamp)
        if late and not self._late:
            warnings.append(f"no command for {self._config.command_timeout:g} s: the mouse stops")
        self._late = late
        if wish is None or late:
            wish = ControlCommand(stamp)
        motion = self._motion_command(stamp, elapsed, wish, odometry, warnings)
        self.warnings = tuple(warnings)
        return motion

    def _motion_command(
        self, stamp: int, elapsed: float, wish: ControlCommand, odometry: Odometry | None, warnings: list[str]
    ) -> MotionCommand:
        gait = wish.gait or self._parameters.default_gait
        frequency = wish.gait_frequency or self._parameters.default_gait_frequency
        strategy: TurningStrategy = wish.turning_strategy or self._parameters.default_turning_strategy  # type: ignore[assignment]
        if strategy == "leg" and wish.spine_modes.turning:
            strategy = "mix"
            if wish.turning_strategy:
                warnings.append("turning_strategy = leg contradicts the spine mode turning: turning by mix")
        posture, velocity, turn = Posture(wish.posture), 0.0, 0.0
        internal = posture is Posture.WALK and wish.trajectory_mode != TrajectoryMode.EXTERNAL
        if not internal:
            self._leave_path()
        if posture is Posture.WALK:
            turn_rate = 0.0 if internal else wish.turn_rate
            velocity = self._velocity(wish.forward_velocity, turn_rate, gait, frequency, strategy, warnings)
            if wish.forward_velocity == 0.0 and turn_rate == 0.0:
                posture = Posture.STILL
            elif not internal:
                turn_rate += self._hold_heading(stamp, velocity, turn_rate, frequency, odometry)
                turn = self._turn_for_rate(velocity, turn_rate, strategy, warnings)
            elif wish.trajectory_mode == TrajectoryMode.PATH and not self._accept_path(strategy, warnings):
                posture = Posture.STILL
            elif not self._usable(stamp, odometry):
                warnings.append("no usable odometry: the line or path is not held")
            else:
                assert odometry is not None, "usable odometry exists"
                by_spine = strategy == "spine" and not wish.spine_modes.stride_extension
                window = self._config.steering_window_spine if by_spine else self._config.steering_window
                turn = self._turn_along(
                    wish.trajectory_mode, elapsed, velocity, window / frequency, odometry, strategy, warnings
                )
                if self.path_status in (PathStatus.FINISHED, PathStatus.LOST):
                    posture = Posture.STILL
            turn = 0.0 if posture is Posture.STILL else min(max(turn + self._config.trim, -1.0), 1.0)
            velocity = 0.0 if posture is Posture.STILL else velocity
        if internal or posture is not Posture.WALK:
            self._heading.reset()
        return MotionCommand(stamp, velocity, turn, posture, gait, frequency, strategy, wish.spine_modes)

    def _hold_heading(
        self, stamp: int, velocity: float, turn_rate: float, frequency: float, odometry: Odometry | None
    ) -> float:
        """What to add to the turn rate asked for [rad/s], so that the mouse keeps its heading or reaches that rate."""
        if velocity == 0.0 or not (self._config.heading_hold and self._usable(stamp, odometry)):
            self._heading.reset()
            return 0.0
        assert odometry is not None, "usable odometry exists"
        return self._heading.step(odometry, turn_rate, self._config.heading_hold_gain, frequency)

    def _velocity(
        self,
        wanted: float,
        turn_rate: float,
        gait: str,
        frequency: float,
        strategy: TurningStrategy,
        warnings: list[str],
    ) -> float:
        """v_m [m/s] within what the gait can do. To turn on the spot the mouse has to walk its tightest circle."""
        fastest = self._parameters.fastest(gait, frequency)
        if wanted == 0.0 and turn_rate != 0.0:
            sharpest = self._turning.turn_rate(1.0, 1.0, strategy, self._parameters.turn_response_exponent)
            wanted = min(abs(turn_rate) / sharpest, fastest) if sharpest > 0.0 else 0.0
            warnings.append(f"the mouse cannot turn on the spot: it walks its tightest circle at {wanted:.3f} m/s")
        if abs(wanted) > fastest:
            warnings.append(f"forward_velocity = {wanted:.3f} m/s clipped to {fastest:.3f}, {gait} at {frequency} Hz")
            wanted = math.copysign(fastest, wanted)
        return wanted

    def _turn_for_rate(
        self, velocity: float, turn_rate: float, strategy: TurningStrategy, warnings: list[str]
    ) -> float:
        """alpha_tr for a turn rate [rad/s], as the strategy's radius predicts it; solved anew only when asked anew."""
        if (velocity, turn_rate, strategy) != self._solved_turn:
            self._solved_turn = (velocity, turn_rate, strategy)
            self._turn, self._turn_clipped = self._turning.turn_rate_to_normalized(
                turn_rate, velocity, strategy, self._parameters.turn_response_exponent
            )
        if self._turn_clipped:
            warnings.append(f"turn_rate = {turn_rate:.3f} rad/s is too sharp at {velocity:.3f} m/s, clipped")
        return self._turn

    # Lines and paths

    def _leave_path(self) -> None:
        """Forgets line and progress; the path itself stays."""
        self._follower, self._mean, self._integral, self.cross_track = None, CycleMean(), 0.0, 0.0
        if self.path_status is not PathStatus.IDLE:
            self.path_status, self._path = PathStatus.IDLE, None

    def _accept_path(self, strategy: TurningStrategy, warnings: list[str]) -> bool:
        """Whether there is a path that this strategy can follow and that has not come to its end."""
        if self._path is None:
            warnings.append("no path has been given: the mouse stands")
            return False
        if self.path_status in (PathStatus.FINISHED, PathStatus.LOST):
            return False
        smallest = self.smallest_radius(strategy)
        if self._path.smallest_radius < smallest:
            self.path_status = PathStatus.TOO_TIGHT
            warnings.append(
                f"the path cannot be followed: its radius of {self._path.smallest_radius:.3f} m is tighter than "
                f"the {smallest:.3f} m of turning by {strategy}"
            )
            return False
        self.path_status = PathStatus.FOLLOWING
        return True

    def smallest_radius(self, strategy: TurningStrategy) -> float:
        """Predicted radius at full lock [m], of the longest stride: (5.40)-(5.44)."""
        return self._turning.radius(
            1.0, strategy, self._parameters.longest_stride, self._parameters.turn_response_exponent
        )

    def _turn_along(
        self,
        mode: TrajectoryMode,
        elapsed: float,
        velocity: float,
        window: float,
        odometry: Odometry,
        strategy: TurningStrategy,
        warnings: list[str],
    ) -> float:
        """alpha_tr that leads along the path, or the line on which the mouse stood when the mode began.

        window: time over which distance and heading are averaged [s].
        """
        pose, config = self.guide_pose(odometry), self._config
        if self._follower is None:
            path = self._path if mode == TrajectoryMode.PATH and self._path is not None else Path.line(pose)
            self._follower = PathFollower(path, config.path_preview)
        deviation = self._follower.step(pose)
        self.cross_track = deviation.cross_track
        if mode == TrajectoryMode.PATH and deviation.progress >= self._follower.length:
            self.path_status = PathStatus.FINISHED
        elif mode == TrajectoryMode.PATH and abs(deviation.cross_track) > config.path_tolerance:
            self.path_status = PathStatus.LOST
            warnings.append(
                f"the path is lost: {abs(deviation.cross_track):.3f} m beside it after {deviation.progress:.2f} m, "
                f"allowed are {config.path_tolerance:.3f} m"
            )
        # Walking backwards, the same heading leads to the other side.
        along = math.copysign(config.heading_gain, velocity)
        cross_track, heading = self._mean.step(odometry.stamp, deviation.cross_track, deviation.heading, window)
        curvature = (
            deviation.curvature
            - config.cross_track_gain * cross_track
            - along * heading
            - config.integral_gain * self._integral
        )
        turn, clamped = self._turning.curvature_to_normalized(
            curvature, strategy, self._parameters.turn_response_exponent
        )
        if mode == TrajectoryMode.PATH and not clamped:
            self._integral += deviation.cross_track * elapsed
        return turn

    def _usable(self, stamp: int, odometry: Odometry | None) -> bool:
        if odometry is None or not math.isfinite(odometry.x + odometry.y + odometry.yaw):
            return False
        return self._config.lockstep or abs(stamp - odometry.stamp) <= self._timeout
