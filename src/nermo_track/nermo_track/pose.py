"""Poses of things that wear tags, from the tags' corners; OpenCV solves, and here is what is left to choose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from nermo_track.camera import Camera
from nermo_track.layout import Tag, square
from nermo_track.sightings import whole

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Placement:
    """A frame seen from another: what maps a point of the inner frame to the outer one."""

    rotation: Rotation
    position: Array
    """(3,) [m]"""

    def __matmul__(self, inner: Placement) -> Placement:
        return Placement(self.rotation * inner.rotation, self.rotation.apply(inner.position) + self.position)

    @property
    def inverse(self) -> Placement:
        """The outer frame seen from the inner one."""
        back = self.rotation.inv()
        return Placement(back, -back.apply(self.position))

    def apply(self, points: Array) -> Array:
        """Points (n, 3) [m] of the inner frame in the outer one."""
        return np.asarray(self.rotation.apply(points) + self.position, dtype=np.float64)


@dataclass(frozen=True)
class Fit:
    """One way in which a thing may stand so that its tags look as they do."""

    placement: Placement
    """Of the thing in the camera's axes."""
    squares: float
    """[px²] Sum of squared reprojection errors."""


def fits(camera: Camera, tags: Sequence[Tag], corners: Array) -> list[Fit]:
    """Ways in which a thing with ``tags`` may stand, best first; empty where none of them is seen.

    A single tag leaves two that are nearly alike, mirrored about the line of sight: both are given. Each begins at
    OpenCV's closed solution for one square (IPPE) and is refined on all corners.

    Args:
        camera: Which one.
        tags: In the thing's frame.
        corners: (tags, 4, 2) [px], NaN where a tag is not seen.
    """
    seen = whole(corners)
    if not seen.any():
        return []
    points = corner_points(tags, seen)
    pixels = np.ascontiguousarray(corners[seen].reshape(-1, 2))
    matrix, coefficients = camera.matrix, camera.coefficients
    found: list[Fit] = []
    for tag, corner, there in zip(tags, corners, seen, strict=True):
        if not there:
            continue
        flag = cv2.SOLVEPNP_IPPE_SQUARE
        solved, turns, shifts, _ = cv2.solvePnPGeneric(square(tag.size), corner, matrix, coefficients, flags=flag)
        mounted = Placement(tag.rotation, np.array(tag.position)).inverse
        for turn, shift in zip(turns[:solved], shifts[:solved], strict=True):
            if not (np.isfinite(turn).all() and np.isfinite(shift).all()):
                continue
            found.append(_refined(camera, _placement(turn, shift) @ mounted, points, pixels))
    return sorted((fit for fit in found if np.isfinite(fit.squares)), key=lambda fit: fit.squares)


def _refined(camera: Camera, begin: Placement, points: Array, pixels: Array) -> Fit:
    turn, shift = cv2.solvePnPRefineLM(
        points,
        pixels,
        camera.matrix,
        camera.coefficients,
        begin.rotation.as_rotvec().reshape(3, 1),
        begin.position.reshape(3, 1),
    )
    placement = _placement(turn, shift)
    projected, _ = camera.project(placement.apply(points))
    return Fit(placement, float(np.sum((projected - pixels) ** 2)))


def _placement(turn: NDArray[Any], shift: NDArray[Any]) -> Placement:
    """What OpenCV says as a rotation vector and a shift [m]."""
    return Placement(Rotation.from_rotvec(turn.ravel()), np.asarray(shift.ravel(), dtype=np.float64))


def corner_points(tags: Sequence[Tag], seen: NDArray[np.bool_]) -> Array:
    """(n, 3) [m] Corners of those tags that are seen, in the frame of what wears them."""
    return np.concatenate([tag.corners for tag, there in zip(tags, seen, strict=True) if there])


def covariance(camera: Camera, world: Placement, body: Placement, points: Array, deviation: Array) -> Array:
    """(6, 6) Covariance of a body's pose in the world [m, rad, fixed axes], as `nav_msgs/Odometry` has it.

    It is the inverse of the information that the corners hold, linear about the pose.

    Args:
        camera: Which one.
        world: The world in the camera's axes.
        body: The body in the world.
        points: (n, 3) [m] Corners in the body's frame.
        deviation: (n,) [px] Standard deviation of each corner's place, along either axis.
    """
    arms = body.rotation.apply(points)
    _, slope = camera.project(world.apply(arms + body.position))
    by_place = slope @ world.rotation.as_matrix()
    turned = -cross_matrices(arms)
    jacobian = np.concatenate([by_place, by_place @ turned], axis=2) / deviation[:, None, None]
    rows = jacobian.reshape(-1, 6)
    return np.asarray(np.linalg.pinv(rows.T @ rows), dtype=np.float64)


def cross_matrices(vectors: Array) -> Array:
    """(n, 3, 3) The matrices that make cross products with vectors (n, 3)."""
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(-1, 3, 3)
