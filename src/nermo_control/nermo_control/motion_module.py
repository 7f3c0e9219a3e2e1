"""The motion module: leg phases -> foot trajectories -> foot positions -> inverse kinematics -> servos (N 5.4.1).

Its state machine: HOLDING (servos rest) -> MOVING (to another posture, blended in servo space) -> HOLDING, and from
HOLDING on four feet -> WALKING -> SETTLING (swing feet straight down, stance feet stay where they are) -> HOLDING, and
from the stand -> LIFTING (one leg up, for as long as it is asked for, and down again) -> HOLDING.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from enum import Enum, auto
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from nermo_control.blend import Blend, smooth
from nermo_control.gait.knowledge_base import GaitParameters, gait_speed
from nermo_control.gait.phase import NONE_REQUESTED, LegStateMachine
from nermo_control.gait.trajectory import foot_position
from nermo_control.head import GazeController, GazeMode
from nermo_control.inbox import Inbox
from nermo_control.leg_controller import LegController
from nermo_control.lift import LIFTED_LEG, LegLift
from nermo_control.oscillators.legs import Coordination, OscillatorLegs, OscillatorSettings
from nermo_control.spine.controller import NOT_LIFTED, SpineController
from nermo_control.tail import TailController, TailMode
from nermo_control.turning import leg_modulation
from nermo_control.types import (
    FootTrajectory,
    Four,
    Imu,
    LegLoads,
    LegStates,
    MotionCommand,
    MotionOutput,
    Posture,
    SpineModes,
)
from nermo_control.validation import motion_command_error
from nermo_description.parameters import LEGS, RobotParameters

Source = Literal["trajectory_generator", "gait_knowledge_base"]
"""A node whose silence stops the mouse."""

GRAVITY = 9.81
"""[m/s^2]"""
_ELSEWHERE = Posture.STOP
"""Where a body stands that was stopped on its way: in no posture that has a name."""
_STANDING_STILL: Four = (0.0, 0.0, 0.0, 0.0)
_LEGS = (0, 1, 2, 3)


class MotionModuleConfig(BaseModel):
    """Settings of the motion module that are no gait parameters."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    silence_timeout: float = Field(
        0.3,
        ge=0.05,
        le=1.0,
        description="Silence of the command or of a node after which the mouse stops; a longer gap between ticks "
        "counts as a restart",
        json_schema_extra={"unit": "s", "readOnly": True},
    )
    posture_velocity: float = Field(
        3.0,
        ge=0.1,
        le=10.0,
        description="Fastest servo in a change of posture",
        json_schema_extra={"unit": "rad/s", "readOnly": True},
    )
    gaze: GazeMode = Field(
        "spine",
        description="How the neck cancels the gait's swing in the cameras' view: by the spine's command (yaw), by the "
        "IMU (yaw, and pitch where the head tilts), or off",
    )
    tail: TailMode = Field("off", description="spine: the tail bends against the spine and points straight back")
    tail_angle: float = Field(
        0.0,
        ge=-1.5,
        le=1.5,
        description="Bend of the whole tail while on four feet, positive left",
        json_schema_extra={"unit": "rad"},
    )
    arch: float = Field(
        0.0,
        ge=0.0,
        le=0.2,
        description="Vertical flexion of each lumbar joint while on four feet, positive arches the back; without a "
        "lumbar servo it does nothing",
        json_schema_extra={"unit": "rad"},
    )
    coordination: Coordination = Field(
        "timed",
        description="Who lifts a foot: the gait's clock, coupled oscillators (cpg), or the legs' loads (tegotae)",
        json_schema_extra={"readOnly": True},
    )
    oscillators: OscillatorSettings = OscillatorSettings()
    lockstep: bool = Field(
        False,
        description="The robot waits for each answer, so nothing is ever silent",
        json_schema_extra={"readOnly": True},
    )


