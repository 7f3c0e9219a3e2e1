"""Kinematics of the spine (N 5.2.1): where the hip goes as the spine bends.

The spine is the modified Denavit-Hartenberg chain of N table 5.3 from the front torso {M} to the hip {10}. Its
parameters are in N's frame (forward -y, left +x); everything here takes and gives REP-103: x forward, y left, z up, {M}
at `base_link`, {10} likewise with its axes turned. N misprint: row 3, column 3 of (5.23) is +cos(alpha).

Signs: `flexion` is N's theta_v with the other sign. Positive flexion [rad per lateral joint] bends the body around its
left side, so that the mouse turns left; positive theta_v of the DH chain turns right. `vertical` [rad per lumbar joint]
is added to the rest angles, again against the DH sign: positive arches the back and lowers the hip.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nermo_description.parameters import SpineParameters

Array = NDArray[np.float64]

LARGEST_ANGLE = 0.25 * math.pi
"""[rad] Joint angles are held within this, far beyond what the vertebrae allow."""

_FROM_THESIS = np.array([[0.0, -1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
"""Turns N's axes into those of REP-103: (x, y, z) -> (-y, x, z)."""


class SpineKinematics:
    """The chain from base_link to the hip, with all lateral joints bent alike and all lumbar joints bent alike.

    Angles that are not finite count as 0, others are held within `LARGEST_ANGLE`; so no result is ever NaN.
    """

    def __init__(self, spine: SpineParameters) -> None:
        self._parameters = spine
        self._max_flexion = spine.max_flexion
        self._lateral = set(spine.lateral_joints)
        self._vertical = set(spine.vertical_joints)
        self._straight_links = self._links(0.0)
        self.rest = _read_only(self.transform(0.0))
        """Pose of the hip frame in base_link with a straight spine, (4, 4)."""
        self.lateral_joint_count = len(self._lateral)
        self.first_lateral_joint = _read_only(self._straight_links[0][:3, 3].copy())
        """Place of the first lateral joint in base_link, (3,) [m]."""

    def transform(self, flexion: ArrayLike, vertical: float = 0.0) -> Array:
        """Pose of the hip frame {10} in base_link (5.24): (..., 4, 4) for `flexion` (...) [rad per joint]."""
        vertical = float(_held(vertical))
        links = self._links(vertical) if vertical else self._straight_links
        # Positive flexion is negative theta_v; the joint turns about its own z.
        angle = -_held(flexion)
        turn = np.zeros((*angle.shape, 4, 4))
        turn[..., 0, 0] = turn[..., 1, 1] = np.cos(angle)
        turn[..., 1, 0] = np.sin(angle)
        turn[..., 0, 1] = -turn[..., 1, 0]
        turn[..., 2, 2] = turn[..., 3, 3] = 1.0
        result = links[0]
        for link in links[1:]:
            result = result @ turn @ link
        return np.asarray(result)

    def point(self, point: ArrayLike, flexion: ArrayLike, vertical: float = 0.0) -> Array:
        """A point of the hip frame (..., 3) [m] in base_link (5.25): broadcast with `flexion`, (..., 3)."""
        pose = self.transform(flexion, vertical)
        point = np.asarray(point, dtype=np.float64)
        return np.asarray((pose[..., :3, :3] @ point[..., None])[..., 0] + pose[..., :3, 3])

    def in_hip_frame(self, point: ArrayLike) -> Array:
        """A point (..., 3) [m] that is at rest at this place in base_link, in the hip frame."""
        shifted = np.asarray(point, dtype=np.float64) - self.rest[:3, 3]
        return np.asarray(shifted @ self.rest[:3, :3])

    def jacobian(self, point: ArrayLike, flexion: float, vertical: float = 0.0) -> Array:
        """Derivative of `point` by flexion and vertical, (3, 2) [m/rad], by the axes of the joints."""
        flexion, vertical = float(_held(flexion)), float(_held(vertical))
        target = self.point(point, flexion, vertical)
        columns = np.zeros((3, 2))
        pose = _FROM_THESIS
        for row in range(len(self._parameters.a)):
            pose = pose @ self._row(row, flexion, vertical)
            arm = np.cross(pose[:3, 2], target - pose[:3, 3])
            if row in self._lateral:
                columns[:, 0] -= arm
            elif row in self._vertical:
                columns[:, 1] -= arm
        return columns

    def inverse(self, deflection: float) -> tuple[float, bool]:
        """Flexion [rad per joint] that moves the hip frame's origin sideways to y = `deflection` [m], positive left.

        Second: whether it was clamped to the largest flexion; a deflection that is not finite gives 0 and True. N
        integrates the velocity; the deflection grows monotonically with the flexion, so the root is bracketed.
        """
        if math.isnan(deflection):
            return 0.0, True

        def error(flexion: float) -> float:
            return float(self.transform(flexion)[1, 3]) - deflection

        limit = self._max_flexion
        if error(limit) <= 0.0:
            return limit, error(limit) < -1e-12
        if error(-limit) >= 0.0:
            return -limit, error(-limit) > 1e-12
        from scipy.optimize import brentq  # only here: it would double the time in which a node starts

        return float(brentq(error, -limit, limit, xtol=1e-14)), False

    def _links(self, vertical: float) -> tuple[Array, ...]:
        """The constant transforms between the lateral joints, from base_link's axes to the hip's in REP-103."""
        links = []
        link = _FROM_THESIS
        for row in range(len(self._parameters.a)):
            link = link @ self._row(row, 0.0, vertical)
            if row in self._lateral:
                links.append(link)
                link = np.eye(4)
        return tuple(_read_only(part) for part in (*links, link @ _FROM_THESIS.T))

    def _row(self, row: int, flexion: float, vertical: float) -> Array:
        """(5.23) for one row of the table, in N's frame."""
        p = self._parameters
        theta = p.theta[row] - (flexion if row in self._lateral else vertical if row in self._vertical else 0.0)
        c, s, ca, sa = math.cos(theta), math.sin(theta), math.cos(p.alpha[row]), math.sin(p.alpha[row])
        return np.array(
            [
                [c, -s, 0.0, p.a[row]],
                [s * ca, c * ca, -sa, -p.d[row] * sa],
                [s * sa, c * sa, ca, p.d[row] * ca],
                [0.0, 0.0, 0.0, 1.0],
            ]
        )


def _held(angle: ArrayLike) -> Array:
    angle = np.asarray(angle, dtype=np.float64)
    return np.clip(np.where(np.isfinite(angle), angle, 0.0), -LARGEST_ANGLE, LARGEST_ANGLE)


def _read_only(array: Array) -> Array:
    array.setflags(write=False)
    return array
