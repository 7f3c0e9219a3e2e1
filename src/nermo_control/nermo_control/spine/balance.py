"""Spine balance compensation (N 5.2.2): bending moves the centre of mass over the feet that stand.

Everything is seen in base_link (REP-103); its xy plane stands for the ground. The front feet keep their place in it;
the rear feet go with the hip, since the legs cannot move sideways: they slide, the spine being far stronger than
friction. Bending to the left carries the stability diagonal to the left about twice as far as the centre of mass,
which so ends up further to the right of it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from nermo_control.spine.kinematics import Array, SpineKinematics
from nermo_control.spine.stride import DIAGONALS
from nermo_description.parameters import Vector3


class CentreOfMass:
    """The COM of front and rear torso, joined by a spine without mass (5.34).

    Masses in kg; `front_com` in base_link, `rear_com` in the hip frame {10} with REP-103 axes [m].
    """

    def __init__(
        self, spine: SpineKinematics, front_mass: float, front_com: Vector3, rear_mass: float, rear_com: Vector3
    ) -> None:
        self._spine = spine
        self._front_mass, self._rear_mass = front_mass, rear_mass
        self._front_com = np.asarray(front_com, dtype=np.float64)
        self._rear_com = np.asarray(rear_com, dtype=np.float64)

    def position(self, flexion: ArrayLike, vertical: float = 0.0) -> Array:
        """p_com in base_link for flexions (...) [rad per joint]: (..., 3) [m]."""
        rear = self._spine.point(self._rear_com, flexion, vertical)
        total = self._front_mass * self._front_com + self._rear_mass * rear
        return np.asarray(total / (self._front_mass + self._rear_mass))


def stability_distance(com: ArrayLike, front_foot: ArrayLike, rear_foot: ArrayLike) -> Array:
    """d_stab of (5.35) [m]: COM to stability diagonal on the ground, positive to the right of it, negative to the left.

    Points (..., 2 or more) in base_link. N misprint: (5.35) takes the absolute value, which loses the sign that the
    text and the three-foot rule need.
    """
    com, front, rear = (np.asarray(point, dtype=np.float64) for point in (com, front_foot, rear_foot))
    along, arm = front - rear, com - rear
    cross = along[..., 1] * arm[..., 0] - along[..., 0] * arm[..., 1]
    return np.asarray(cross / np.hypot(along[..., 0], along[..., 1]))


class BalanceCompensation:
    """Finds the flexion that satisfies N's stability conditions, within +-`max_flexion` [rad per joint].

    Feet are given as in the leg planes: four x and four z [m] from the hip axes, in the order of the legs. Each
    condition answers (flexion, whether it is met); where it cannot be met, the flexion comes as near as it can.
    """

    _POINTS = 81

    def __init__(
        self, spine: SpineKinematics, com: CentreOfMass, hip_positions: Sequence[Vector3], max_flexion: float
    ) -> None:
        self._spine = spine
        self._axes = np.asarray(hip_positions, dtype=np.float64)
        self._flexions = np.linspace(-max_flexion, max_flexion, self._POINTS)
        self._poses = spine.transform(self._flexions)
        self._com = com.position(self._flexions)

    def distance(self, diagonal: int, foot_x: Sequence[float], foot_z: Sequence[float]) -> Array:
        """d_stab [m] over the flexions from the right to the left end of the range, for an index of DIAGONALS."""
        front_leg, rear_leg = DIAGONALS[diagonal]
        front = self._axes[front_leg] + (foot_x[front_leg], 0.0, foot_z[front_leg])
        rear = self._spine.in_hip_frame(self._axes[rear_leg] + (foot_x[rear_leg], 0.0, foot_z[rear_leg]))
        moved = self._poses[:, :3, :3] @ rear + self._poses[:, :3, 3]
        return stability_distance(self._com, front, moved)

    def dynamic(self, diagonal: int, foot_x: Sequence[float], foot_z: Sequence[float]) -> tuple[float, bool]:
        """Dynamic stability in two- and three-foot contact: the COM above the diagonal, d_stab = 0."""
        distance = self.distance(diagonal, foot_x, foot_z)
        crossing = self._nearest_crossing(distance)
        if crossing is not None:
            return crossing, True
        return float(self._flexions[np.argmin(np.abs(distance))]), False

    def static(
        self, lifted: int, foot_x: Sequence[float], foot_z: Sequence[float], lift_distance: float | None = None
    ) -> tuple[float, bool]:
        """Static stability on the three feet that stay when leg `lifted` rises: the COM inside their triangle.

        The triangle lies beside the diagonal that the lifted leg is no part of: to its right for a left leg, to its
        left for a right one. With `lift_distance` (|d_lift| [m]) the smallest flexion that brings the COM at least so
        far inside; without, the one that brings it in furthest.
        """
        diagonal = 1 if lifted in DIAGONALS[0] else 0
        sign = 1.0 if lifted in (0, 2) else -1.0
        inside = sign * self.distance(diagonal, foot_x, foot_z)
        if lift_distance is not None:
            if inside[self._POINTS // 2] >= lift_distance:
                return 0.0, True
            crossing = self._nearest_crossing(inside - lift_distance)
            if crossing is not None:
                return crossing, True
        best = int(np.argmax(inside))
        return float(self._flexions[best]), bool(inside[best] >= (lift_distance or 0.0))

    def _nearest_crossing(self, values: Array) -> float | None:
        """The flexion nearest to straight at which `values` over the range change sign; None if they do not."""
        before, after = values[:-1], values[1:]
        (steps,) = np.nonzero((before * after <= 0.0) & (before != after))
        if not steps.size:
            return None
        shares = before[steps] / (before[steps] - after[steps])
        crossings = self._flexions[steps] + shares * (self._flexions[steps + 1] - self._flexions[steps])
        return float(crossings[np.argmin(np.abs(crossings))])
