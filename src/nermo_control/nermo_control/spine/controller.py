"""The spine controller (N 5.4.1): turning, stride extension and balance fused into one flexion, and its offsets.

alpha_tr, leg phases, feet -> primary and secondary modes -> scaled fusion -> flexion -> servo position and z_off.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from nermo_control.clamp import within_one
from nermo_control.follower import POSE_RESPONSE_TIME, TUNING_RESPONSE_TIME, Follower
from nermo_control.gait.knowledge_base import GaitParameters
from nermo_control.gait.phase import Flags, LegPhases
from nermo_control.spine.balance import BalanceCompensation, CentreOfMass
from nermo_control.spine.kinematics import SpineKinematics
from nermo_control.spine.offset import OffsetCompensation
from nermo_control.spine.stride import DIAGONALS, StrideExtension, lumbar_share
from nermo_control.spine.tendon import LumbarTendon, SpineTendon
from nermo_control.types import Four, MotionCommand, Phase
from nermo_description.parameters import RobotParameters

FASTEST = 20.0
"""Largest rate of the flexion [robot's largest flexion / s]; stride extension at 3 Hz, duty factor 0.5 needs 18.8."""
BOTH_SECONDARY = "stride_extension and balance_compensation contradict each other while walking: the stride is extended"
NOT_LIFTED: Flags = (False, False, False, False)


@dataclass(frozen=True, slots=True)
class SpineTarget:
    """What the spine does in one tick."""

    flexion: float
    """[rad per lateral joint], positive bends to the left."""
    servo_position: float
    """q_sp, position of the servo spine_lateral [rad], within its range."""
    foot_offsets: Four
    """z_off, to be added to the foot heights in the leg planes [m], in the order of the legs; 0 for the front legs."""
    warnings: tuple[str, ...] = ()
    """What could not be done, in words."""
    vertical: float = 0.0
    """[rad per lumbar joint], positive arches the back."""
    vertical_servo_position: float | None = None
    """Position of the servo spine_vertical [rad]; None where there is none."""


def fuse(turn: float, secondary: float, exponent: float) -> float:
    """Share of the largest flexion in [-1, 1] (5.45)-(5.46): turn + (1 - |turn|)^s secondary, both in [-1, 1].

    The secondary modes get what turning leaves over. N misprint: (5.46) has 1 - alpha_tr, which for alpha_tr = -1 gives
    the secondary modes double weight and leaves the range. s = 0 lets them act in full, so the sum is held to the
    range.
    """
    share = turn + (1.0 - abs(turn)) ** exponent * secondary
    return max(-1.0, min(share, 1.0))


class SpineController:
    """Computes flexion, servo position and foot offsets, one control tick of `period_ns` at a time.

    - Primary mode, on for the turning strategies spine and mix and for `modes.turning`: flexion follows alpha_tr.
    - Secondary modes: `modes.stride_extension` while the legs walk, or step on the spot, which it turns into a slow
      walk; `modes.balance_compensation` with a foot off the ground, told by `lifted` while standing and by the swing
      phases while walking. Both while walking: stride extension.
    - `modes.offset_compensation`: z_off for the rear legs, whatever bends the spine.
    - Vertical flexion, where there is a lumbar servo: a commanded arch of the back, and with `modes.stride_extension`
      in gaits whose rear legs move together (a bound) an arch that brings them forward and then lets them push.

    Flexion is smooth, because a step costs speed and triples the roll: the turn rate, the balance target and every mode
    that is switched go through critically damped followers, the stride wave is a cosine in step with the legs (a
    follower would make it late), and a jump of the phases is limited in rate.

    `lift_distance` [m] is d_lift: how far inside the triangle of the standing feet balance brings the COM; None: as far
    as it can.
    """

    def __init__(
        self,
        robot: RobotParameters,
        parameters: GaitParameters,
        period_ns: int,
        lift_distance: float | None = None,
    ) -> None:
        self._robot = robot
        self._spine = SpineKinematics(robot.spine)
        servo = robot.servos["spine_lateral"]
        self._tendon = SpineTendon(robot.spine, servo.neutral)
        self._reachable = max(
            0.0, min(robot.spine.max_flexion, self._tendon.flexion(servo.upper), -self._tendon.flexion(servo.lower))
        )
        self._lumbar: LumbarTendon | None = None
        self._highest_arch = 0.0
        if robot.spine_dynamics.vertical is not None and robot.spine_dynamics.lumbar_tendon_offset is not None:
            vertical = robot.servos["spine_vertical"]
            self._lumbar = LumbarTendon(robot.spine, robot.spine_dynamics.lumbar_tendon_offset, vertical.neutral)
            self._highest_arch = max(
                0.0, min(robot.spine_dynamics.vertical.upper, self._lumbar.flexion(vertical.upper))
            )
        self._com = CentreOfMass(
            self._spine, robot.front_mass, robot.masses.front_com, robot.masses.rear, robot.masses.rear_com
        )
        self._lift_distance = lift_distance
        self._offset = OffsetCompensation(self._spine, robot.hip_positions)
        self._period = period_ns * 1e-9
        self._max_flexion = -1.0
        self.set_parameters(parameters)
        self.reset()

    def set_parameters(self, parameters: GaitParameters) -> None:
        """Takes `max_spine_flexion` and `fusion_exponent`, both of which are taken up without a jump."""
        self._fusion_exponent = parameters.fusion_exponent
        max_flexion = min(parameters.max_spine_flexion, self._reachable)
        if max_flexion == self._max_flexion:
            return
        self._max_flexion = max_flexion
        scale = max(max_flexion, 1e-3)  # shares of the largest flexion mean something even if that is 0
        self._per_flexion = 1.0 / scale
        self._stride = StrideExtension(self._spine, self._robot.hip_positions, scale)
        self._balance = BalanceCompensation(self._spine, self._com, self._robot.hip_positions, scale)

    def reset(self, servo_position: float | None = None, vertical_servo_position: float | None = None) -> None:
        """Forgets all modes and goes on from servo positions [rad]; None: from a straight spine."""
        arch = 0.0
        if self._lumbar is not None and vertical_servo_position is not None:
            arch = max(0.0, min(self._lumbar.flexion(vertical_servo_position), self._highest_arch))
        self._flexion = 0.0 if servo_position is None else self._tendon.flexion(servo_position)
        self._turn = Follower(self._period)
        self._stride_weight = Follower(self._period)
        self._balance_share = Follower(self._period)
        self._offset_weight = Follower(self._period)
        self._range = Follower(self._period, self._max_flexion, TUNING_RESPONSE_TIME)
        self._exponent = Follower(self._period, self._fusion_exponent, TUNING_RESPONSE_TIME)
        self._arch = Follower(self._period, arch, POSE_RESPONSE_TIME)
        self._vertical = arch
        self._wave = self._lumbar_wave = 0.0

    def step(
        self,
        command: MotionCommand,
        legs: LegPhases | None,
        foot_x: Sequence[float],
        foot_z: Sequence[float],
        lifted: Flags = NOT_LIFTED,
        arch: float = 0.0,
    ) -> SpineTarget:
        """One control tick.

        `command`: alpha_tr, strategy, spine modes and the sign of the forward velocity are used. `legs`: where the legs
        are in their phases, None while no gait cycle runs. `foot_x`, `foot_z`: the feet in their leg planes, without
        z_off [m]. `lifted`: feet off the ground, or about to leave it, while no cycle runs. `arch`: wanted flexion of
        the lumbar joints [rad per joint], where the robot has a servo for it.
        """
        modes = command.spine_modes
        warnings: list[str] = []
        walking = legs is not None
        bends = command.turning_strategy != "leg" or modes.turning
        turn = self._turn.step(within_one(command.turn_rate_normalized) if walking and bends else 0.0)

        extends = modes.stride_extension and walking
        if legs is not None and extends:
            self._wave = self._stride.flexion(legs) * self._per_flexion
            self._lumbar_wave = lumbar_share(legs)
        direction = -1.0 if command.forward_velocity < 0.0 else 1.0
        stride_weight = self._stride_weight.step(direction if extends else 0.0)
        stride = self._wave * stride_weight

        if extends and modes.balance_compensation:
            warnings.append(BOTH_SECONDARY)
        balance = 0.0
        if modes.balance_compensation and not extends:
            if legs is not None:
                lifted = tuple(phase is Phase.SWING for phase in legs.phases)  # type: ignore[assignment]
            balance = self._balanced(lifted, foot_x, foot_z, walking, warnings)
        secondary = max(-1.0, min(stride + self._balance_share.step(balance), 1.0))

        largest = self._range.step(self._max_flexion)
        wanted = largest * fuse(turn, secondary, max(0.0, self._exponent.step(self._fusion_exponent)))
        step = FASTEST * self._reachable * self._period
        self._flexion += max(-step, min(wanted - self._flexion, step))
        vertical = 0.0
        if self._lumbar is not None:
            arched = self._arch.step(arch) + largest * self._lumbar_wave * max(0.0, stride_weight)
            arched = max(0.0, min(arched, self._highest_arch))
            self._vertical += max(-step, min(arched - self._vertical, step))
            vertical = self._vertical

        offset_weight = self._offset_weight.step(1.0 if modes.offset_compensation else 0.0)
        left = right = 0.0
        if offset_weight:
            left, right = self._offset.offsets(self._flexion)
            if vertical:
                left += self._offset.arch_offset(vertical, foot_x[2], foot_z[2])
                right += self._offset.arch_offset(vertical, foot_x[3], foot_z[3])
        return SpineTarget(
            self._flexion,
            self._tendon.servo_position(self._flexion),
            (0.0, 0.0, offset_weight * left, offset_weight * right),
            tuple(warnings),
            vertical,
            None if self._lumbar is None else self._lumbar.servo_position(vertical),
        )

    def _balanced(
        self, lifted: Flags, foot_x: Sequence[float], foot_z: Sequence[float], walking: bool, warnings: list[str]
    ) -> float:
        """Share of the largest flexion that balances on the feet that stand; on four feet none is needed."""
        up = tuple(leg for leg, is_up in enumerate(lifted) if is_up)
        if not up:
            return 0.0
        if len(up) == 1:
            flexion, met = self._balance.static(up[0], foot_x, foot_z, self._lift_distance)
        elif up in DIAGONALS:
            flexion, met = self._balance.dynamic(1 - DIAGONALS.index(up), foot_x, foot_z)
        else:
            flexion, met = 0.0, False
        if not (met or walking):
            warnings.append("balance: the spine cannot bring the centre of mass over the feet that stand")
        return flexion * self._per_flexion
