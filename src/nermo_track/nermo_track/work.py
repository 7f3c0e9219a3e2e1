"""From films to poses in a recording's time: each film tracked, its clock fitted, all of them made one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from nermo_description.robots import load_robot
from nermo_node.recording_reader import Recording
from nermo_track.camera import Camera
from nermo_track.clock import Clock, Motion, fit_clock
from nermo_track.commands import Commands, expected_motion, recorded_commands, recorded_robot
from nermo_track.errors import TrackError
from nermo_track.film import Film
from nermo_track.fuse import REACH, Disagreement, Poses, fuse
from nermo_track.layout import Layout
from nermo_track.recording import Source, clock_piece, write_beside
from nermo_track.sightings import sight
from nermo_track.track import Followed, Track, track

Say = Callable[[str, float], None]


@dataclass(frozen=True)
class Shot:
    """A film and who took it."""

    film: Path
    camera: Camera
    fps: float | None = None


@dataclass(frozen=True)
class Tracked:
    """One film's poses, and its clock where there is a recording."""

    shot: Shot
    track: Track
    clock: Clock | None

    def report(self) -> dict[str, Any]:
        """As a command's JSON file has it."""
        found, missing = self.track, self.track.missing
        facts: dict[str, Any] = {
            "film": str(self.shot.film),
            "pictures": missing.pictures,
            "poses": len(found.time),
            "lost": missing.lost,
            "misfit": missing.misfit,
            "jump": missing.jump,
            "missing_share": missing.share,
            "longest_gap_s": missing.longest,
            "corner_deviation_px": found.corner_deviation,
            "blur_px": found.blur,
            "camera_height_m": found.camera_height,
            "floor_motion_px": found.floor_motion,
            "position_sd_mm": [1e3 * value for value in _deviation(found)[:3]],
            "rotation_sd_deg": [float(np.degrees(value)) for value in _deviation(found)[3:]],
            "markers": {
                place: {
                    "poses": len(marker.time),
                    "missing_share": marker.missing.share,
                    "position_sd_mm": [1e3 * value for value in _deviation(marker)[:3]],
                }
                for place, marker in found.markers.items()
            },
        }
        if self.clock is not None:
            facts |= {
                "clock_offset_s": self.clock.offset,
                "clock_sd_ms": 1e3 * self.clock.deviation,
                "clock_rate_ppm": 1e6 * self.clock.rate,
                "clock_agreement": self.clock.agreement,
                "clock_beats_se": self.clock.beats,
                "overlap_s": self.clock.overlap,
                "clock_walked_share": self.clock.walked,
            }
        return facts


@dataclass(frozen=True)
class Written:
    """A recording with the tracker's poses in it."""

    films: list[Tracked]
    robot: str
    topic: str
    poses: int
    """How many were written: those of the time in which the mouse was commanded."""
    markers: dict[str, int]
    """Likewise of each marked place."""
    apart: list[Disagreement]
    out: Path


def follow(shot: Shot, layout: Layout, say: Say) -> Tracked:
    """One film's poses in its own time.

    Raises:
        TrackError: the film cannot be used, or is of another camera.
    """
    film, camera = Film(shot.film, shot.fps), shot.camera
    check_size(film, camera)
    sightings = sight(film, layout, lambda share: say("tags", share))
    return Tracked(shot, track(sightings, camera, layout, str(shot.film)), None)


def check_size(film: Film, camera: Camera) -> None:
    """Raises TrackError for a film of another size than its camera's."""
    if (film.width, film.height) != (camera.width, camera.height):
        raise TrackError(
            f"{film.path}: has {film.width} x {film.height} pixels, its camera was calibrated with {camera.width} x "
            f"{camera.height}; film both with the same settings"
        )