class _Activity(Enum):
    HOLDING = auto()
    MOVING = auto()
    WALKING = auto()
    SETTLING = auto()
    LIFTING = auto()


class MotionModule:
    """Turns motion commands into servo positions, one control tick of `period_ns` at a time.

    It asks for each foot trajectory one tick ahead (`MotionOutput.leg_states.requested`); `accept` hands it the answer.
    """

    def __init__(
        self,
        robot: RobotParameters,
        gait_parameters: GaitParameters,
        period_ns: int,
        config: MotionModuleConfig | None = None,
    ) -> None:
        self._config = config or MotionModuleConfig()
        self._robot = robot
        self._period = period_ns
        self._legs = self._make_legs()
        self._spine = SpineController(robot, gait_parameters, period_ns)
        self._head = GazeController(robot, period_ns)
        self._tail = TailController(robot, period_ns)
        self._imu: Imu | None = None
        self._loads: LegLoads | None = None
        self._leg_controller = LegController(robot)
        self._names = tuple(robot.servos)
        self._neutral = [servo.neutral for servo in robot.servos.values()]
        self._index = {name: number for number, name in enumerate(self._names)}
        self._largest_steps = [servo.max_velocity * period_ns * 1e-9 for servo in robot.servos.values()]
        self._knees = [self._index[f"{leg}_knee"] for leg in LEGS]
        self._knee_limits = [robot.servos[f"{leg}_knee"].lower for leg in LEGS]
        self._timeout = round(self._config.silence_timeout * 1e9)
        self._inbox: Inbox[MotionCommand] = Inbox(
            lambda command: motion_command_error(command, self._parameters),
            self._config.silence_timeout,
            self._config.lockstep,
        )
        self._parameters = gait_parameters
        self._alive: dict[Source, int] = {}
        self._last_stamp: int | None = None
        self._output: MotionOutput
        self._targets: list[float] = []
        self._servos: list[float] = []
        self._activity = _Activity.HOLDING
        self._at: Posture | None = None
        self._moving_to: Posture | None = None
        self._lift: LegLift
        self._lifting: Posture | None = None
        self._lifting_modes = SpineModes()
        self._blend: Blend
        self._x, self._z = _neutral_feet(gait_parameters)
        self._trajectories: list[FootTrajectory | None] = [None] * 4
        self._coming: list[FootTrajectory | None] = [None] * 4
        self._awaited: list[int | None] = [None] * 4
        self._first_fractions = [0.0] * 4
        """Where in its phase each leg's newest trajectory begins."""
        self._settle_start = self._settle_duration = 0
        self._settle_from: tuple[float, ...] = ()
        self._settle_to: tuple[float, ...] = ()

    def _make_legs(self) -> LegStateMachine | OscillatorLegs:
        config = self._config
        if config.coordination == "timed":
            return LegStateMachine(self._period)
        weight = self._robot.masses.total * GRAVITY
        return OscillatorLegs(self._period, config.coordination, config.oscillators, weight)

    def set_parameters(self, parameters: GaitParameters) -> None:
        """Takes new gait parameters; the same ones again change nothing.

        A changed gait starts with the next cycle, a changed neutral stance at once.
        """
        if parameters == self._parameters:
            return
        if _neutral_feet(parameters) != _neutral_feet(self._parameters):
            self._at = _ELSEWHERE if self._at is Posture.STAND else self._at
            self._moving_to = _ELSEWHERE if self._moving_to is Posture.STAND else self._moving_to
        self._parameters = parameters
        self._inbox.recheck()
        self._spine.set_parameters(parameters)

    def set_config(self, config: MotionModuleConfig) -> None:
        """Takes new settings of head, tail, back and oscillators, without a jump; the others stay."""
        self._config = self._config.model_copy(
            update={name: getattr(config, name) for name in ("gaze", "tail", "tail_angle", "arch", "oscillators")}
        )
        if isinstance(self._legs, OscillatorLegs):
            self._legs.set_settings(config.oscillators)

    def sign_of_life(self, source: Source, stamp: int) -> None:
        """Notes that a node was alive at `stamp` [ns], when it sent its parameters or of the leg states it answered."""
        self._alive[source] = stamp

    def accept(self, trajectory: FootTrajectory) -> None:
        """Takes an answer of the trajectory generator; one that nobody is waiting for is ignored.

        Raises ValueError where it is not finite.
        """
        numbers = trajectory.x_first + trajectory.x_second + trajectory.z_first + trajectory.z_second
        if not (math.isfinite(sum(numbers)) and 0.0 < trajectory.duration < math.inf):
            raise ValueError(f"foot trajectory of leg {trajectory.leg} is not finite or has no duration")
        if trajectory.leg in _LEGS and trajectory.start_time == self._awaited[trajectory.leg]:
            self._coming[trajectory.leg] = trajectory

    def step(
        self,
        stamp: int,
        command: MotionCommand | None,
        servo_positions: Sequence[float],
        imu: Imu | None = None,
        loads: LegLoads | None = None,
    ) -> MotionOutput:
        """One control tick at `stamp` [ns]: the newest command and the measured servo positions [rad], in robot order.

        The measured positions matter at the start and after a jump of the clock, where the mouse moves on from them.
        `imu` and `loads`: the newest; only the gaze mode `imu` and the coordination `tegotae` need them.
        """
        if stamp == self._last_stamp:
            return self._output
        warnings: list[str] = []
        if self._last_stamp is None or not 0 < stamp - self._last_stamp <= self._timeout:
            self._restart(stamp, servo_positions, warnings)
        self._last_stamp, self._imu, self._loads = stamp, imu, loads

        self._inbox.take(stamp, command, warnings)
        self._choose_activity(stamp, self._goal(stamp, warnings), warnings)

        velocities = _STANDING_STILL
        if self._activity is _Activity.MOVING:
            self._move(stamp)
        elif self._activity is _Activity.SETTLING:
            self._settle(stamp)
        elif self._activity is _Activity.WALKING:
            velocities = self._walk(stamp, warnings)
        if self._on_feet():
            self._place_feet(stamp, warnings)

        self._servos = self._limit_rate(warnings)
        self._output = MotionOutput(tuple(self._servos), self._leg_states(stamp, velocities), tuple(warnings))
        return self._output

    # What to do now

    def _goal(self, stamp: int, warnings: list[str]) -> Posture | None:
        """Posture that is wanted now; None while nothing ever was. Silence turns walking into standing still."""
        command = self._inbox.command
        if command is None:
            return None
        if command.posture == Posture.WALK and (silent := self._silent(stamp)):
            if self._activity is _Activity.WALKING:
                warnings.append(f"nothing from {' and '.join(silent)} for {self._timeout * 1e-9:g} s: the mouse stops")
            return Posture.STILL
        return Posture(command.posture)

    def _silent(self, stamp: int) -> list[str]:
        """Nodes whose last message no longer counts; without all of them the mouse does not walk."""
        silent = [] if self._inbox.fresh(stamp) else ["high_level_controller"]
        if not self._config.lockstep:
            sources: tuple[Source, ...] = ("gait_knowledge_base", "trajectory_generator")
            silent += [s for s in sources if s not in self._alive or abs(stamp - self._alive[s]) > self._timeout]
        return silent

    def _choose_activity(self, stamp: int, goal: Posture | None, warnings: list[str]) -> None:
        """The small state machine of this module; one transition a tick."""
        activity = self._activity
        if goal is Posture.STOP:
            if not (activity is _Activity.HOLDING and self._at is _ELSEWHERE):
                self._hold(at=_ELSEWHERE)
                self._targets = list(self._servos)
        elif activity is _Activity.WALKING:
            if goal is not Posture.WALK:
                self._start_settling(stamp)
        elif activity is _Activity.LIFTING:
            self._keep_lifting(stamp, goal)
        elif activity is not _Activity.SETTLING and goal is not None:
            self._follow(stamp, goal, warnings)

    def _follow(self, stamp: int, goal: Posture, warnings: list[str]) -> None:
        """From holding or moving towards the goal. Walking begins on four feet; nothing moves before it is asked to."""
        holding = self._activity is _Activity.HOLDING
        on_feet = self._on_feet()
        if goal is Posture.STILL and (on_feet or self._at is None):
            return
        if goal is Posture.WALK and on_feet:
            self._start_walking(stamp)
            return
        if goal in LIFTED_LEG and holding and self._at is Posture.STAND:
            self._start_lifting(stamp, goal)
            return
        target = Posture.STAND if goal in (Posture.WALK, Posture.STILL, *LIFTED_LEG) else goal
        if target is not (self._at if holding else self._moving_to):
            self._blend = Blend(
                self._servos, self._posture_servos(target, warnings), self._config.posture_velocity, stamp
            )
            self._moving_to = target
            self._activity = _Activity.MOVING

    def _on_feet(self) -> bool:
        """Whether the feet are where the gait has them, and not in a posture or on the way to one."""
        if self._activity is _Activity.HOLDING:
            return self._at is Posture.STAND or self._at is Posture.STILL
        return self._activity is not _Activity.MOVING

    def _hold(self, at: Posture | None) -> None:
        """Rests in a posture; None after a start, until a posture is asked for."""
        self._activity, self._at = _Activity.HOLDING, at
        if at is Posture.STAND:
            self._x, self._z = _neutral_feet(self._parameters)
            vertical = self._index.get("spine_vertical")
            self._spine.reset(
                self._targets[self._index["spine_lateral"]], None if vertical is None else self._targets[vertical]
            )
            self._head.reset()
            self._tail.reset()
        self._stop_legs()

    def _restart(self, stamp: int, measured: Sequence[float], warnings: list[str]) -> None:
        """Forgets everything and holds the servos where they are."""
        if len(measured) != len(self._names):
            raise ValueError(f"{len(measured)} servo positions, expected {len(self._names)}: {', '.join(self._names)}")
        self._targets = list(measured)
        for number, position in enumerate(measured):
            if not math.isfinite(position):
                self._targets[number] = self._neutral[number]
                warnings.append(f"{self._names[number]}: measured position {position} rad, neutral position assumed")
        self._servos = list(self._targets)
        self._inbox.clear()
        self._hold(at=None)

    # Postures

    def _move(self, stamp: int) -> None:
        self._targets = self._blend.at(stamp)
        if self._blend.done(stamp):
            self._hold(at=self._moving_to)

    def _posture_servos(self, posture: Posture, warnings: list[str]) -> list[float]:
        """Servo positions [rad] of a posture: STAND is the gait's neutral stance, others are the robot's own."""
        if posture is not Posture.STAND:
            return list(self._robot.posture(posture.name.lower()).values())
        servos = list(self._neutral)
        self._leg_controller.step(*_neutral_feet(self._parameters), servos, warnings)
        return servos

    # One leg lifted

    def _start_lifting(self, stamp: int, posture: Posture) -> None:
        self._activity, self._lifting = _Activity.LIFTING, posture
        self._lift = LegLift(LIFTED_LEG[posture], stamp)
        self._keep_lifting(stamp, posture)

    def _keep_lifting(self, stamp: int, goal: Posture | None) -> None:
        """Until another posture is wanted; then the leg comes down first, and until it stands the balance is kept."""
        if goal is not self._lifting:
            self._lift.lower(stamp)
        elif self._inbox.command is not None:
            self._lifting_modes = self._inbox.command.spine_modes
        if self._lift.down(stamp):
            self._hold(at=Posture.STILL)

    # Walking

    def _start_walking(self, stamp: int) -> None:
        command = self._walking_command()
        self._legs.start(stamp, self._parameters.gaits[command.gait], command.gait_frequency)
        self._activity = _Activity.WALKING

    def _walking_command(self) -> MotionCommand:
        command = self._inbox.command
        assert command is not None, "walking without a command"
        return command

    def _walk(self, stamp: int, warnings: list[str]) -> Four:
        """One tick of walking: command -> leg phases -> foot positions. Returns v_legs [m/s]."""
        command = self._walking_command()
        gait, legs = self._parameters.gaits[command.gait], self._legs
        if isinstance(legs, OscillatorLegs):
            legs.step(stamp, gait, command.gait_frequency, self._fresh_loads(stamp, warnings))
        else:
            legs.step(stamp, gait, command.gait_frequency)
        self._evaluate_trajectories(stamp)
        return self._leg_velocities(command, warnings)

    def _fresh_loads(self, stamp: int, warnings: list[str]) -> Four | None:
        """What the feet bear [N], if that is known and wanted."""
        if self._config.coordination != "tegotae":
            return None
        loads = self._loads
        if loads is None or abs(stamp - loads.stamp) > self._timeout:
            warnings.append("no leg_loads: the legs run free of their loads")
            return None
        return loads.load

    def _evaluate_trajectories(self, stamp: int) -> None:
        for leg in _LEGS:
            coming = self._coming[leg]
            if coming is not None and coming.start_time <= stamp:
                self._trajectories[leg], self._coming[leg] = coming, None
            trajectory = self._trajectories[leg]
            if trajectory is not None:
                when = stamp if self._config.coordination == "timed" else self._place_on_path(leg, trajectory)
                self._x[leg], self._z[leg] = foot_position(trajectory, when)

    def _place_on_path(self, leg: int, trajectory: FootTrajectory) -> int:
        """The time [ns] at which a clock would have the foot as far on its path as its oscillator has it now."""
        if trajectory.phase is not self._legs.now.phases[leg]:
            return _end(trajectory)  # the next one is late
        first = self._first_fractions[leg]
        share = (self._legs.now.fractions[leg] - first) / (1.0 - first)
        return trajectory.start_time + round(share * trajectory.duration * 1e9)

    def _leg_velocities(self, command: MotionCommand, warnings: list[str]) -> Four:
        """v_legs [m/s]: the target velocity, within the longest stride, modulated for turning (5.38)-(5.39)."""
        parameters, velocity = self._parameters, command.forward_velocity
        longest = min(parameters.front.max_stride_length, parameters.rear.max_stride_length)
        fastest = gait_speed(self._legs.frequency, longest, 1.0 / self._legs.duty_factor)
        if abs(velocity) > fastest * (1.0 + 1e-9):
            warnings.append(f"forward_velocity = {velocity:.3f} m/s: stride too long, clipped to {fastest:.3f} m/s")
            velocity = math.copysign(fastest, velocity)
        turn = 0.0 if command.turning_strategy == "spine" else command.turn_rate_normalized
        left, right = leg_modulation(turn, parameters.turn_response_exponent)
        return velocity * left, velocity * right, velocity * left, velocity * right

    def _stop_legs(self) -> None:
        """The gait cycle ends; trajectories still to come are of no use."""
        self._legs.stand()
        self._trajectories = [None] * 4
        self._coming = [None] * 4
        self._awaited = [None] * 4

    # Settling

    def _start_settling(self, stamp: int) -> None:
        self._activity = _Activity.SETTLING
        self._settle_start, self._settle_from = stamp, tuple(self._z)
        self._settle_to = tuple(_neutral_feet(self._parameters)[1])
        self._settle_duration = round(self._parameters.settle_duration * 1e9)
        self._stop_legs()

    def _settle(self, stamp: int) -> None:
        """All feet to the neutral stance height where they are: swing feet go straight down, stance feet stay."""
        share = smooth((stamp - self._settle_start) / self._settle_duration)
        self._z = [start + share * (end - start) for start, end in zip(self._settle_from, self._settle_to, strict=True)]
        if share >= 1.0:
            self._hold(at=Posture.STILL)

    # What leaves the module

    def _place_feet(self, stamp: int, warnings: list[str]) -> None:
        """Foot positions -> spine and its offsets -> head and tail, inverse kinematics."""
        command, config, z = self._inbox.command, self._config, self._z
        if command is not None:
            legs = self._legs.now if self._activity is _Activity.WALKING else None
            lifted = NOT_LIFTED
            if self._activity is _Activity.LIFTING:
                command, lifted = replace(command, spine_modes=self._lifting_modes), self._lift.lifted
            spine = self._spine.step(command, legs, self._x, z, lifted, config.arch)
            z = [height + offset for height, offset in zip(z, spine.foot_offsets, strict=True)]
            warnings.extend(spine.warnings)
            targets, index = self._targets, self._index
            targets[index["spine_lateral"]] = spine.servo_position
            if spine.vertical_servo_position is not None:
                targets[index["spine_vertical"]] = spine.vertical_servo_position
            pan, tilt = self._head.step(stamp, config.gaze, self._imu, spine.flexion, self._legs.frequency)
            targets[index["head_pan"]] = pan
            if tilt is not None:
                targets[index["head_tilt"]] = tilt
            targets[index["tail"]] = self._tail.step(config.tail, config.tail_angle, spine.flexion)
        self._leg_controller.step(self._x, z, self._targets, warnings)
        if self._activity is _Activity.LIFTING:
            knee = self._knees[self._lift.leg]
            self._targets[knee] = max(self._targets[knee] + self._lift.knee(stamp), self._knee_limits[self._lift.leg])

    def _leg_states(self, stamp: int, velocities: Four) -> LegStates:
        """State of the legs and the request for trajectories that begin one tick ahead, where the feet will then be."""
        legs, start = self._legs, stamp + self._period
        x, z = list(self._x), list(self._z)
        if legs.requested is not NONE_REQUESTED:
            for leg, trajectory in enumerate(self._trajectories):
                if legs.requested[leg]:
                    self._awaited[leg] = start
                    self._first_fractions[leg] = legs.next.fractions[leg]
                    if trajectory is not None:
                        when = start if self._config.coordination == "timed" else _end(trajectory)
                        x[leg], z[leg] = foot_position(trajectory, when)
        a, b, c, d = legs.next.fractions
        return LegStates(
            stamp=stamp,
            phases=legs.now.phases,
            phase_fractions=legs.now.fractions,
            velocities=velocities,
            requested=legs.requested,
            next_phases=legs.next.phases,
            start_time=start,
            durations=legs.next.remaining,
            remaining_fractions=(1.0 - a, 1.0 - b, 1.0 - c, 1.0 - d),
            start_x=(x[0], x[1], x[2], x[3]),
            start_z=(z[0], z[1], z[2], z[3]),
            gait_frequency=legs.frequency,
            duty_factor=legs.duty_factor,
        )

    def _limit_rate(self, warnings: list[str]) -> list[float]:
        """No servo is asked to move faster than it can: whatever came before, a command never jumps."""
        servos = list(self._targets)
        for number, (last, target, step) in enumerate(zip(self._servos, servos, self._largest_steps, strict=True)):
            if not -step <= target - last <= step:
                servos[number] = last + math.copysign(step, target - last)
                warnings.append(f"{self._names[number]}: faster than the servo, slowed down")
        return servos


def _end(trajectory: FootTrajectory) -> int:
    """[ns]"""
    return trajectory.start_time + round(trajectory.duration * 1e9)


def _neutral_feet(parameters: GaitParameters) -> tuple[list[float], list[float]]:
    strides = [parameters.stride(leg) for leg in _LEGS]
    return [s.neutral_stride_position for s in strides], [s.neutral_stance_height for s in strides]
