"""A camera calibrated from a film of the board; OpenCV finds the board and fits, and here it is judged."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from nermo_track.camera import Camera
from nermo_track.errors import TrackError
from nermo_track.film import Film, Picture
from nermo_track.layout import DICTIONARY

Array = NDArray[np.float64]

COLUMNS, ROWS = 9, 6
SQUARE, INNER_TAG = 0.028, 0.020
"""[m] Edges of a square of the board, and of the tag in it: an A4 page full."""
FIRST_TAG = 100
"""Tags of the board; the mouse's and the floor's have lower numbers."""

CELLS = (6, 8)
"""Rows and columns of the grid by which the picture's coverage is counted."""
LEAST_COVERAGE = 0.6
"""Chosen: beyond what was seen, distortion is extrapolated."""
LEAST_VIEWS, MOST_VIEWS = 8, 40
"""OpenCV's guide asks for ten; beyond forty nothing changes but the time."""
LEAST_CORNERS = 12
NEW_VIEW = 0.04
"""Share of the picture's diagonal by which the board must have moved, in the mean, to be another view."""
STILL = 3.0
"""[px] Mean way of the board's corners from one picture to the next, up to which it is held still: else it is smeared,
and a rolling shutter bends it."""
LOOKED_AT = 300
"""Pictures of a film in which the board is looked for, with the one after each: finding it takes 0.2 s."""
MOST_ERROR = 1.0
"""[px] Root mean square of the reprojection. Chosen: a good lens has 0.1 to 0.3, a wrong model or a bent board more."""
MOST_FOCAL = 0.01
"""Largest standard deviation of the focal length, relative. Distances are off by as much."""


@dataclass(frozen=True)
class Calibration:
    """A camera and how well it is known."""

    camera: Camera
    rms: float
    """[px] Reprojection error, root mean square."""
    views: int
    coverage: float
    """Share of the picture's cells in which a corner of the board was seen."""
    focal_deviation: float
    """Relative standard deviation of the focal length."""
    worst_view: float
    """[px] The largest reprojection error of a view."""


def board() -> cv2.aruco.CharucoBoard:
    """The board: chequers whose white squares hold tags."""
    tags = np.arange(FIRST_TAG, FIRST_TAG + COLUMNS * ROWS // 2)
    return cv2.aruco.CharucoBoard((COLUMNS, ROWS), SQUARE, INNER_TAG, DICTIONARY, tags)


def calibrate(
    film: Film,
    line_delay: float = 0.0,
    exposure: float = 0.0,
    square: float = SQUARE,
    say: Callable[[float], None] = lambda share: None,
) -> Calibration:
    """The camera that took a film of the board.

    Args:
        film: In which the board is held everywhere and tilted, the camera's zoom and focus fixed.
        line_delay: [s] Of a rolling shutter, as the maker tells it; a film of a still board does not show it.
        exposure: [s] Likewise.
        square: [m] Edge of a square, measured on the print.
        say: Is told the share that is done.

    Raises:
        TrackError: the film does not tell the camera well enough; the sentence says what it lacks.
    """
    shown, places = _views(film, say)
    if len(shown) < LEAST_VIEWS:
        raise TrackError(
            f"{film.path}: the board is seen in {len(shown)} views that differ (needed: {LEAST_VIEWS}); "
            "hold it still now and then, near and far, in every corner of the picture, and tilt it"
        )
    coverage = _coverage(places, film.width, film.height)
    if coverage < LEAST_COVERAGE:
        raise TrackError(
            f"{film.path}: the board was seen in {100.0 * coverage:.0f} % of the picture "
            f"(needed: {100.0 * LEAST_COVERAGE:.0f} %); hold it into the corners and along the edges too"
        )
    size = (film.width, film.height)
    scaled = [points * np.float32(square / SQUARE) for points in shown]
    fitted = cv2.calibrateCameraExtended(scaled, places, size, np.eye(3), np.zeros(5))
    rms, matrix, distortion, spread, worst = fitted[0], fitted[1], fitted[2], fitted[5].ravel(), fitted[7]
    focal = float(max(spread[0] / matrix[0, 0], spread[1] / matrix[1, 1]))
    if not np.isfinite(rms) or rms > MOST_ERROR:
        raise TrackError(
            f"{film.path}: the board's corners are {rms:.2f} px from where the fitted camera would see them "
            f"(allowed: {MOST_ERROR:g} px); is the board flat, the film sharp, and zoom and focus fixed?"
        )
    if focal > MOST_FOCAL:
        raise TrackError(
            f"{film.path}: the focal length is known to {100.0 * focal:.1f} % only (allowed: "
            f"{100.0 * MOST_FOCAL:g} %); tilt the board by 30 degrees and more, to all sides"
        )
    k1, k2, p1, p2, k3 = map(float, distortion.ravel()[:5])
    camera = Camera(
        width=film.width,
        height=film.height,
        fx=float(matrix[0, 0]),
        fy=float(matrix[1, 1]),
        cx=float(matrix[0, 2]),
        cy=float(matrix[1, 2]),
        distortion=(k1, k2, p1, p2, k3),
        line_delay=line_delay,
        exposure=exposure,
        rms=float(rms),
        views=len(shown),
        coverage=coverage,
    )
    return Calibration(camera, float(rms), len(shown), coverage, focal, float(np.max(worst)))


def _views(film: Film, say: Callable[[float], None]) -> tuple[list[NDArray[np.float32]], list[NDArray[np.float32]]]:
    """Corners of the board (n, 3) [m] and in the picture (n, 2) [px], of views that differ from each other."""
    pattern = board()
    detector = cv2.aruco.CharucoDetector(pattern)
    everywhere = np.asarray(pattern.getChessboardCorners(), dtype=np.float32)
    least = NEW_VIEW * float(np.hypot(film.width, film.height))
    every = max(film.count // LOOKED_AT, 2)
    taken: list[Array] = []
    shown, places = [], []
    before = np.full((len(everywhere), 2), np.nan)
    for number, (_, picture) in enumerate(film.pictures()):
        if number % every > 1:
            continue
        say(min(number / max(film.count, 1), 1.0))
        found, last = _corners(detector, picture, len(everywhere)), before
        before = found
        seen = np.isfinite(found[:, 0])
        if number % every == 0 or seen.sum() < LEAST_CORNERS or _moved(found, last) > STILL:
            continue
        if any(_moved(found, other) < least for other in taken):
            continue
        taken.append(found)
        shown.append(everywhere[seen])
        places.append(found[seen].astype(np.float32))
        if len(taken) == MOST_VIEWS:
            break
    return shown, places


def _corners(detector: cv2.aruco.CharucoDetector, picture: Picture, count: int) -> Array:
    """(count, 2) [px] The board's inner corners in a picture, NaN where they are not seen."""
    found = np.full((count, 2), np.nan)
    corners, numbers, _, _ = detector.detectBoard(picture)
    if numbers is not None and len(numbers):
        found[numbers.ravel()] = corners.reshape(-1, 2)
    return found


def _moved(one: Array, other: Array) -> float:
    """[px] Mean way of the corners that two views share; as far as can be where they share none."""
    way = np.linalg.norm(one - other, axis=1)
    return float(np.nanmean(way)) if np.isfinite(way).any() else float("inf")


def _coverage(places: list[NDArray[np.float32]], width: int, height: int) -> float:
    every = np.concatenate(places)
    counts, _, _ = np.histogram2d(every[:, 1], every[:, 0], bins=CELLS, range=((0, height), (0, width)))
    return float(np.mean(counts > 0))
