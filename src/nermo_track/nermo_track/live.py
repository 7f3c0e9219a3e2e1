"""A camera that films now: its pictures stamped as they come, and kept without loss in a film that knows its times."""

from __future__ import annotations

import csv
import os
import queue
import shutil
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from nermo_track.errors import TrackError
from nermo_track.film import Picture, times_file
from nermo_track.layout import Layout
from nermo_track.sightings import Detector, whole

SETTLE = 0.5
"""[s] Of pictures that are not filmed: those that waited while the camera was opened come all at once."""
SILENT = 5.0
"""[s] Without a picture from which on a camera has stopped."""
WAITING = 120
"""Pictures that may wait to be written: four seconds at 30 Hz, a second of a slow disk at 120 Hz."""
LEAST_FREE = 200e6
"""[bytes] On the disk, below which filming ends: a film that is cut off by a full disk may lose its end."""
TAGS_EVERY = 0.5
"""[s] From one look for tags to the next."""


@dataclass(frozen=True)
class Said:
    """How it goes."""

    seconds: float
    pictures: int
    rate: float
    """[Hz] Over the last 30 pictures."""
    dropped: int
    """Pictures that should have come by the camera's own rate, or came and could not be written in time."""
    tags: tuple[int, ...]
    """Of the layout's, those in the picture."""

    def sentence(self, all_tags: tuple[int, ...]) -> str:
        """How it goes, of a layout with these tags."""
        seen = ", ".join(str(number) for number in self.tags) or "none"
        return (
            f"{self.pictures} pictures in {self.seconds:.1f} s ({self.rate:.1f} a second, {self.dropped} dropped); "
            f"tags seen: {seen} of {len(all_tags)}"
        )


@dataclass(frozen=True)
class Filmed:
    """A film that was taken."""

    path: Path
    width: int
    height: int
    said: Said
    ended: str | None
    """Why it ended by itself, in a sentence; None where it was told to."""


class Source:
    """A camera that is read in a thread of its own, so that no picture waits for the disk before it is stamped."""

    def __init__(self, name: str, size: tuple[int, int] | None = None, rate: float | None = None) -> None:
        """Open a camera and wait for its first picture.

        Args:
            name: Number or path of a device (`0`, `/dev/video0`), or a URL (http, rtsp).
            size: Width and height [px] to ask a device for.
            rate: [Hz] Likewise.

        Raises:
            TrackError: it is not there, sends nothing, or cannot do what it is asked for.
        """
        self.name = name
        self._capture = _opened(name, size, rate)
        self._pictures: queue.Queue[tuple[int, Picture] | None] = queue.Queue(WAITING)
        self._end = threading.Event()
        self.lost = 0
        """Pictures that came while too many waited to be written."""
        self._thread = threading.Thread(target=self._read, name="camera", daemon=True)
        self._thread.start()

    def next(self) -> tuple[int, Picture] | None:
        """The next picture and its stamp [ns] of the host's clock; None where the camera has stopped."""
        try:
            return self._pictures.get(timeout=SILENT)
        except queue.Empty:
            return None

    def close(self) -> None:
        """Let go of the camera. One that hangs is left to the thread that reads it."""
        self._end.set()
        self._thread.join(timeout=1.0)

    def _read(self) -> None:
        # Stamps must rise even where somebody sets the clock meanwhile.
        offset = time.time_ns() - time.monotonic_ns()
        settled = time.monotonic() + SETTLE
        while not self._end.is_set():
            read, picture = self._capture.read()
            stamp = offset + time.monotonic_ns()
            if not read:
                break
            if time.monotonic() < settled:
                continue
            try:
                self._pictures.put_nowait((stamp, _grey(picture)))
            except queue.Full:
                self.lost += 1
        self._capture.release()
        while not self._end.is_set():
            try:
                self._pictures.put(None, timeout=0.2)
                return
            except queue.Full:
                continue


def _grey(picture: NDArray[Any]) -> Picture:
    return np.asarray(picture if picture.ndim == 2 else cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY), dtype=np.uint8)


