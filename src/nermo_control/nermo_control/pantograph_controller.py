"""The controller of a robot with pantograph legs, as C figure 3.4: oscillators, foot locus, inverse kinematics."""

from __future__ import annotations

import math
from collections.abc import Sequence

from pydantic import BaseModel, ConfigDict, Field

from nermo_control.gait.foot_locus import Point, locus_curves
from nermo_control.gait.gaits import GaitDefinition
from nermo_control.legs.aslp import AslpLeg, AslpSprings
from nermo_control.oscillators.legs import OscillatorLegs, OscillatorSettings
from nermo_control.pantograph_gaits import PANTOGRAPH_GAITS
from nermo_control.types import ControlCommand, Imu, LegLoads, LegStates, MotionOutput, Odometry, Phase, Posture
from nermo_description.blend import smooth
from nermo_description.pantograph import PantographLeg, PantographParameters
from nermo_description.parameters import LEGS

GRAVITY = 9.81
MOVE_DURATION = 0.5
"""Time in which a posture, or the first step, is blended in [s]."""
FARTHEST = 0.999
"""Share of the stretched leg's length that a foot target may have [1]."""
NEAREST = 1.1
"""Least length of the leg, in that of the folded one [1]."""
_POSTURES = {Posture.STAND: "stand", Posture.SIT: "sit", Posture.CROUCH: "crouch"}


def aslp_leg(leg: PantographLeg) -> AslpLeg:
    """Kinematics of a described leg (C table A.1)."""
    return AslpLeg(
        l1=leg.upper_length,
        l2=leg.middle_length,
        l3=leg.lower_length,
        l_delta=leg.spacing,
        cable_max=leg.cable_max,
        parallel_travel=leg.parallel_travel,
    )


def aslp_springs(leg: PantographLeg, stiffness: float = 1.0) -> AslpSprings:
    """Both springs of a described leg (C table A.3), their stiffnesses times a factor."""
    return AslpSprings(
        diagonal_stiffness=stiffness * leg.diagonal_stiffness,
        diagonal_rest=leg.diagonal_max + leg.diagonal_precompression,
        parallel_stiffness=stiffness * leg.parallel_stiffness,
        parallel_rest=leg.middle_length - leg.parallel_precompression,
    )


