"""``nermo bench track``: how far the tracker is off, on films whose truth is known."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import chi2

from nermo_description.robots import load_robot
from nermo_track.bench.studio import Poses, Studio, look_at, save_film, shoot
from nermo_track.bench.walk import Walk, marked, walk
from nermo_track.camera import Camera
from nermo_track.clock import Motion
from nermo_track.layout import Layout, load_layout
from nermo_track.work import Shot, Tracked, follow, on_clock

BEGIN = 0.7
"""[s] of the walk at which films begin."""
COVERED = ((3.0, 3.4),)
"""[s] of a film in which a hand is before the mouse."""


@dataclass(frozen=True)
class Place:
    """Where a camera stands [m], where it looks, and what it is."""

    name: str
    eye: tuple[float, float, float]
    target: tuple[float, float, float]
    camera: Camera
    fps: float


def _camera(width: int, height: int, focal: float, k1: float, line_delay: float, exposure: float) -> Camera:
    """A lens whose distortion bends the picture's corners, and whose axis is a little off its middle."""
    return Camera(
        width=width,
        height=height,
        fx=focal,
        fy=1.002 * focal,
        cx=0.503 * width,
        cy=0.494 * height,
        distortion=(k1, 0.08, 1e-3, -5e-4, 0.0),
        line_delay=line_delay,
        exposure=exposure,
    )


PLACES = (
    Place("above", (0.12, -0.02, 0.75), (0.13, 0.0, 0.0), _camera(960, 720, 900.0, -0.25, 2e-5, 4e-3), 30.0),
    Place("oblique", (0.15, -0.50, 0.55), (0.15, 0.0, 0.0), _camera(960, 720, 900.0, -0.25, 2e-5, 4e-3), 30.0),
    Place("behind", (-0.45, -0.25, 0.45), (0.15, 0.0, 0.0), _camera(960, 720, 900.0, -0.20, 2e-5, 8e-3), 30.0),
    Place("far", (0.15, -0.90, 0.90), (0.15, 0.0, 0.0), _camera(960, 720, 900.0, -0.25, 2e-5, 4e-3), 30.0),
    Place("small, fast", (0.15, -0.40, 0.55), (0.15, 0.0, 0.0), _camera(640, 480, 600.0, -0.30, 1e-5, 2e-3), 60.0),
    Place("beside", (0.15, -0.45, 0.32), (0.15, 0.0, 0.02), _camera(1280, 720, 1250.0, -0.25, 2e-5, 2e-3), 30.0),
)
"""Above the walk, beside it, behind it with twice the exposure, twice as far, a small picture twice as often; and
beside it, near enough for the tags on its paws."""


def bench(robot: str, quick: bool, seed: int, say: Callable[[str, float], None]) -> list[dict[str, Any]]:
    """A row for each camera. Raises ParameterError, TrackError."""
    seconds = 7.0 if quick else 12.0
    parameters, layout = load_robot(robot), load_layout()
    walked = walk(parameters, BEGIN + seconds + 0.5)
    feet = marked(parameters, walked)
    places = PLACES[:3] if quick else PLACES
    rows = []
    for number, place in enumerate(places):
        say(place.name, number / len(places))
        with tempfile.TemporaryDirectory() as folder:
            film = Path(folder) / "film.avi"
            shoot_walk(
                place, walked, layout, film, seconds, seed + number, {name: feet[name] for name in layout.markers}
            )
            found = follow(Shot(film, place.camera), layout, lambda stage, share: None)
        timed = on_clock(found, Motion(walked.time, walked.position, walked.rotation))
        rows.append({"camera": place.name, **errors(timed, walked), **marker_errors(timed, feet, place.eye)})
    return rows


def shoot_walk(
    place: Place,
    walked: Walk,
    layout: Layout,
    film: Path,
    seconds: float,
    seed: int,
    markers: Mapping[str, Poses] | None = None,
) -> None:
    """Draw the film of a walk, from `BEGIN` on; ``markers``: the poses of marked places that wear their tags."""
    studio = Studio.of_layout(place.camera, look_at(place.eye, place.target), layout, seed, markers)
    pictures = shoot(studio, walked.poses, BEGIN, seconds, place.fps, COVERED)
    save_film(pictures, film, place.camera, place.fps)


def errors(found: Tracked, walked: Walk) -> dict[str, Any]:
    """How far a film's poses are from the truth at the fitted times, and the clock from its own."""
    track, clock = found.track, found.clock
    if clock is None:
        raise ValueError("a film without a clock")
    place, turn = walked.poses(clock.at(track.time))
    off = track.position - place
    turned = (track.rotation * turn.inv()).as_rotvec()
    both = np.hstack([off, turned])
    scaled = np.einsum("ni,nij,nj->n", both, np.linalg.inv(track.covariance), both)
    across = np.linalg.norm(track.position[0] - track.position[-1])
    missing = track.missing
    return {
        "pictures": missing.pictures,
        "poses": len(track.time),
        "covered": missing.lost + missing.misfit + missing.jump,
        "way_m": float(across),
        "position_rms_mm": 1e3 * float(np.sqrt(np.mean(np.sum(off**2, axis=1)))),
        "position_mean_mm": 1e3 * float(np.linalg.norm(off.mean(axis=0))),
        "position_noise_mm": 1e3 * float(np.sqrt(np.sum(off.var(axis=0)))),
        "heading_rms_deg": float(np.degrees(np.sqrt(np.mean(turned[:, 2] ** 2)))),
        "tilt_rms_deg": float(np.degrees(np.sqrt(np.mean(np.sum(turned[:, :2] ** 2, axis=1))))),
        "said_position_mm": 1e3 * float(np.sqrt(np.median(np.trace(track.covariance[:, :3, :3], axis1=1, axis2=2)))),
        "error_over_said": float(np.sqrt(np.median(scaled) / chi2.ppf(0.5, 6))),
        "clock_error_ms": 1e3 * (clock.offset - BEGIN),
        "clock_said_ms": 1e3 * clock.deviation,
    }


def marker_errors(found: Tracked, feet: Mapping[str, Poses], eye: Sequence[float]) -> dict[str, Any]:
    """How far marked places are from the truth at the fitted times, those together that a film sees.

    A small tag tells what lies across the line of sight from ``eye`` (3,) [m] better than how far away it is.
    """
    track, clock = found.track, found.clock
    if clock is None:
        raise ValueError("a film without a clock")
    if not track.markers:
        return dict.fromkeys(("marked_poses", "marked_across_mm", "marked_along_mm", "marked_said_mm"))
    truth = np.vstack([feet[place](clock.at(seen.time))[0] for place, seen in track.markers.items()])
    off = np.vstack([seen.position for seen in track.markers.values()]) - truth
    sight = (truth - eye) / np.linalg.norm(truth - eye, axis=1, keepdims=True)
    along = np.sum(off * sight, axis=1)
    across = np.linalg.norm(off - along[:, None] * sight, axis=1)
    said = np.vstack([np.diagonal(seen.covariance, axis1=1, axis2=2)[:, :3] for seen in track.markers.values()])
    return {
        "marked_poses": len(off),
        "marked_across_mm": 1e3 * float(np.sqrt(np.mean(across**2))),
        "marked_along_mm": 1e3 * float(np.sqrt(np.mean(along**2))),
        "marked_said_mm": 1e3 * float(np.sqrt(np.median(said.sum(axis=1)))),
    }
