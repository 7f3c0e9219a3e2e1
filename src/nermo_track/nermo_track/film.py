"""A film as pictures with their times."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from nermo_track.errors import TrackError

Picture = NDArray[np.uint8]
"""(height, width), grey."""


class Film:
    """A film in a file that OpenCV can read (mp4, mov, avi, mkv ...).

    A picture's time is what the file says of it, since telephones film at a rate that varies; ``fps`` [Hz] instead
    where the file does not tell, or tells the rate of a slow motion at which it is to be played.
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
                time = told - begin if self._own_rate is None else number / self._own_rate
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
