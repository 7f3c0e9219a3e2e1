"""Turning (N 5.3): stride modulation of the legs, and the radii that N predicts for its three strategies.

alpha_tr is the normalised turn rate in [-1, 1], positive left. The leg strategy shortens the strides of the inner legs,
the spine strategy bends the spine, mix does both. Radii are positive [m], infinite for a straight line, and hold for a
point on the shoulder axis. `flexion` is per lateral joint, positive left.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from nermo_control.clamp import within_one
from nermo_control.spine.kinematics import Array, SpineKinematics
from nermo_control.types import TurningStrategy
from nermo_description.parameters import Vector3


def response(turn_rate_normalized: float, exponent: float) -> float:
    """sign(alpha_tr) |alpha_tr|^t: how hard the legs turn, in [-1, 1]. t = 0 switches the legs' part off.

    N misprint: (5.38)-(5.39) raise a negative alpha_tr to the power t. NaN counts as no turn.
    """
    alpha = within_one(turn_rate_normalized)
    return math.copysign(abs(alpha) ** exponent, alpha) if exponent > 0.0 else 0.0


def leg_modulation(turn_rate_normalized: float, exponent: float = 1.0) -> tuple[float, float]:
    """alpha_left and alpha_right in [0, 1], factors of the strides of the left and right legs: (5.36)-(5.39)."""
    turn = response(turn_rate_normalized, exponent)
    return min(1.0 - turn, 1.0), min(1.0 + turn, 1.0)


def leg_radius(stride: float, modulation_difference: float, diagonal: float) -> float:
    """r_turn,lb of (5.40)-(5.41) [m]: stride l_s, Delta m = |alpha_left - alpha_right|, distance d_diag between the
    feet of a diagonal pair.
    """
    half_rotation = 0.5 * stride * abs(modulation_difference) / diagonal
    return stride / (2.0 * math.sin(half_rotation)) if half_rotation else math.inf


def spine_radius(turn_angle: float, rigid_length: float, bent_length: float) -> tuple[float, float]:
    """r_turn,f and r_turn,r of (5.43)-(5.44) [m], at the shoulder and at the hip axis.

    theta_turn is the yaw between the two axes, l_sp1 the length from the shoulder axis to the first lateral joint,
    l_sp2 from there to the hip axis.
    """
    angle = abs(turn_angle)
    if angle == 0.0:
        return math.inf, math.inf
    return (
        bent_length / angle + rigid_length / math.tan(angle),
        bent_length / angle + rigid_length / math.sin(angle),
    )


class TurningModel:
    """Predicted path of the three strategies, and the turn rate as a function of alpha_tr and back.

    The curvature that a strategy promises does not depend on the speed, so that turn rate = speed along the path x
    curvature; that speed is the forward velocity times the mean of the legs' modulation (a mouse whose left legs stand
    makes half its way). Walking backwards the same alpha_tr turns the other way.

    - leg: rotation per stride over stride (5.41), with d_diag between the feet of a diagonal pair in the neutral stance
      (0.1499 m: N's 0.151 m at full lock).
    - spine: (5.43) with theta_turn = 4 theta_v, theta_v = alpha_tr max_flexion. (Exactly, 0.1 rad a joint yaws the hip
      by 21.9 deg, not 22.9.)
    - mix: as leg, with the diagonal that spine flexion shortens (5.32), or as spine where that turns more tightly:
      at low turn rates the legs hardly take part. N's 0.134 m would need a diagonal of 0.1329 m; (5.32) at 0.1 rad is
      0.1362 m and gives 0.137 m. (Foot to foot it would be 0.1423 m and 0.143 m.)

    `hip_positions` are the hip and shoulder axes in base_link, in the order of the legs; `neutral_foot_x` the neutral
    foot's x [m] from the axis, front and rear.
    """

    _GRID = np.linspace(0.0, 1.0, 201)

    def __init__(
        self,
        spine: SpineKinematics,
        max_flexion: float,
        hip_positions: Sequence[Vector3],
        neutral_foot_x: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        front_left, front_right, rear_left, rear_right = np.asarray(hip_positions, dtype=np.float64)
        across = front_left - rear_right + [neutral_foot_x[0] - neutral_foot_x[1], 0.0, 0.0]
        self.foot_diagonal = math.hypot(across[0], across[1])
        """Foot to diagonally opposite foot, on the ground [m]."""
        flexions = self._GRID * max_flexion
        moved = spine.point(spine.in_hip_frame(rear_left), flexions)
        self._hip_diagonals: Array = np.linalg.norm(moved - front_right, axis=-1)
        first_joint = spine.first_lateral_joint[0]
        self.rigid_length = float(front_left[0] - first_joint)
        """l_sp1: shoulder axis to first lateral joint [m]."""
        self.bent_length = float(first_joint - rear_left[0])
        """l_sp2: first lateral joint to hip axis [m]."""
        self._joints = spine.lateral_joint_count
        self._max_flexion = max_flexion
        self._known: dict[tuple[str, float], Array] = {}

    def hip_diagonal(self, turn_rate_normalized: float) -> float:
        """d_ext (5.32) [m] of the diagonal that bending for this alpha_tr shortens."""
        return float(np.interp(abs(within_one(turn_rate_normalized)), self._GRID, self._hip_diagonals))

    def radius(
        self, turn_rate_normalized: float, strategy: TurningStrategy, stride: float, exponent: float = 1.0
    ) -> float:
        """Radius [m] of the path of the shoulder axis: (5.40), (5.43), and both for mix. `stride` is l_s [m]."""
        alpha = abs(within_one(turn_rate_normalized))
        legs = abs(response(alpha, exponent))
        bent, _ = spine_radius(self._joints * alpha * self._max_flexion, self.rigid_length, self.bent_length)
        if strategy == "leg":
            return leg_radius(stride, legs, self.foot_diagonal)
        if strategy == "spine":
            return bent
        return min(bent, leg_radius(stride, legs, self.hip_diagonal(alpha)))

    def turn_rate(
        self,
        turn_rate_normalized: float,
        forward_velocity: float,
        strategy: TurningStrategy = "leg",
        exponent: float = 1.0,
    ) -> float:
        """Turn rate [rad/s], positive left, at a forward velocity [m/s] of the unmodulated gait."""
        alpha = within_one(turn_rate_normalized)
        rate = float(np.interp(abs(alpha), self._GRID, self._rates(strategy, exponent)))
        return math.copysign(rate, alpha) * forward_velocity

    def turn_rate_to_normalized(
        self, turn_rate: float, forward_velocity: float, strategy: TurningStrategy = "leg", exponent: float = 1.0
    ) -> tuple[float, bool]:
        """alpha_tr for a turn rate [rad/s] at a forward velocity [m/s], and whether it had to be clamped to [-1, 1].

        Without forward velocity there is no turning: full lock and True for any turn rate but 0. Not finite: 0, True.
        """
        if not (math.isfinite(turn_rate) and math.isfinite(forward_velocity)):
            return 0.0, True
        if turn_rate == 0.0:
            return 0.0, False
        rates = self._rates(strategy, exponent)
        sign = math.copysign(1.0, turn_rate) * math.copysign(1.0, forward_velocity)
        wanted, largest = abs(turn_rate), float(rates[-1]) * abs(forward_velocity)
        if wanted > largest:
            return sign, wanted > largest * (1.0 + 1e-9)
        return sign * float(np.interp(wanted / abs(forward_velocity), rates, self._GRID)), False

    def curvature_to_normalized(
        self, curvature: float, strategy: TurningStrategy = "leg", exponent: float = 1.0
    ) -> tuple[float, bool]:
        """alpha_tr for a path's curvature [1/m], positive left, walking forward; and whether it had to be clamped."""
        if not math.isfinite(curvature):
            return 0.0, True
        curvatures = self._curvatures(strategy, exponent)
        largest = float(curvatures[-1])
        if abs(curvature) > largest:
            return math.copysign(1.0, curvature), True
        return math.copysign(float(np.interp(abs(curvature), curvatures, self._GRID)), curvature), False

    def _rates(self, strategy: TurningStrategy, exponent: float) -> Array:
        """Turn rate at 1 m/s of forward velocity [rad/m] over the grid of |alpha_tr|, never falling."""
        if strategy == "spine":
            return self._curvatures(strategy, exponent)
        slowed = 1.0 - 0.5 * self._legs(exponent)
        return np.asarray(np.maximum.accumulate(slowed * self._curvatures(strategy, exponent)))

    def _curvatures(self, strategy: TurningStrategy, exponent: float) -> Array:
        """Curvature [1/m] over the grid of |alpha_tr|, never falling; worked out once for each strategy."""
        if (strategy, exponent) not in self._known:
            angle = self._joints * self._max_flexion * self._GRID[1:]
            with np.errstate(divide="ignore", invalid="ignore"):
                bent = np.nan_to_num(1.0 / (self.bent_length / angle + self.rigid_length / np.tan(angle)))
            bent = np.concatenate([[0.0], bent])
            legs = self._legs(exponent)
            curvatures = {
                "leg": legs / self.foot_diagonal,
                "spine": bent,
                "mix": np.maximum.accumulate(np.maximum(bent, legs / self._hip_diagonals)),
            }
            self._known[strategy, exponent] = curvatures[strategy]
        return self._known[strategy, exponent]

    def _legs(self, exponent: float) -> Array:
        return np.asarray(self._GRID**exponent if exponent > 0.0 else np.zeros_like(self._GRID))
