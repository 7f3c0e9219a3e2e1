"""A film as pictures with their times."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from nermo_track.errors import TrackError

Picture = NDArray[np.uint8]
"""(height, width), grey."""


def times_file(film: Path) -> Path:
    """Where the times of a film's pictures stand that was taken live: `walk.times.csv` beside `walk.mkv`."""
    return film.with_suffix(".times.csv")


class Film:
    """A film in a file that OpenCV can read (mp4, mov, avi, mkv ...).

    A picture's time is what the table beside a live film says, or else the file, since telephones film at a rate that
    varies; ``fps`` [Hz] instead where neither tells, or the rate is that at which a slow motion is to be played.
    """

    def __init__(self, path: Path, fps: float | None = None) -> None:
        """Open the film.

        Raises:
            TrackError: there is none, it is no film, or the rate cannot be.
        """
        if not path.is_file():
            raise TrackError(f"{path}: there is no such film")
        if fps is not None and not 1.0 <= fps <= 10000.0:
            raise TrackError(f"--fps: is {fps:g}; allowed: 1 to 10000 Hz")
        self.path, self._own_rate = path, fps
        self._times = _read_times(times_file(path)) if fps is None and times_file(path).is_file() else None
        capture = cv2.VideoCapture(str(path))
        try:
            if not capture.isOpened():
                raise TrackError(f"{path}: is no film that OpenCV can read")
            self.width = int(capture.get(cv2.CAP_PROP_FRAME_WIDTH))
            self.height = int(capture.get(cv2.CAP_PROP_FRAME_HEIGHT))
            self.count = max(int(capture.get(cv2.CAP_PROP_FRAME_COUNT)), 0)
            """Pictures as the file says, which may be off by a few; 0 where it does not."""
        finally:
            capture.release()

    def pictures(self) -> Iterator[tuple[float, Picture]]:
        """All pictures with their times [s] since the first one.

        Raises:
            TrackError: times do not rise, or there is no picture.
        """
        capture = cv2.VideoCapture(str(self.path))
        number, begin, last = 0, 0.0, -1.0
        try:
            while True:
                read, picture = capture.read()
                if not read:
                    break
                told = capture.get(cv2.CAP_PROP_POS_MSEC) * 1e-3
                begin = told if number == 0 else begin
                time = self._time(number, told - begin)
                if time <= last:
                    raise TrackError(
                        f"{self.path}: picture {number} is at {time:.4f} s, not after the one before it; "
                        "give the rate at which it was filmed (--fps)"
                    )
                last = time
                yield time, np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY), dtype=np.uint8)
                number += 1
        finally:
            capture.release()
        if number == 0:
            raise TrackError(f"{self.path}: holds no picture that can be read")

    def _time(self, number: int, told: float) -> float:
        """[s] Of a picture, of which the file says ``told``."""
        if self._own_rate is not None:
            return number / self._own_rate
        if self._times is None:
            return told
        if number >= len(self._times):
            raise TrackError(
                f"{times_file(self.path)}: has {len(self._times)} times, {self.path} has more pictures; is it another "
                "film's? Take it away, or give the rate (--fps)"
            )
        return float(self._times[number])


def _read_times(path: Path) -> NDArray[np.float64]:
    """(n,) [s] Times since the first of a table of stamps [ns]. Raises TrackError if it cannot be used."""
    try:
        stamps = [int(row["stamp_ns"]) for row in csv.DictReader(path.read_text("utf-8").splitlines())]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise TrackError(
            f"{path}: is no table with whole numbers in the column stamp_ns, of the film beside it"
        ) from error
    if not stamps:
        raise TrackError(f"{path}: has no row; take it away, or give the rate (--fps)")
    return np.array([(stamp - stamps[0]) * 1e-9 for stamp in stamps])
