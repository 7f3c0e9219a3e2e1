"""The outline of what moves before a floor that stands still, picture by picture."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from nermo_track.errors import TrackError
from nermo_track.film import Film, Picture
from nermo_track.plane import Plane

Array = NDArray[np.float64]
Mask = NDArray[np.uint8]

LOOKED_AT = 60
"""Pictures of a film that the floor's median is taken of. Chosen: the median's noise is a sixth of a picture's."""
SHAKEN = 1.0
"""[px] By which the floor moves between pictures (90 of 100 of them), from which on the camera does not stand still:
then each edge of the floor's pattern moves too."""
SURE_SHIFT = 0.15
"""Peak of the phase correlation, of 1, below which a floor has too little pattern to say how it moved."""
SIGMAS = 6.0
"""Of a pixel's noise, from which on it is another thing than the floor."""
LEAST_CONTRAST = 6.0
"""Of 255: what a compressed film makes of still things."""
LEAST_AREA = 5e-4
"""Share of the picture that the mouse must cover: 20 x 20 pixels of 1280 x 720."""
BESIDE = 0.3
"""Share of the largest thing's area, from which on another thing that moves counts as one."""
BODY_SHARE = 0.5
"""What is thinner than this share of the outline's thickest place is tail or leg, not body."""


class Sight(IntEnum):
    """What a picture shows of the mouse."""

    WHOLE = 0
    NOTHING = 1
    CUT = 2
    """By the picture's edge."""
    SEVERAL = 3
    """Something else moves as well."""


@dataclass(frozen=True)
class Outlines:
    """The body's outline through a film, in a plane over the floor; NaN where it is not whole."""

    time: Array
    """(n,) [s] Begin of each picture, since that of the first."""
    sight: NDArray[np.int64]
    """(n,) `Sight`."""
    middle: Array
    """(n, 2) [m]"""
    axis: Array
    """(n,) [rad] Of the long axis, from the plane's x; half a turn more is the same."""
    length: Array
    """(n,) [m] Of the body: four standard deviations of its area along the long axis."""
    area: Array
    """(n,) [m²] Of the body."""
    thin: Array
    """(n,) [m] How far the middle of all, thin parts as the tail included, is from the body's along the axis."""
    row: Array
    """(n,) [px] Of the middle, down."""


@dataclass(frozen=True)
class Background:
    """The floor without the mouse."""

    picture: Picture
    noise: float
    """Standard deviation of a pixel, of 255."""
    shift: float
    """[px] By which 90 of 100 pictures are shifted at most; 0 where the floor has too little pattern to tell."""


def background(film: Film, floor: Film | None = None, say: Callable[[float], None] = lambda share: None) -> Background:
    """The floor as the median of pictures from all over a film, or over one of the floor alone.

    Raises:
        TrackError: a film cannot be read, or the two differ in size.
    """
    taken = _taken(film, say)
    if floor is not None and (floor.width, floor.height) != (film.width, film.height):
        raise TrackError(
            f"{floor.path}: has {floor.width} x {floor.height} pixels, {film.path} has {film.width} x {film.height}; "
            "film both with the same settings, from the same place"
        )
    alone = taken if floor is None else _taken(floor, lambda share: None)
    still = np.asarray(np.median(np.stack(alone), axis=0), dtype=np.float32)
    window = cv2.createHanningWindow((film.width, film.height), cv2.CV_32F)
    shifts, noises = [], []
    for picture in taken[:: max(len(taken) // 20, 1)]:
        seen = picture.astype(np.float32)
        (across, down), sure = cv2.phaseCorrelate(still.copy(), seen.copy(), window)  # it windows in place
        if sure > SURE_SHIFT:
            shifts.append(float(np.hypot(across, down)))
        noises.append(float(np.median(np.abs(seen - still - np.median(seen - still)))))
    shift = float(np.quantile(shifts, 0.9)) if shifts else 0.0
    return Background(np.asarray(still, dtype=np.uint8), 1.4826 * float(np.median(noises)), shift)


def _taken(film: Film, say: Callable[[float], None]) -> list[Picture]:
    """Pictures from all over a film."""
    every, taken = max(film.count // LOOKED_AT, 1), []
    for number, (_, picture) in enumerate(film.pictures()):
        if number % every == 0:
            taken.append(picture)
            if len(taken) >= 2 * LOOKED_AT:  # a file may not tell how many there are
                taken, every = taken[::2], 2 * every
            say(min(number / max(film.count, 1), 1.0))
    return taken


def outlines(
    film: Film, floor: Background, plane: Plane, say: Callable[[float], None] = lambda share: None
) -> Outlines:
    """Follow what moves.

    Raises:
        TrackError: the film cannot be read.
    """
    still = cv2.GaussianBlur(floor.picture.astype(np.float32), (0, 0), 1.0)
    # The blur takes the noise of a pixel down to 0.28 of it; the floor's own median has some too.
    contrast = max(SIGMAS * 0.28 * floor.noise, LEAST_CONTRAST)
    times, rows = [], []
    for time, picture in film.pictures():
        off = cv2.GaussianBlur(picture.astype(np.float32), (0, 0), 1.0) - still
        off -= float(np.median(off))  # a lamp that flickers, a camera that adapts
        mask = (np.abs(off) > contrast).astype(np.uint8)
        times.append(time)
        rows.append(_outline(np.asarray(cv2.morphologyEx(mask, cv2.MORPH_CLOSE, _disc(2)), dtype=np.uint8), plane))
        if len(times) % 10 == 0:
            say(min(len(times) / max(film.count, 1), 1.0))
    if len(times) < 2:
        raise TrackError(f"{film.path}: has one picture only; a film has several")
    table = np.array(rows)
    sight, middle, axis, length, area, thin, row = np.split(table, [1, 3, 4, 5, 6, 7], axis=1)
    columns = (column[:, 0] for column in (axis, length, area, thin, row))
    return Outlines(np.array(times), sight[:, 0].astype(np.int64), middle, *columns)


def _disc(radius: int) -> Mask:
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1,) * 2), dtype=np.uint8)


