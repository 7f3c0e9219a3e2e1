"""``nermo bench track --top``: how far the way of a mouse without tags is off, on films whose truth is known."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from nermo_description.parameters import RobotParameters
from nermo_description.robots import load_robot
from nermo_track.bench.shape import Shape
from nermo_track.bench.studio import Flaws, Print, Studio, look_at, save_film, shoot
from nermo_track.bench.walk import Steps, Walk, walk
from nermo_track.camera import Camera
from nermo_track.layout import Layout, load_layout
from nermo_track.plane import BACK
from nermo_track.top import Overlooked, View, overlook
from nermo_track.way import BEGINNING, smooth

BEGIN = 0.7
"""[s] of the walk at which films begin."""
STEPS: Steps = ((0.0, 0.0, 0.0), (1.2, 0.08, 0.0), (12.0, 0.0, 0.0), (13.0, 0.08, 0.15), (18.0, 0.08, -0.2))
"""Stands, straight on, stands, curves both ways."""
LENS = Camera(
    width=640,
    height=480,
    fx=480.0,
    fy=481.0,
    cx=322.0,
    cy=237.0,
    distortion=(-0.25, 0.08, 1e-3, -5e-4, 0.0),
    line_delay=2e-5,
    exposure=4e-3,
)
EYE, TARGET = (0.50, -0.025, 1.2), (0.50, 0.0, 0.0)
"""[m] Nearly straight down, as one puts a camera by eye: 1.2 degrees aside."""


@dataclass(frozen=True)
class Scene:
    """How a film is drawn, and how it is used."""

    name: str
    known: str = "tags"
    """What tells the scale: `tags`, `height` or `scale`."""
    seconds: float = 20.0
    greys: tuple[float, float] = (30.0, 90.0)
    noise: float = 2.5
    """Of a pixel, of 255."""
    empty: bool = False
    """A picture of the floor without the mouse is given."""


SCENES = (
    Scene("floor's tags"),
    Scene("camera's height alone", known="height"),
    Scene("scale alone, no lens", known="scale"),
    Scene("grey on grey, twice the noise", greys=(75.0, 105.0), noise=5.0),
    Scene("short, floor filmed alone", seconds=6.0, empty=True),
)


def bench_top(robot: str, quick: bool, seed: int, say: Callable[[str, float], None]) -> list[dict[str, Any]]:
    """A row for each scene. Raises ParameterError, TrackError."""
    parameters, layout = load_robot(robot), load_layout()
    scenes = [replace(scene, seconds=min(scene.seconds, 12.0)) for scene in SCENES[:3]] if quick else SCENES
    walked = walk(parameters, BEGIN + max(scene.seconds for scene in scenes) + 0.5, STEPS)
    rows = []
    for number, scene in enumerate(scenes):
        say(scene.name, number / len(scenes))
        with tempfile.TemporaryDirectory() as folder:
            view = shoot_scene(scene, parameters, walked, layout, Path(folder), LENS, seed + number)
            found = overlook(view, layout, lambda stage, share: None)
        rows.append({"film": scene.name, **errors(found, walked)})
    return rows


def shoot_scene(
    scene: Scene, robot: RobotParameters, walked: Walk, layout: Layout, folder: Path, camera: Camera, seed: int
) -> View:
    """Draw the film of a scene from `BEGIN` on into a folder, and say how it is to be used."""
    world = look_at(EYE, TARGET)
    still = [Print.of_floor(3.2, 2.4, seed)]
    if scene.known == "tags":
        still += [Print.of_tag(tag) for tag in layout.floor]
    shape = Shape(robot, walked, camera, world, scene.greys, seed)
    studio = Studio(camera, world, still, [], Flaws(noise=scene.noise), seed, [shape])
    film, floor = folder / "film.avi", folder / "floor.png"
    save_film(shoot(studio, walked.poses, BEGIN, scene.seconds, 30.0), film, camera, 30.0)
    if scene.empty:
        cv2.imwrite(str(floor), studio.picture(None, 0.0))
    eye = float(world.inverse.position[2])
    return View(
        film,
        None if scene.known == "scale" else camera,
        height=eye if scene.known == "height" else None,
        scale=(eye - BACK) / camera.fx if scene.known == "scale" else None,
        floor=floor if scene.empty else None,
    )


def errors(found: Overlooked, walked: Walk) -> dict[str, Any]:
    """How far a way is from base_link's, smoothed over the same time."""
    way, unseen = found.way, found.way.unseen
    place, turn = walked.poses(BEGIN + way.time)
    nose = turn.apply([1.0, 0.0, 0.0])
    heading = np.unwrap(np.arctan2(nose[:, 1], nose[:, 0]))
    raw = np.column_stack([place[:, :2], heading])
    value, slope, _, _, _ = smooth(way.time, raw, found.view.window)
    true_speed = slope[:, 0] * np.cos(value[:, 2]) + slope[:, 1] * np.sin(value[:, 2])
    first = float(np.mean(heading[way.time - way.time[0] <= BEGINNING]))
    ahead = np.array([np.cos(first), np.sin(first)])
    gone = value[:, :2] - value[0, :2]
    true_drift = gone @ [-ahead[1], ahead[0]]
    # Without tags the world's axes are the picture's.
    camera_yaw = 0.0
    if found.view.height is not None or found.view.scale is not None:
        right = look_at(EYE, TARGET).rotation.inv().apply([1.0, 0.0, 0.0])
        camera_yaw = float(np.arctan2(right[1], right[0]))
    off_heading = np.angle(np.exp(1j * (way.heading + camera_yaw - value[:, 2])))
    off_speed, off_drift = way.speed - true_speed, way.drift - true_drift
    said = np.median(way.deviation, axis=0)
    span = float(way.time[-1] - way.time[0])
    return {
        "pictures": unseen.pictures,
        "seen": len(way.time),
        "way_m": float(gone[-1] @ ahead),
        "speed_rms_mm_s": 1e3 * float(np.sqrt(np.mean(off_speed**2))),
        "speed_said_mm_s": 1e3 * float(said[3]),
        "mean_speed_mm_s": 1e3 * float(gone[-1] @ ahead) / span,
        "mean_speed_error_mm_s": 1e3 * (way.mean_speed - float(gone[-1] @ ahead) / span),
        "mean_speed_said_mm_s": 1e3 * way.mean_speed_deviation,
        "heading_rms_deg": float(np.degrees(np.sqrt(np.mean(off_heading**2)))),
        "heading_mean_deg": float(np.degrees(np.mean(off_heading))),
        "heading_said_deg": float(np.degrees(said[2])),
        "drift_mm": 1e3 * float(true_drift[-1]),
        "drift_rms_mm": 1e3 * float(np.sqrt(np.mean(off_drift**2))),
        "drift_end_mm": 1e3 * float(off_drift[-1]),
        "drift_said_mm": 1e3 * float(way.deviation[-1, 5]),
        "nose_by": way.nose_by,
    }
