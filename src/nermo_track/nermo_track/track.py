"""The mouse's pose through one film."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from nermo_track.camera import Camera
from nermo_track.errors import TrackError
from nermo_track.faults import LEAST_POSES, Missing, longest_gap, outliers
from nermo_track.floor import LEAST_DEVIATION, find_floor
from nermo_track.layout import Layout
from nermo_track.pose import Fit, Placement, corner_points, covariance, fits
from nermo_track.sightings import Sightings, whole

Array = NDArray[np.float64]

UPRIGHT = np.radians(15.0)
"""[rad] Standard deviation of the tilt of a mouse that walks: decides between the two poses that a small tag leaves,
and nothing else. Chosen: in a trot the twin's torso rolls by 7 degrees (standard deviation)."""
BLUR_SHARE = 0.03
"""Share of a corner's smear during the exposure by which its place is less certain than the film's other corners.
Chosen: a smear is the same to both sides and moves no edge, but flattens it."""
BAD_FIT = 1e-5
"""Chance of a reprojection error so large, from which on it is no good tag. Chosen: one picture of an hour."""
SHAKEN = 1.0
"""[px] Root mean square by which the floor's tags move in the picture, from which on the camera is said to move."""


@dataclass(frozen=True)
class Track:
    """Poses of base_link in the world, of the pictures that have one."""

    time: Array
    """(n,) [s] Middle of the exposure of the mouse's tags, in the film's own time."""
    position: Array
    """(n, 3) [m]"""
    rotation: Rotation
    """n of them"""
    covariance: Array
    """(n, 6, 6) [m, rad, fixed axes]"""
    corner_deviation: float
    """[px] Standard deviation of a corner's place, as the residuals tell."""
    blur: float
    """[px] Smear of the mouse's tags during an exposure, median."""
    camera_height: float
    """[m] of the camera over the floor."""
    floor_motion: float
    """[px] Root mean square by which the floor's tags move in the picture."""
    missing: Missing

    def warnings(self) -> list[str]:
        """What somebody should look at."""
        found = []
        if self.floor_motion > SHAKEN:
            found.append(f"the floor moves by {self.floor_motion:.1f} px in the picture: the camera must stand still")
        if self.missing.share > 0.2:
            found.append(f"{100.0 * self.missing.share:.0f} % of the pictures have no pose")
        return found


def track(sightings: Sightings, camera: Camera, layout: Layout, name: str) -> Track:
    """Follow the mouse.

    Args:
        sightings: Of the film.
        camera: That filmed it.
        layout: Where the tags sit.
        name: Of the film, for errors.

    Raises:
        TrackError: the floor's tags, or the mouse's, are never seen.
    """
    floor = find_floor(sightings, camera, layout, name)
    raw = sightings.of(tuple(tag.id for tag in layout.mouse))
    seen = whole(raw)
    found = np.asarray(seen.any(axis=1), dtype=bool)
    if found.sum() < LEAST_POSES:
        numbers = ", ".join(str(tag.id) for tag in layout.mouse)
        raise TrackError(
            f"{name}: the mouse's tags ({numbers}) are in {found.sum()} pictures only; "
            "are they whole, lit, and larger than 20 pixels in the picture?"
        )
    corners, rows, speed = _at_one_time(sightings.time, raw, camera)
    blur = speed * camera.exposure
    every = [fits(camera, layout.mouse, picture) for picture in corners]
    deviation = _corner_deviation(every, seen)
    picked, placed = _standing(every, seen, floor.world, deviation)
    if len(placed) < LEAST_POSES:
        raise TrackError(
            f"{name}: the mouse's tags fit a pose in {len(placed)} pictures only; is it this camera's film?"
        )
    place = np.array([pose.position for pose in placed])
    turn = Rotation.concatenate([pose.rotation for pose in placed])
    spread = np.empty((len(placed), 6, 6))
    for row, (index, pose) in enumerate(zip(picked, placed, strict=True)):
        certain = np.hypot(deviation, BLUR_SHARE * blur[index][seen[index]].ravel())
        spread[row] = covariance(camera, floor.world, pose, corner_points(layout.mouse, seen[index]), certain)
    alone = outliers(sightings.time[picked], place, turn, spread)
    kept = picked[~alone]
    missing = Missing(
        pictures=len(found),
        lost=int((~found).sum()),
        misfit=int(found.sum()) - len(picked),
        jump=int(alone.sum()),
        longest=longest_gap(sightings.time, kept),
    )
    time = sightings.time + camera.exposure / 2.0 + camera.line_delay * rows
    return Track(
        time[kept],
        place[~alone],
        turn[~alone],
        (spread + floor.carried(place))[~alone],
        deviation,
        float(np.median(blur[seen])),
        floor.height,
        floor.motion,
        missing,
    )


def _standing(
    every: Sequence[Sequence[Fit]], seen: NDArray[np.bool_], world: Placement, deviation: float
) -> tuple[NDArray[np.int64], list[Placement]]:
    """Pictures whose tags fit a pose of a mouse that walks, and base_link in the world in them."""
    limits = deviation**2 * chi2.isf(BAD_FIT, np.maximum(8 * seen.sum(axis=1) - 6, 1))
    picked, placed = [], []
    for index, (found, limit) in enumerate(zip(every, limits, strict=True)):
        best = _upright(found, world, deviation)
        if best is not None and best.squares <= limit:
            picked.append(index)
            placed.append(world.inverse @ best.placement)
    return np.array(picked, dtype=np.int64), placed


def _at_one_time(time: Array, corners: Array, camera: Camera) -> tuple[Array, Array, Array]:
    """Corners (n, tags, 4, 2) as if all were exposed with their mean row; that row (n,); speeds (n, tags, 4) [px/s].

    With a rolling shutter each row has a time of its own. Corners move by what their own track says.
    """
    speed = np.gradient(corners, time, axis=0)
    speed = np.where(np.isfinite(speed), speed, 0.0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # a picture without a tag has no row
        rows = np.nanmean(corners[..., 1], axis=(1, 2))
    late = camera.line_delay * (corners[..., 1] - rows[:, None, None])
    return corners - speed * late[..., None], rows, np.linalg.norm(speed, axis=-1)


def _corner_deviation(every: Sequence[Sequence[Fit]], seen: NDArray[np.bool_]) -> float:
    """[px] By the median of the residuals, so that bad pictures say nothing."""
    freedom = 8 * seen.sum(axis=1) - 6
    scaled = [fits[0].squares / chi2.ppf(0.5, free) for fits, free in zip(every, freedom, strict=True) if fits]
    return max(float(np.sqrt(np.median(scaled))), LEAST_DEVIATION)


def _upright(found: Sequence[Fit], world: Placement, deviation: float) -> Fit | None:
    """The likeliest of a mouse's poses, given that it walks upright."""

    def cost(fit: Fit) -> float:
        up = (world.inverse.rotation * fit.placement.rotation).apply([0.0, 0.0, 1.0])[2]
        return float(fit.squares / deviation**2 + (np.arccos(np.clip(up, -1.0, 1.0)) / UPRIGHT) ** 2)

    return min(found, key=cost, default=None)
