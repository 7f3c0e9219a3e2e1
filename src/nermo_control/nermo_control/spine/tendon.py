"""The spine's tendons: flexion against the positions of the servos `spine_lateral` (N (5.26)-(5.30)), `spine_vertical`.

Two tendons run beside the spine, one on each side, over one pulley. The one that is pulled sets the angle: its length
at each joint shrinks from l_v to l_st, and (5.26) gives the angle; the other one, let out as much, hangs a little
slack. N writes (5.26) with the sign of theta_v and so lets the slack tendon rule one side; here both sides are alike,
as the robot is. Solved for the servo, (5.26) reads, with |theta_v| the flexion,

    l_v - l_st = l_v - l_v cos(theta_v / 2) + 2 d1 sin(theta_v / 2),    q_sp - q_sp0 = 4 (l_v - l_st) / r_sp,

which is what the printed (5.30) should be (it has a factor sqrt(2), a sign, and r_s for r_sp wrong). Positive servo
positions bend the mouse to the left, like positive flexion.
"""

from __future__ import annotations

import cmath
import math

from nermo_description.parameters import SpineParameters


class SpineTendon:
    """Flexion [rad per lateral joint] to servo position [rad] and back. `neutral` is q_sp0, the straight spine's.

    Arguments that are not finite count as straight; others are held to what the vertebrae's geometry allows.
    """

    def __init__(self, spine: SpineParameters, neutral: float = 0.0) -> None:
        self._neutral = neutral
        self._half_length = 0.5 * spine.vertebra_length
        self._offset = spine.tendon_offset
        self._chord = math.hypot(self._half_length, self._offset)
        self._alpha = math.atan2(self._offset, self._half_length)
        self._per_length = len(spine.lateral_joints) / spine.pulley_radius
        self.max_flexion = math.pi - 2.0 * self._alpha
        """Flexion at which the tendon is pulled in altogether and the vertebrae touch."""

    def servo_position(self, flexion: float) -> float:
        """q_sp [rad] for a flexion."""
        half = 0.5 * min(abs(flexion), self.max_flexion) if math.isfinite(flexion) else 0.0
        pulled = 2.0 * (self._half_length * (1.0 - math.cos(half)) + self._offset * math.sin(half))
        return self._neutral + math.copysign(pulled * self._per_length, flexion)

    def flexion(self, servo_position: float) -> float:
        """theta_v of (5.26) [rad per joint] for a servo position."""
        turn = servo_position - self._neutral if math.isfinite(servo_position) else 0.0
        length = max(0.0, 2.0 * self._half_length - abs(turn) / self._per_length)
        return math.copysign(self.max_flexion - 2.0 * math.asin(0.5 * length / self._chord), turn)


class LumbarTendon:
    """The one tendon below the spine: vertical flexion [rad per lumbar joint] to the position of `spine_vertical`.

    At lumbar joint j its eyelets lie half a vertebra before and behind the joint and `offset` [m] below it, so that
    with the joint's angle phi_j = rest_j + vertical it is 2 (l_v/2 cos(phi_j / 2) - offset sin(phi_j / 2)) long there.
    The sum over the joints is one cosine of vertical / 2, which makes the inverse closed. It only pulls: what lets the
    back down is the joints' spring, as far as their form stop. `neutral` is the position that holds the straight spine.
    """

    def __init__(self, spine: SpineParameters, offset: float, neutral: float = 0.0) -> None:
        self._neutral, self._radius = neutral, spine.pulley_radius
        # As complex numbers: the length is the real part of `chord` times e^(i vertical / 2).
        chord = sum(
            2.0 * cmath.rect(1.0, -0.5 * spine.theta[row]) * complex(0.5 * spine.vertebra_length, offset)
            for row in spine.vertical_joints
        )
        self._size, self._angle = cmath.polar(chord)
        self._straight = self._size * math.cos(self._angle)
        self.max_flexion = 2.0 * (math.pi - self._angle)
        """Flexion at which no length would be left [rad per joint]; far beyond any form stop."""

    def servo_position(self, vertical: float) -> float:
        """[rad]; arguments that are not finite count as straight."""
        vertical = vertical if math.isfinite(vertical) else 0.0
        half = 0.5 * max(-2.0 * self._angle, min(vertical, self.max_flexion))
        return self._neutral + (self._straight - self._size * math.cos(self._angle + half)) / self._radius

    def flexion(self, servo_position: float) -> float:
        """The vertical flexion [rad per joint] of a taut tendon; the inverse of `servo_position`."""
        turn = servo_position - self._neutral if math.isfinite(servo_position) else 0.0
        cosine = (self._straight - turn * self._radius) / self._size
        return 2.0 * (math.acos(max(-1.0, min(cosine, 1.0))) - self._angle)
