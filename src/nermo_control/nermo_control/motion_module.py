"""The motion module: leg phases -> foot trajectories -> foot positions -> inverse kinematics -> servos (N 5.4.1).

A machine that runs the states of `motion/states.py`, one control tick at a time.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from nermo_control.gait.knowledge_base import GaitParameters
from nermo_control.gait.phase import LegStateMachine
from nermo_control.inbox import Inbox
from nermo_control.motion.body import Body
from nermo_control.motion.config import MotionModuleConfig
from nermo_control.motion.context import STANDING_STILL, MotionContext
from nermo_control.motion.feet import Feet, neutral_feet
from nermo_control.motion.states import Following, Holding, State, Walking
from nermo_control.motion.tick import Tick
from nermo_control.oscillators.legs import OscillatorLegs
from nermo_control.types import FootTrajectory, Imu, LegLoads, MotionCommand, MotionOutput, Posture, ServoTargets
from nermo_control.validation import motion_command_error
from nermo_description.parameters import RobotParameters

Source = Literal["trajectory_generator", "gait_knowledge_base"]
"""A node whose silence stops the mouse."""

GRAVITY = 9.81
"""[m/s^2]"""
_SOURCES: tuple[Source, ...] = ("gait_knowledge_base", "trajectory_generator")


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
        config = config or MotionModuleConfig()
        legs = _make_legs(robot, period_ns, config)
        self._context = MotionContext(
            config=config,
            parameters=gait_parameters,
            timeout=round(config.silence_timeout * 1e9),
            legs=legs,
            feet=Feet(gait_parameters, legs, period_ns),
            body=Body(robot, gait_parameters, period_ns),
            tick=Tick(0),
        )
        self._inbox: Inbox[MotionCommand] = Inbox(
            lambda command: motion_command_error(command, self._context.parameters),
            config.silence_timeout,
            config.lockstep,
        )
        self._state: State
        self._period = period_ns
        self._alive: dict[Source, int] = {}
        self._last_stamp: int | None = None
        self._output: MotionOutput

    def set_parameters(self, parameters: GaitParameters) -> None:
        """Takes new gait parameters; the same ones again change nothing.

        A changed gait starts with the next cycle, a changed neutral stance at once.
        """
        context = self._context
        if parameters == context.parameters:
            return
        if self._last_stamp is not None and neutral_feet(parameters) != neutral_feet(context.parameters):
            self._state.stance_changed()
        context.parameters = parameters
        self._inbox.recheck()
        context.body.set_parameters(parameters)

    def set_config(self, config: MotionModuleConfig) -> None:
        """Takes new settings of head, tail, back and oscillators, without a jump; the others stay."""
        context = self._context
        context.config = context.config.model_copy(
            update={name: getattr(config, name) for name in ("gaze", "tail", "tail_angle", "arch", "oscillators")}
        )
        if isinstance(context.legs, OscillatorLegs):
            context.legs.set_settings(config.oscillators)

    def sign_of_life(self, source: Source, stamp: int) -> None:
        """Notes that a node was alive at `stamp` [ns], when it sent its parameters or of the leg states it answered."""
        self._alive[source] = stamp

    def accept(self, trajectory: FootTrajectory) -> None:
        """Takes an answer of the trajectory generator; one that nobody is waiting for is ignored.

        Raises ValueError where it is not finite.
        """
        self._context.feet.accept(trajectory)

    def step(
        self,
        stamp: int,
        command: MotionCommand | None,
        servo_positions: Sequence[float],
        imu: Imu | None = None,
        loads: LegLoads | None = None,
        targets: ServoTargets | None = None,
    ) -> MotionOutput:
        """One control tick at `stamp` [ns]: the newest command and the measured servo positions [rad], in robot order.

        The measured positions matter at the start and after a jump of the clock, where the mouse moves on from them.
        `imu`, `loads` and `targets`: the newest; only the gaze mode `imu`, the coordination `tegotae` and the posture
        DIRECT need them.
        """
        if stamp == self._last_stamp:
            return self._output
        context = self._context
        context.tick = tick = Tick(stamp, imu, loads, targets)
        context.velocities = STANDING_STILL
        if self._last_stamp is None or not 0 < stamp - self._last_stamp <= context.timeout:
            self._restart(servo_positions)
            context.body.due(1.0)
        else:
            context.body.due((stamp - self._last_stamp) / self._period)
        self._last_stamp = stamp

        self._inbox.take(stamp, command, tick.warnings)
        tick.command = self._inbox.command
        self._state = self._state.next(context, self._goal()).step(context)

        context.body.limit_rate(tick.warnings)
        states = context.feet.leg_states(stamp, context.velocities)
        self._output = MotionOutput(tuple(context.body.servos), states, tuple(tick.warnings))
        return self._output

    def _restart(self, measured: Sequence[float]) -> None:
        """Forgets everything and holds the servos where they are."""
        self._context.body.begin(measured, self._context.tick.warnings)
        self._inbox.clear()
        self._state = Holding.begin(self._context, at=None)

    def _goal(self) -> Posture | None:
        """Posture that is wanted now; None while nothing ever was. Silence turns walking into standing still."""
        context, command = self._context, self._context.tick.command
        if command is None:
            return None
        if command.posture == Posture.WALK and (silent := self._silent()):
            if isinstance(self._state, Walking):
                names = " and ".join(silent)
                context.tick.warnings.append(f"nothing from {names} for {context.timeout * 1e-9:g} s: the mouse stops")
            return Posture.STILL
        if command.posture == Posture.DIRECT and (missing := self._nothing_to_follow()):
            if isinstance(self._state, Following):
                context.tick.warnings.append(
                    f"nothing from {missing} for {context.timeout * 1e-9:g} s: the mouse stands"
                )
            return Posture.STAND
        return Posture(command.posture)

    def _nothing_to_follow(self) -> str:
        """Who is silent, so that the servos cannot go where they are told from outside; empty where they can."""
        stamp, targets = self._context.tick.stamp, self._context.tick.targets
        if not self._inbox.fresh(stamp):
            return "high_level_controller"
        told = targets is not None and abs(stamp - targets.stamp) <= self._context.timeout
        return "" if told else "servo_targets"

    def _silent(self) -> list[str]:
        """Nodes whose last message no longer counts; without all of them the mouse does not walk."""
        stamp, timeout = self._context.tick.stamp, self._context.timeout
        silent = [] if self._inbox.fresh(stamp) else ["high_level_controller"]
        if not self._context.config.lockstep:
            silent += [s for s in _SOURCES if s not in self._alive or abs(stamp - self._alive[s]) > timeout]
        return silent


def _make_legs(robot: RobotParameters, period_ns: int, config: MotionModuleConfig) -> LegStateMachine | OscillatorLegs:
    if config.coordination == "timed":
        return LegStateMachine(period_ns)
    return OscillatorLegs(period_ns, config.coordination, config.oscillators, robot.masses.total * GRAVITY)