class _Frozen(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class LocusShape(_Frozen):
    """Foot locus of one leg pair (C table 3.1), in its leg plane; the foot is F, where the toe begins."""

    height: float = Field(0.113, gt=0.0, le=0.5, description="H, hip above the foot [m]")
    step_height: float = Field(0.014, ge=0.0, le=0.2, description="h [m]")
    offset: float = Field(0.0, ge=-0.2, le=0.2, description="x_o, middle of the stance [m]")
    compression: float = Field(0.67, ge=0.0, le=1.0, description="c: at 1 the stance is flat [1]")
    touch_down_angle: float = Field(1.81, ge=0.8, le=2.4, description="theta_td [rad]: above pi / 2 it retracts")
    take_off_angle: float = Field(1.37, ge=0.8, le=2.4, description="theta_to [rad]")

    def point(self, swings: bool, fraction: float, length: float) -> tuple[float, float]:
        """Foot (x, z) [m] at a share of its swing or stance, for a step of `length` L [m] (C table 3.2)."""
        ahead = Point(self.offset + 0.5 * length, -self.height)
        behind = Point(self.offset - 0.5 * length, -self.height)
        if swings:
            middle = Point(self.offset, -self.height + self.step_height)
            curves = locus_curves(behind, middle, ahead, self.take_off_angle, self.touch_down_angle, 1.0)
        else:
            middle = Point(self.offset, -self.height - (1.0 - self.compression) * self.step_height)
            curves = locus_curves(ahead, middle, behind, self.touch_down_angle, self.take_off_angle, 1.0)
        second = fraction >= 0.5
        t = fraction - 0.5 if second else fraction
        (_, b, c, d), (_, f, g, h) = curves[second], curves[2 + second]
        return (b * t + c) * t + d, (f * t + g) * t + h


class PantographGait(_Frozen):
    """All that shapes a gait of the open-loop approach and of Tegotae (C table 3.3).

    The defaults are a trot of Cheetah-Cub with L = 12.6 cm at 2.86 Hz: of 270 random gaits and 110 near the best, the
    one that also trots on smoother and rougher ground and with a third of the step taken off.
    """

    front: LocusShape = LocusShape(offset=-0.023)
    rear: LocusShape = LocusShape(offset=-0.033)
    duty_factor: float = Field(0.56, ge=0.2, le=0.95, description="d [1]")
    kind: str = Field("cpg", pattern="^(cpg|tegotae)$", description="who coordinates the legs")
    oscillators: OscillatorSettings = OscillatorSettings()
    length_rate: float = Field(0.4, gt=0.0, le=10.0, description="how fast L follows a new one [m/s]")


class PantographController:
    """Oscillators -> foot locus -> inverse kinematics -> servos, once a control tick; postures are blended in.

    A command's `gait` is one of PANTOGRAPH_GAITS; its `gait_frequency` is the excitation, and its
    `forward_velocity` v sets the step length L = v d / f.
    """

    def __init__(self, robot: PantographParameters, gait: PantographGait, period_ns: int) -> None:
        self._robot, self._gait, self._period = robot, gait, period_ns * 1e-9
        self._kinematics = aslp_leg(robot.leg)
        self._reach = (
            NEAREST * self._kinematics.shortest,
            FARTHEST * self._kinematics.longest,
        )
        self._legs = OscillatorLegs(period_ns, gait.kind, gait.oscillators, robot.mass * GRAVITY)  # type: ignore[arg-type]
        self._walks = False
        self._length = 0.0
        self.landings = [0.0] * len(LEGS)
        """How much farther ahead each foot is to land than the step length says [m]; taken over as its swing begins."""
        self._shifts = [(0.0, 0.0)] * len(LEGS)
        self._target: tuple[float, ...] | None = None
        self._posture: Posture | None = None
        self._from: tuple[float, ...] = ()
        self._since = 0
        self._command: ControlCommand | None = None

    @property
    def phases(self) -> Sequence[float]:
        """Theta of the four legs [rad], in [0, 2 pi)."""
        return self._legs.phases

    @property
    def shifts(self) -> tuple[float, ...]:
        """How much farther ahead each foot stands, or is on its way to, because of `landings` [m]."""
        return tuple(after for _, after in self._shifts)

    @property
    def step_length(self) -> float:
        """L in use [m]."""
        return self._length

    def step(
        self,
        stamp: int,
        control_command: ControlCommand | None,
        odometry: Odometry | None,
        servo_positions: Sequence[float],
        imu: Imu | None = None,
        loads: LegLoads | None = None,
    ) -> MotionOutput:
        """One control tick at `stamp` [ns]; odometry and IMU are not used. Raises ValueError for an unknown gait."""
        if control_command is not None:
            self._command = control_command
        command, warnings = self._command, list[str]()
        if command is None:
            # What is measured once is held: measured anew in each tick, the goal would sink with the robot.
            self._target = self._target or tuple(servo_positions)
            return self._output(stamp, self._target, warnings)
        walks = command.posture is Posture.WALK and command.gait_frequency > 0.0
        if walks != self._walks or command.posture != self._posture:
            self._from = self._target or tuple(servo_positions)
            self._since, self._walks, self._posture = stamp, walks, command.posture
            self._length = 0.0
            self._shifts = [(0.0, 0.0)] * len(LEGS)
            if walks:
                self._legs.start(stamp, self._definition(command), command.gait_frequency)
            else:
                self._legs.stand()
        if walks:
            aim = self._walk(stamp, command, loads, warnings)
        else:
            aim = tuple(self._robot.posture(_POSTURES.get(command.posture, "stand")).values())
        share = smooth((stamp - self._since) * 1e-9 / MOVE_DURATION)
        self._target = tuple(a + share * (b - a) for a, b in zip(self._from, aim, strict=True))
        return self._output(stamp, self._target, warnings)

    def _definition(self, command: ControlCommand) -> GaitDefinition:
        duty = self._gait.duty_factor
        name = command.gait or next(iter(PANTOGRAPH_GAITS))
        if name not in PANTOGRAPH_GAITS:
            raise ValueError(f"gait {name!r} is unknown: choose one of {', '.join(PANTOGRAPH_GAITS)}")
        return GaitDefinition(duty_factor=duty, phase_offsets=PANTOGRAPH_GAITS[name].phase_offsets)

    def _walk(
        self, stamp: int, command: ControlCommand, loads: LegLoads | None, warnings: list[str]
    ) -> tuple[float, ...]:
        frequency = command.gait_frequency
        self._legs.step(stamp, self._definition(command), frequency, None if loads is None else loads.load)
        wanted = command.forward_velocity * self._legs.duty_factor / frequency
        most = self._gait.length_rate * self._period
        self._length += min(max(wanted - self._length, -most), most)
        servos: list[float] = []
        for leg in range(len(LEGS)):
            shape = self._gait.front if leg < 2 else self._gait.rear
            place = self._legs.next
            swings, fraction = place.phases[leg] is Phase.SWING, place.fractions[leg]
            x, z = shape.point(swings, fraction, self._length)
            servos += self._servos(leg, x + self._shift(leg, swings, fraction), z, warnings)
        return tuple(servos)

    def _shift(self, leg: int, swings: bool, fraction: float) -> float:
        """How far a leg's path is moved ahead [m]: a change is made within one swing, and held while it stands.

        So one longer step is followed by steps of the usual length from the new place, until the change is taken back.
        A leg that its load pushes back out of a swing or a stance goes on with what it had there.
        """
        before, after = self._shifts[leg]
        if swings != (self._legs.now.phases[leg] is Phase.SWING):
            pushed_back = fraction > 0.5
            if swings:
                before, after = after, after if pushed_back else self.landings[leg]
            elif pushed_back:
                after = before
            self._shifts[leg] = before, after
        return before + (after - before) * smooth(fraction) if swings else after

    def _servos(self, leg: int, x: float, z: float, warnings: list[str]) -> tuple[float, float]:
        """Hip and knee servo [rad] for a foot F at (x, z) [m], moved along its direction where it is out of reach."""
        length = math.hypot(x, z)
        held = min(max(length, self._reach[0]), self._reach[1])
        if held != length:
            warnings.append(f"{LEGS[leg]}: foot target out of reach, clamped")
            x, z = x * held / length, z * held / length
        pose = self._kinematics.inverse(x, z)
        cable = self._kinematics.cable_of_knee(pose.knee)
        knee = (cable - self._kinematics.cable_max) / self._robot.leg.pulley_radius
        result = []
        for joint, value in (("hip", pose.hip), ("knee", knee)):
            servo = self._robot.servos[f"{LEGS[leg]}_{joint}"]
            clipped = min(max(value, servo.lower), servo.upper)
            if clipped != value:
                warnings.append(f"{LEGS[leg]}_{joint}: {value:.3f} rad is beyond the servo, clamped")
            result.append(clipped)
        return result[0], result[1]

    def _output(self, stamp: int, servos: tuple[float, ...], warnings: list[str]) -> MotionOutput:
        legs = self._legs
        zeros = (0.0, 0.0, 0.0, 0.0)
        states = LegStates(
            stamp=stamp,
            phases=legs.now.phases,
            phase_fractions=legs.now.fractions,
            velocities=zeros,
            requested=legs.requested,
            next_phases=legs.next.phases,
            start_time=stamp,
            durations=zeros,
            remaining_fractions=zeros,
            start_x=zeros,
            start_z=zeros,
            gait_frequency=legs.frequency,
            duty_factor=legs.duty_factor,
        )
        return MotionOutput(servos, states, tuple(warnings))
