"""Where a camera stands, by the tags on the floor."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from nermo_track.camera import Camera
from nermo_track.errors import TrackError
from nermo_track.layout import Layout
from nermo_track.pose import Placement, corner_points, covariance, cross_matrices, fits
from nermo_track.sightings import Sightings, whole

Array = NDArray[np.float64]

LEAST_DEVIATION = 0.03
"""[px] No corner's place is believed better than this, whatever its residuals say: what `nermo_track.edges` leaves."""
MOST_ERROR = 3.0
"""[px] Root mean square of the floor's corners from where they should be, from which on it is another camera."""


@dataclass(frozen=True)
class Floor:
    """The world as a camera that stands still sees it."""

    world: Placement
    """In the camera's axes."""
    covariance: Array
    """(6, 6) [m, rad, axes of the world] Of the world's pose."""
    motion: float
    """[px] Root mean square by which its tags move in the picture."""

    @property
    def height(self) -> float:
        """[m] Of the camera over the floor."""
        return float(self.world.inverse.position[2])

    def carried(self, position: Array) -> Array:
        """(n, 6, 6) What its covariance makes of poses at ``position`` (n, 3) [m]: they move and turn with it.

        It is the same error in all pictures.
        """
        slope = np.tile(np.eye(6), (len(position), 1, 1))
        slope[:, :3, 3:] = -cross_matrices(position)
        return np.asarray(slope @ self.covariance @ slope.transpose(0, 2, 1), dtype=np.float64)


def find_floor(sightings: Sightings, camera: Camera, layout: Layout, name: str) -> Floor:
    """Where the floor is, by the median of each corner through a film.

    Raises:
        TrackError: none of its tags is seen, or they are not where this camera would see them.
    """
    tags = layout.floor
    corners = sightings.of(tuple(tag.id for tag in tags))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # a tag that is never seen has no median, and stays NaN
        still = np.nanmedian(corners, axis=0)
    above = [fit for fit in fits(camera, tags, still) if fit.placement.inverse.position[2] > 0.0]
    if not above:
        numbers = ", ".join(str(tag.id) for tag in tags)
        raise TrackError(f"{name}: none of the floor's tags ({numbers}) is seen; they say where the world is")
    best = above[0]
    points = corner_points(tags, whole(still))
    error = float(np.sqrt(best.squares / len(points)))
    if error > MOST_ERROR:
        raise TrackError(
            f"{name}: the floor's tags are {error:.1f} px from where the camera would see them (allowed: "
            f"{MOST_ERROR:g} px); is it this camera's file, was the sheet printed at 100 %, and does it lie flat?"
        )
    deviation = max(float(np.sqrt(best.squares / max(2 * len(points) - 6, 1))), LEAST_DEVIATION)
    origin = Placement(Rotation.identity(), np.zeros(3))
    spread = covariance(camera, best.placement, origin, points, np.full(len(points), deviation))
    motion = float(np.sqrt(np.nanmean(np.sum((corners - still) ** 2, axis=-1))))
    return Floor(best.placement, spread, motion)