def _outline(mask: Mask, plane: Plane) -> list[float]:
    """Sight, x, y, axis, length, area, thin and row of one picture, as `Outlines` has them."""
    missing = [float("nan")] * 7
    found, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    things = sorted(found, key=cv2.contourArea, reverse=True)
    if not things or cv2.contourArea(things[0]) < LEAST_AREA * mask.size:
        return [Sight.NOTHING, *missing]
    if len(things) > 1 and cv2.contourArea(things[1]) > BESIDE * cv2.contourArea(things[0]):
        return [Sight.SEVERAL, *missing]
    left, top, width, height = cv2.boundingRect(things[0])
    if left == 0 or top == 0 or left + width == mask.shape[1] or top + height == mask.shape[0]:
        return [Sight.CUT, *missing]
    filled = np.zeros((height + 2, width + 2), np.uint8)
    cv2.drawContours(filled, things, 0, (1,), cv2.FILLED, offset=(1 - left, 1 - top))
    thickest = float(cv2.distanceTransform(filled, cv2.DIST_L2, 5).max())
    opened = cv2.morphologyEx(filled, cv2.MORPH_OPEN, _disc(max(round(BODY_SHARE * thickest), 1)))
    parts, _ = cv2.findContours(opened, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    body = max(parts, key=cv2.contourArea, default=None)
    if body is None or len(body) < 5:
        return [Sight.NOTHING, *missing]
    corner = np.array([left - 1, top - 1])
    pixels = body[:, 0].astype(np.float64) + corner
    place, axis, length, area = _ellipse(plane.metres(pixels))
    whole, _, _, _ = _ellipse(plane.metres(things[0][:, 0].astype(np.float64)))
    thin = float((whole - place) @ [np.cos(axis), np.sin(axis)])
    return [Sight.WHOLE, *place, axis, length, area, thin, float(pixels[:, 1].mean())]


def _ellipse(points: Array) -> tuple[Array, float, float, float]:
    """Middle [m], direction of the long axis [rad], length [m] and area [m²] of a polygon's (n, 2) [m] area."""
    origin = points.mean(axis=0)
    moments: dict[str, Any] = cv2.moments((1e3 * (points - origin)).astype(np.float32)[:, None])  # mm: of order one
    area = max(moments["m00"], 1e-9)
    middle = origin + 1e-3 * np.array([moments["m10"], moments["m01"]]) / area
    across, along, both = moments["mu02"] / area, moments["mu20"] / area, moments["mu11"] / area
    axis = 0.5 * float(np.arctan2(2.0 * both, along - across))
    longest = 0.5 * (along + across) + float(np.hypot(0.5 * (along - across), both))
    return middle, axis, 4e-3 * float(np.sqrt(longest)), 1e-6 * area
