"""The mouse's pose through one film, and where its marked feet are."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from nermo_track.camera import Camera
from nermo_track.errors import TrackError
from nermo_track.faults import LEAST_POSES, Missing, longest_gap, outliers
from nermo_track.floor import LEAST_DEVIATION, Floor, find_floor
from nermo_track.layout import Layout, Tag
from nermo_track.pose import Fit, Placement, corner_points, covariance, fits
from nermo_track.sightings import Sightings, whole

Array = NDArray[np.float64]

UPRIGHT = np.radians(15.0)
"""[rad] Standard deviation of the tilt of a mouse that walks, and of a foot's axis across the mouse from the mouse's
own: decides between the two poses that a small tag leaves, and nothing else. Chosen: in a trot the twin's torso rolls
by 7 degrees (standard deviation)."""
BLUR_SHARE = 0.03
"""Share of a corner's smear during the exposure by which its place is less certain than the film's other corners.
Chosen: a smear is the same to both sides and moves no edge, but flattens it."""
BAD_FIT = 1e-5
"""Chance of a reprojection error so large, from which on it is no good tag. Chosen: one picture of an hour."""
SHAKEN = 1.0
"""[px] Root mean square by which the floor's tags move in the picture, from which on the camera is said to move."""


Doubt = Callable[[int, Placement], float]
"""A picture's number and a pose in the world -> how many standard deviations, squared, it is from what may be."""


@dataclass(frozen=True)
class Followed:
    """Poses in the world of something that wears tags, of the pictures that have one."""

    picture: NDArray[np.int64]
    """(n,) Which pictures."""
    time: Array
    """(n,) [s] Middle of the exposure of its tags, in the film's own time."""
    position: Array
    """(n, 3) [m]"""
    rotation: Rotation
    """n of them"""
    covariance: Array
    """(n, 6, 6) [m, rad, fixed axes]"""
    corner_deviation: float
    """[px] Standard deviation of a corner's place, as the residuals tell."""
    blur: float
    """[px] Smear of its tags during an exposure, median."""
    missing: Missing


@dataclass(frozen=True)
class Track(Followed):
    """The same of base_link, and what else the film tells."""

    markers: Mapping[str, Followed]
    """By place, those that were seen often enough."""
    camera_height: float
    """[m] of the camera over the floor."""
    floor_motion: float
    """[px] Root mean square by which the floor's tags move in the picture."""

    def warnings(self) -> list[str]:
        """What somebody should look at."""
        found = []
        if self.floor_motion > SHAKEN:
            found.append(f"the floor moves by {self.floor_motion:.1f} px in the picture: the camera must stand still")
        if self.missing.share > 0.2:
            found.append(f"{100.0 * self.missing.share:.0f} % of the pictures have no pose")
        return found


def track(sightings: Sightings, camera: Camera, layout: Layout, name: str) -> Track:
    """Follow the mouse, and those of its markers that are seen.

    Args:
        sightings: Of the film.
        camera: That filmed it.
        layout: Where the tags sit.
        name: Of the film, for errors.

    Raises:
        TrackError: the floor's tags, or the mouse's, are never seen.
    """
    floor = find_floor(sightings, camera, layout, name)
    numbers = ", ".join(str(tag.id) for tag in layout.mouse)
    seen = int(whole(sightings.of(tuple(tag.id for tag in layout.mouse))).any(axis=1).sum())
    if seen < LEAST_POSES:
        raise TrackError(
            f"{name}: the mouse's tags ({numbers}) are in {seen} pictures only; "
            "are they whole, lit, and larger than 20 pixels in the picture?"
        )
    mouse = _followed(sightings, camera, floor, layout.mouse, _tilt)
    if mouse is None:
        raise TrackError(
            f"{name}: the mouse's tags fit a pose in fewer than {LEAST_POSES} pictures; is it this camera's film?"
        )
    beside = _askew(mouse)
    found = {place: _followed(sightings, camera, floor, tags, beside) for place, tags in layout.markers.items()}
    markers = {place: followed for place, followed in found.items() if followed is not None}
    return Track(**vars(mouse), markers=markers, camera_height=floor.height, floor_motion=floor.motion)


def _followed(sightings: Sightings, camera: Camera, floor: Floor, tags: Sequence[Tag], doubt: Doubt) -> Followed | None:
    """Poses of what wears ``tags``; None where they fit one in too few pictures."""
    raw = sightings.of(tuple(tag.id for tag in tags))
    seen = whole(raw)
    found = np.asarray(seen.any(axis=1), dtype=bool)
    if found.sum() < LEAST_POSES:
        return None
    corners, rows, speed = _at_one_time(sightings.time, raw, camera)
    blur = speed * camera.exposure
    every = [fits(camera, tags, picture) for picture in corners]
    deviation = _corner_deviation(every, seen)
    picked, placed = _likely(every, seen, floor.world, deviation, doubt)
    if len(placed) < LEAST_POSES:
        return None
    place = np.array([pose.position for pose in placed])
    turn = Rotation.concatenate([pose.rotation for pose in placed])
    spread = np.empty((len(placed), 6, 6))
    for row, (index, pose) in enumerate(zip(picked, placed, strict=True)):
        certain = np.hypot(deviation, BLUR_SHARE * blur[index][seen[index]].ravel())
        spread[row] = covariance(camera, floor.world, pose, corner_points(tags, seen[index]), certain)
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
    return Followed(
        kept,
        time[kept],
        place[~alone],
        turn[~alone],
        (spread + floor.carried(place))[~alone],
        deviation,
        float(np.median(blur[seen])),
        missing,
    )


def _tilt(picture: int, pose: Placement) -> float:
    """Of a mouse: it walks upright."""
    del picture
    return _off(pose.rotation.apply([0.0, 0.0, 1.0])[2])


def _askew(mouse: Followed) -> Doubt:
    """Of a foot or the rear torso: its axis to the left is that of the mouse, in pictures that show both."""
    left = dict(zip(mouse.picture.tolist(), mouse.rotation.apply([0.0, 1.0, 0.0]), strict=True))

    def doubt(picture: int, pose: Placement) -> float:
        return _off(float(pose.rotation.apply([0.0, 1.0, 0.0]) @ left[picture])) if picture in left else np.inf

    return doubt


def _off(cosine: float) -> float:
    """Standard deviations, squared, of an axis from where it should be."""
    return float((np.arccos(np.clip(cosine, -1.0, 1.0)) / UPRIGHT) ** 2)


def _likely(
    every: Sequence[Sequence[Fit]], seen: NDArray[np.bool_], world: Placement, deviation: float, doubt: Doubt
) -> tuple[NDArray[np.int64], list[Placement]]:
    """Pictures whose tags fit a pose that may be, and the likeliest in the world in each of them."""
    limits = deviation**2 * chi2.isf(BAD_FIT, np.maximum(8 * seen.sum(axis=1) - 6, 1))
    picked, placed = [], []
    for index, (found, limit) in enumerate(zip(every, limits, strict=True)):
        costs = [fit.squares / deviation**2 + doubt(index, world.inverse @ fit.placement) for fit in found]
        best = int(np.argmin(costs)) if costs else -1
        if costs and np.isfinite(costs[best]) and found[best].squares <= limit:
            picked.append(index)
            placed.append(world.inverse @ found[best].placement)
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
