"""Spine offset compensation (N 5.2.2): the rear legs make up for the rise and roll of the bending hip."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from nermo_control.spine.kinematics import LARGEST_ANGLE, SpineKinematics
from nermo_description.parameters import Vector3


class OffsetCompensation:
    """z_off of (5.31): how far each hip axis has sunk below its place at rest.

    Added to the height of the foot in its leg plane it keeps the feet on the ground, to first order: a hip that sinks
    gets a shorter leg. `hip_positions` are the four axes in base_link [m], in the order of the legs.
    """

    def __init__(self, spine: SpineKinematics, hip_positions: Sequence[Vector3]) -> None:
        self._spine = spine
        rest = np.asarray(hip_positions[2:], dtype=np.float64)
        self._hips = spine.in_hip_frame(rest)
        self._rest_heights = rest[:, 2]
        self._rear_axis = np.array([rest[0, 0], 0.0, rest[0, 2], 1.0])
        self._from_rest = np.linalg.inv(spine.rest)
        # A control tick asks for two heights; interpolating between these is exact to 10 nm and ten times as fast.
        self._grid = np.linspace(-LARGEST_ANGLE, LARGEST_ANGLE, 2001)
        self._left, self._right = (rest[:, 2] - spine.point(self._hips, self._grid[:, None])[..., 2]).T.copy()

    def offsets(self, flexion: float, vertical: float = 0.0) -> tuple[float, float]:
        """z_off of the rear left and the rear right leg [m] for flexion and lumbar flexion [rad per joint]."""
        if vertical:
            left, right = self._rest_heights - self._spine.point(self._hips, flexion, vertical)[:, 2]
            return float(left), float(right)
        flexion = flexion if math.isfinite(flexion) else 0.0
        return float(np.interp(flexion, self._grid, self._left)), float(np.interp(flexion, self._grid, self._right))

    def arch_offset(self, vertical: float, x: float, z: float) -> float:
        """z_off [m] of a rear foot that is to stay at its height while the back arches by `vertical` [rad per joint].

        (x, z): the foot in its leg plane, which turns with the hip about the body's lateral axis; exact for a straight
        spine. Where the foot goes fore and aft is not made up for: an arching back brings the rear feet forward.
        """
        pose = self._spine.transform(0.0, vertical) @ self._from_rest
        hip = pose @ self._rear_axis
        # Positive about y is nose down. A leg plane turned by it has its x axis at (cos, -sin) and its z axis at
        # (sin, cos) in base_link.
        sine, cosine = float(pose[0, 2]), float(pose[2, 2])
        height = self._rest_heights[0] + z
        return float((height - hip[2] + x * sine) / cosine) - z