def into_recording(
    shots: Sequence[Shot],
    layout: Layout,
    source: Path,
    out: Path,
    robot: str | None,
    say: Say,
    clock_from: tuple[float, float] | None = None,
) -> Written:
    """Films' poses written beside a recording's commands, into a new folder.

    ``clock_from``: from when to when [s] since the first command the film's clock is fitted; if None, over the piece
    of a protocol that is meant for it, and where there is none over everything.

    Raises:
        TrackError: a film cannot be used, or its clock cannot be told.
        RecordingError: the recording cannot be used, or ``out`` cannot be written.
        ParameterError: the robot's parameters cannot be read.
    """
    origin = Source.at(source)
    recording = Recording(origin.bag)
    parameters = load_robot(robot or recorded_robot(recording) or "nermo_lite")
    commands = recorded_commands(recording, parameters)
    films = [follow(shot, layout, say) for shot in shots]
    expected = expected_motion(commands, parameters, lambda share: say("twin", share))
    clock_from = clock_from or clock_piece(origin, commands)
    if clock_from is not None:
        expected = expected.between(*clock_from)
        if len(expected.time) < 2:
            begin, end, last = *clock_from, float(commands.stamp[-1] - commands.stamp[0]) * 1e-9
            raise TrackError(
                f"--clock-from: is {begin:g} to {end:g} s; the recording's commands are from 0 to {last:g} s"
            )
    timed = [on_clock(film, expected) for film in films]
    poses, apart = fuse([poses_of(film.track, film.clock) for film in timed])
    poses = at_commands(poses, commands)
    markers = {
        place: at_commands(fuse(seen)[0], commands)
        for place in layout.markers
        if (seen := [poses_of(film.track.markers[place], film.clock) for film in timed if place in film.track.markers])
    }
    topic = write_beside(origin, recording, commands, poses, markers, out)
    counts = {place: len(marker.time) for place, marker in markers.items()}
    return Written(timed, parameters.name, topic, len(poses.time), counts, apart, out)


def on_clock(film: Tracked, expected: Motion) -> Tracked:
    """A film with the clock by which it agrees with what was expected. Raises TrackError if it cannot be told."""
    seen = Motion(film.track.time, film.track.position, film.track.rotation)
    return replace(film, clock=fit_clock(seen, expected, str(film.shot.film)))


def poses_of(found: Followed, clock: Clock | None) -> Poses:
    """What was followed through a film, in the recording's time, or in the film's own where it has no clock."""
    time = found.time if clock is None else clock.at(found.time)
    return Poses(time, found.position, found.rotation, found.covariance)


def at_commands(poses: Poses, commands: Commands) -> Poses:
    """Poses carried to the command that is nearest, along their own speed; those of the time of the commands.

    A diagnosis takes a pose as one of the nearest command's. It is half a tick away at most, in which a trot turns
    the torso by 2 mrad. Where no neighbour tells the speed, a pose is not carried.
    """
    grid = np.asarray((commands.stamp - commands.stamp[0]) * 1e-9, dtype=np.float64)
    after = np.clip(np.searchsorted(grid, poses.time), 1, len(grid) - 1)
    nearest = np.where(poses.time - grid[after - 1] <= grid[after] - poses.time, after - 1, after)
    way = grid[nearest] - poses.time
    # Of several poses at one command the nearest is taken: a film of more than 200 Hz has enough.
    order = np.argsort(np.abs(way), kind="stable")
    _, first = np.unique(nearest[order], return_index=True)
    rows = order[first]
    rows = rows[np.abs(way[rows]) <= 0.5 * np.median(np.diff(grid)) + 1e-9]
    before, behind = np.maximum(rows - 1, 0), np.minimum(rows + 1, len(poses.time) - 1)
    span = poses.time[behind] - poses.time[before]
    share = np.where(span <= REACH, way[rows] / np.maximum(span, 1e-9), 0.0)[:, None]
    turned = (poses.rotation[behind] * poses.rotation[before].inv()).as_rotvec()
    return Poses(
        grid[nearest[rows]],
        poses.position[rows] + share * (poses.position[behind] - poses.position[before]),
        Rotation.from_rotvec(share * turned) * poses.rotation[rows],
        poses.covariance[rows],
    )


def _deviation(found: Followed) -> list[float]:
    """Median standard deviations [m, rad]."""
    return [float(value) for value in np.sqrt(np.median(np.diagonal(found.covariance, axis1=1, axis2=2), axis=0))]
