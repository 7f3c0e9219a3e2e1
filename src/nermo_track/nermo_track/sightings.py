"""Tags found in the pictures of a film."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from nermo_track.edges import refined
from nermo_track.errors import TrackError
from nermo_track.film import Film, Picture
from nermo_track.layout import DICTIONARY, Layout

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Sightings:
    """Corners of tags through a film."""

    time: Array
    """(n,) [s] Begin of each picture, since that of the first."""
    ids: tuple[int, ...]
    corners: Array
    """(n, tags, 4, 2) [px] In the order of `ids`; NaN where a tag was not found."""

    def of(self, numbers: tuple[int, ...]) -> Array:
        """(n, len(numbers), 4, 2) [px] Corners of these tags."""
        return self.corners[:, [self.ids.index(number) for number in numbers]]


def whole(corners: Array) -> NDArray[np.bool_]:
    """(...) Which tags of corners (..., 4, 2) are seen with all four."""
    return np.asarray(np.isfinite(corners).all(axis=(-2, -1)), dtype=bool)


class Detector:
    """Finds tags by OpenCV's detector, and their corners to a fraction of a pixel."""

    def __init__(self, ids: tuple[int, ...]) -> None:
        self._ids = ids
        self._detector = cv2.aruco.ArucoDetector(DICTIONARY, cv2.aruco.DetectorParameters())

    def find(self, picture: Picture) -> Array:
        """(tags, 4, 2) [px] Corners in one picture, NaN where a tag is not in it."""
        found = np.full((len(self._ids), 4, 2), np.nan)
        corners, numbers, _ = self._detector.detectMarkers(picture)
        if numbers is None:
            return found
        for corner, number in zip(corners, numbers.ravel().tolist(), strict=True):
            if number in self._ids:
                found[self._ids.index(number)] = refined(picture, corner.reshape(4, 2).astype(np.float64))
        return found


def sight(film: Film, layout: Layout, say: Callable[[float], None] = lambda share: None) -> Sightings:
    """Find a layout's tags in every picture of a film.

    Raises:
        TrackError: the film cannot be read.
    """
    detector, times, corners = Detector(layout.ids), [], []
    for time, picture in film.pictures():
        times.append(time)
        corners.append(detector.find(picture))
        if len(times) % 10 == 0:
            say(min(len(times) / max(film.count, 1), 1.0))
    if len(times) < 2:
        raise TrackError(f"{film.path}: has one picture only; a film has several")
    return Sightings(np.array(times), layout.ids, np.array(corners))
