"""The servos' targets: feet -> spine and its offsets -> head, tail and inverse kinematics; and the servos' limits."""

from __future__ import annotations

import math
from collections.abc import Sequence

from nermo_control.gait.knowledge_base import GaitParameters
from nermo_control.gait.phase import Flags, LegStateMachine
from nermo_control.head import GazeController
from nermo_control.leg_controller import LegController
from nermo_control.motion.config import MotionModuleConfig
from nermo_control.motion.feet import Feet, neutral_feet
from nermo_control.motion.tick import Tick
from nermo_control.oscillators.legs import OscillatorLegs
from nermo_control.spine.controller import NOT_LIFTED, SpineController
from nermo_control.tail import TailController
from nermo_control.types import Four, MotionCommand, Posture
from nermo_description.blend import fastest_braked
from nermo_description.parameters import LEGS, RobotParameters

FARTHEST_BACK = 2e-3
"""A knee moves a foot by less than that in a tick [m]: so far an offset may even go back."""
LATEST_TICKS = 4
"""A tick may be late by three periods, and the servos go as far as they had time for; beyond that they take longer."""
HALVINGS = 12
"""An offset that comes later is found to a micrometre."""


class Body:
    """Spine, neck, tail and legs of one robot. `targets` and `servos` are [rad], in the order of the robot's servos."""

    def __init__(self, robot: RobotParameters, parameters: GaitParameters, period_ns: int) -> None:
        self._robot = robot
        self._spine = SpineController(robot, parameters, period_ns)
        self._head = GazeController(robot, period_ns)
        self._tail = TailController(robot, period_ns)
        self._legs = LegController(robot)
        self._names = tuple(robot.servos)
        self._index = {name: number for number, name in enumerate(self._names)}
        self._neutral = [servo.neutral for servo in robot.servos.values()]
        self._steps_of_a_tick = [servo.max_velocity * period_ns * 1e-9 for servo in robot.servos.values()]
        self._period = period_ns * 1e-9
        self._elapsed = self._period
        """Since the last tick [s]."""
        self._largest_steps = self._steps_of_a_tick
        self._knees = [self._index[f"{leg}_knee"] for leg in LEGS]
        self._offsets = [0.0] * len(LEGS)
        """Of the feet's heights, as they were placed last [m]."""
        self.targets: list[float] = []
        """Where the servos are to be."""
        self.servos: list[float] = []
        """What they were told last."""
        self._speeds: list[float] = []
        """How fast they are told to move [rad/s]."""

    def set_parameters(self, parameters: GaitParameters) -> None:
        """Takes new parameters of the spine's functions."""
        self._spine.set_parameters(parameters)

    def due(self, periods: float) -> None:
        """Says how many control periods this tick comes after the last one: what a servo can do in the meantime."""
        self._elapsed = periods * self._period
        periods = min(max(periods, 1.0), LATEST_TICKS)
        self._largest_steps = [periods * step for step in self._steps_of_a_tick]

    def begin(self, measured: Sequence[float], warnings: list[str]) -> None:
        """Begins where the servos are measured [rad]; in neutral where that is no number.

        Raises ValueError for a wrong number of them.
        """
        if len(measured) != len(self._names):
            raise ValueError(f"{len(measured)} servo positions, expected {len(self._names)}: {', '.join(self._names)}")
        self.targets = list(measured)
        for number, position in enumerate(measured):
            if not math.isfinite(position):
                self.targets[number] = self._neutral[number]
                warnings.append(f"{self._names[number]}: measured position {position} rad, neutral position assumed")
        self.servos = list(self.targets)
        self._speeds = [0.0] * len(self.servos)

    def moving(self) -> tuple[list[float], list[float]]:
        """Where servos are by now that went on as they were told [rad], and how fast [rad/s].

        A way that begins there, and so fast, does not jump; a servo that is near the end of its range is slower, and
        brakes within.
        """
        delay = min(self._elapsed, LATEST_TICKS * self._period)
        here, speeds = [], []
        for servo, told, speed in zip(self._robot.servos.values(), self.servos, self._speeds, strict=True):
            up, down = fastest_braked(servo.upper - told, delay), fastest_braked(told - servo.lower, delay)
            speeds.append(min(max(speed, -servo.max_velocity, -down), servo.max_velocity, up))
            here.append(told + speeds[-1] * delay)
        return here, speeds

    def within_ranges(self, wanted: Sequence[float | None], warnings: list[str]) -> list[float]:
        """Servo positions [rad] as far as each servo goes; one that nobody wants anywhere (None) stays as it was told.

        Raises ValueError for a wrong number of them.
        """
        found = []
        for (name, servo), target, told in zip(self._robot.servos.items(), wanted, self.servos, strict=True):
            here = told if target is None else target
            found.append(min(max(here, servo.lower), servo.upper))
            if target is not None and found[-1] != target:
                warnings.append(f"{name}: target beyond {servo.lower:g} to {servo.upper:g} rad, held to that range")
        return found

    def freeze(self) -> None:
        """The servos are to stay where they were told to be last."""
        self.targets = list(self.servos)

    def reset(self) -> None:
        """Spine, neck and tail go on from the targets, at rest."""
        vertical = self._index.get("spine_vertical")
        self._spine.reset(
            self.targets[self._index["spine_lateral"]], None if vertical is None else self.targets[vertical]
        )
        self._head.reset()
        self._tail.reset()
        self._offsets = [0.0] * len(LEGS)

    def posture(self, posture: Posture, parameters: GaitParameters, warnings: list[str]) -> list[float]:
        """Servo positions [rad] of a posture: STAND is the gait's neutral stance, others are the robot's own."""
        if posture is not Posture.STAND:
            return list(self._robot.posture(posture.name.lower()).values())
        servos = list(self._neutral)
        self._legs.step(*neutral_feet(parameters), servos, warnings)
        return servos

    def bend(
        self,
        tick: Tick,
        command: MotionCommand,
        config: MotionModuleConfig,
        feet: Feet,
        legs: LegStateMachine | OscillatorLegs,
        lifted: Flags = NOT_LIFTED,
    ) -> Four:
        """Bends spine, neck and tail; returns what is to be added to the feet's heights [m] for the hip's roll."""
        phases = legs.now if legs.frequency > 0.0 else None
        spine = self._spine.step(command, phases, feet.x, feet.z, lifted, config.arch)
        tick.warnings.extend(spine.warnings)
        targets, index = self.targets, self._index
        targets[index["spine_lateral"]] = spine.servo_position
        if spine.vertical_servo_position is not None:
            targets[index["spine_vertical"]] = spine.vertical_servo_position
        pan, tilt = self._head.step(tick.stamp, config.gaze, tick.imu, spine.flexion, legs.frequency)
        targets[index["head_pan"]] = pan
        if tilt is not None:
            targets[index["head_tilt"]] = tilt
        targets[index["tail"]] = self._tail.step(config.tail, config.tail_angle, spine.flexion)
        return spine.foot_offsets

    def place(self, feet: Feet, offsets: Four, lifting: bool, warnings: list[str]) -> None:
        """Puts the feet where they are wanted in their leg planes [m], with offsets of their heights.

        A swing may ask for nearly all that a knee can do. An offset that changes meanwhile then comes later, so that
        the foot keeps to its path; not so while a knee is pulled to lift a leg.
        """
        heights = [height + offset for height, offset in zip(feet.z, offsets, strict=True)]
        self._legs.step(feet.x, heights, self.targets, warnings)
        for leg, (wanted, last) in enumerate(zip(offsets, self._offsets, strict=True)):
            self._offsets[leg] = wanted
            if not lifting and (wanted or last) and self._too_fast(leg):
                self._offsets[leg] = self._later(leg, feet.x[leg], feet.z[leg], last, wanted)

    def _later(self, leg: int, x: float, z: float, last: float, wanted: float) -> float:
        """Places a leg with the offset [m] nearest to the wanted one that its knee reaches in this tick, if any."""
        side = self._too_fast(leg)

        def reached(offset: float) -> bool:
            self._legs.place(leg, x, z + offset, self.targets)
            return self._too_fast(leg) != side

        for slow in (last, last - math.copysign(FARTHEST_BACK, wanted - last)):
            if reached(slow):
                break
        else:
            reached(wanted)
            return wanted
        fast = wanted
        for _ in range(HALVINGS):
            middle = 0.5 * (slow + fast)
            slow, fast = (middle, fast) if reached(middle) else (slow, middle)
        reached(slow)
        return slow

    def _too_fast(self, leg: int) -> int:
        """1 or -1 where the target of a leg's knee is farther above or below than it gets in a tick, otherwise 0."""
        knee = self._knees[leg]
        move = self.targets[knee] - self.servos[knee]
        return (move > self._largest_steps[knee]) - (move < -self._largest_steps[knee])

    def pull_knee(self, leg: int, change: float) -> None:
        """Adds to the target of a leg's knee servo [rad], as far as it goes."""
        knee = self._knees[leg]
        lower = self._robot.servos[self._names[knee]].lower
        self.targets[knee] = max(self.targets[knee] + change, lower)

    def limit_rate(self, warnings: list[str]) -> None:
        """No servo is asked to move faster than it can: whatever came before, a command never jumps."""
        servos = list(self.targets)
        for number, (last, target, step) in enumerate(zip(self.servos, servos, self._largest_steps, strict=True)):
            if not -step <= target - last <= step:
                servos[number] = last + math.copysign(step, target - last)
                warnings.append(f"{self._names[number]}: faster than the servo, slowed down")
        self._speeds = [(now - last) / self._elapsed for now, last in zip(servos, self.servos, strict=True)]
        self.servos = servos