def _opened(name: str, size: tuple[int, int] | None, rate: float | None) -> cv2.VideoCapture:
    number = name.removeprefix("/dev/video")
    device = number.isdigit()
    if not device and "://" not in name:
        raise TrackError(
            f"{name}: is no camera; give a device's number (0), its path (/dev/video0) or a URL (http://, rtsp://). "
            "A film in a file is for nermo track film"
        )
    if not device and (size is not None or rate is not None):
        raise TrackError(f"{name}: --size and --rate are for devices; set what a camera at a URL sends at the camera")
    if device:
        capture = cv2.VideoCapture(int(number))
        if capture.isOpened() and size is not None:
            # Most USB cameras send large pictures at a full rate as JPEG only.
            capture.set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*"MJPG"))
            capture.set(cv2.CAP_PROP_FRAME_WIDTH, size[0])
            capture.set(cv2.CAP_PROP_FRAME_HEIGHT, size[1])
        if capture.isOpened() and rate is not None:
            capture.set(cv2.CAP_PROP_FPS, rate)
    else:
        wait = round(1e3 * SILENT)
        # One thread decodes: with several, pictures come as many later as there are threads.
        settings = [cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, wait, cv2.CAP_PROP_READ_TIMEOUT_MSEC, wait]
        capture = cv2.VideoCapture(name, cv2.CAP_FFMPEG, [*settings, cv2.CAP_PROP_N_THREADS, 1])
    if not capture.isOpened():
        raise TrackError(f"{name}: no camera answers there; is it plugged in, free, and its number or address right?")
    got = tuple(round(capture.get(name)) for name in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
    if size is not None and got != tuple(size):
        capture.release()
        raise TrackError(
            f"--size: is {size[0]} x {size[1]}; the camera {name} gives {got[0]} x {got[1]} instead: ask for a size "
            "that it has"
        )
    return capture


def film_live(
    source: Source,
    out: Path,
    layout: Layout,
    seconds: float | None = None,
    say: Callable[[Said], None] = lambda said: None,
) -> Filmed:
    """Film until Ctrl-C, the end of a time [s], or the camera's or the disk's.

    Pictures are kept as grey as they came (FFV1), their stamps in a table beside the film, written as they come.

    Args:
        source: The camera; it is closed.
        out: The .mkv to write; its times stand in `times_file` of it.
        layout: Tags to look for now and then.
        seconds: How long.
        say: Is told how it goes, twice a second.

    Raises:
        TrackError: the film cannot be begun, or no picture came.
    """
    if out.suffix != ".mkv":
        raise TrackError(f"--out: is {out}; must end in .mkv")
    for path in (out, times_file(out)):
        if path.exists():
            raise TrackError(f"{path}: is there already, and is never overwritten")
    try:
        first = source.next()
        if first is None:
            raise TrackError(f"{source.name}: the camera sends no picture; is another program using it?")
        return _film(source, first, out, layout, seconds, say)
    finally:
        source.close()


def _film(
    source: Source,
    first: tuple[int, Picture],
    out: Path,
    layout: Layout,
    seconds: float | None,
    say: Callable[[Said], None],
) -> Filmed:
    height, width = first[1].shape
    folder, ended = out.absolute().parent, None
    detector, stamps, tags, looked = Detector(layout.ids), list[int](), tuple[int, ...](), 0
    try:
        table = times_file(out).open("x", encoding="utf-8", newline="", buffering=1)
    except OSError as error:
        raise TrackError(f"{out}: cannot be written: {error.strerror}") from error
    video = cv2.VideoWriter(str(out), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*"FFV1"), 30.0, (width, height), False)
    with table:
        rows = csv.writer(table)
        try:
            if not video.isOpened():
                raise TrackError(f"{out}: cannot be written by OpenCV")
            rows.writerow(["stamp_ns"])
            picture: tuple[int, Picture] | None = first
            while picture is not None:
                stamp, grey = picture
                if grey.shape != (height, width):
                    ended = f"{source.name}: its pictures changed to {grey.shape[1]} x {grey.shape[0]} pixels"
                    break
                if shutil.disk_usage(folder).free < LEAST_FREE:
                    ended = f"{out}: the disk is full, but for {1e-6 * LEAST_FREE:.0f} MB"
                    break
                # The time first: a film that is cut off has a time for each picture that it still has.
                rows.writerow([stamp])
                video.write(grey)
                stamps.append(stamp)
                if (stamp - looked) * 1e-9 >= TAGS_EVERY:
                    looked, tags = stamp, _seen(detector, layout, grey)
                    say(_said(stamps, tags))
                if seconds is not None and (stamp - stamps[0]) * 1e-9 >= seconds:
                    break
                picture = source.next()
            else:
                ended = f"{source.name}: the camera stopped sending"
        except KeyboardInterrupt:
            pass
        except OSError as error:
            ended = f"{out}: cannot be written on: {os.strerror(error.errno or 0)}"
        finally:
            video.release()
    if not stamps:
        for path in (out, times_file(out)):
            path.unlink(missing_ok=True)
        raise TrackError(f"{ended or out}: no picture was filmed")
    return Filmed(out, width, height, _said(stamps, tags), ended)


def _seen(detector: Detector, layout: Layout, picture: Picture) -> tuple[int, ...]:
    there = whole(detector.find(picture))
    return tuple(number for number, seen in zip(layout.ids, there, strict=True) if seen)


def _said(stamps: list[int], tags: tuple[int, ...]) -> Said:
    time_s = np.array(stamps, dtype=np.int64) - stamps[0]
    step = np.diff(time_s) * 1e-9
    span = float(time_s[-1]) * 1e-9
    recent = step[-min(len(step), 30) :]
    rate = 1.0 / float(np.mean(recent)) if len(recent) else 0.0
    dropped = int(np.maximum(np.round(step / np.median(step)) - 1.0, 0.0).sum()) if len(step) else 0
    return Said(span, len(stamps), rate, dropped, tags)
