"""A walk of the twin, its films from three places, and its recording."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from nermo_description.robots import load_robot
from nermo_track.bench.command import BEGIN, PLACES, Place, shoot_walk
from nermo_track.bench.recorded import START, write_commands
from nermo_track.bench.studio import Poses
from nermo_track.bench.walk import Walk, marked, walk
from nermo_track.camera import save_camera
from nermo_track.layout import load_layout

SECONDS = 8.0
STEPS = ((0.0, 0.0, 0.0), (1.0, 0.08, 0.0), (2.7, 0.0, 0.0), (3.5, 0.08, 0.5), (5.2, 0.0, 0.0), (6.0, 0.08, -0.5))
"""Starts and stops, as the page asks for: with one stop, a walk that began 100 nm higher no longer told the clock."""


def smaller(place: Place, share: float = 0.6) -> Place:
    """The same place with fewer pixels, drawn sooner."""
    camera = place.camera
    scaled = {name: share * getattr(camera, name) for name in ("fx", "fy", "cx", "cy")}
    size = {"width": round(share * camera.width), "height": round(share * camera.height)}
    return replace(place, camera=camera.model_copy(update={**scaled, **size, "line_delay": camera.line_delay / share}))


@pytest.fixture(scope="session")
def start() -> int:
    """[ns] Stamp of the recording's first command."""
    return START


@pytest.fixture(scope="session")
def walked() -> Walk:
    return walk(load_robot("nermo_lite"), BEGIN + SECONDS + 0.5, STEPS)


@pytest.fixture(scope="session")
def films(walked: Walk, tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[Place, Path, Path]]:
    """Films by place, each with its camera's file, through bent lenses, noisy, smeared, with rolling shutters."""
    folder, found = tmp_path_factory.mktemp("films"), {}
    for number, place in enumerate(smaller(place) for place in PLACES[:3]):
        film, camera = folder / f"{place.name}.avi", folder / f"{place.name}.yaml"
        shoot_walk(place, walked, load_layout(), film, SECONDS, number)
        save_camera(place.camera, camera)
        found[place.name] = (place, film, camera)
    return found


@pytest.fixture(scope="session")
def feet(walked: Walk) -> dict[str, Poses]:
    """Where the marked places of the walk's mouse are."""
    return marked(load_robot("nermo_lite"), walked)


@pytest.fixture(scope="session")
def beside(walked: Walk, feet: dict[str, Poses], tmp_path_factory: pytest.TempPathFactory) -> tuple[Place, Path, Path]:
    """A film from near, of a mouse that wears tags on its paws, and its camera's file."""
    folder, layout = tmp_path_factory.mktemp("beside"), load_layout()
    place = next(place for place in PLACES if place.name == "beside")
    film, camera = folder / "beside.avi", folder / "beside.yaml"
    shoot_walk(place, walked, layout, film, 5.0, 7, {name: feet[name] for name in layout.markers})
    save_camera(place.camera, camera)
    return place, film, camera


@pytest.fixture(scope="session")
def bag(walked: Walk, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of what the walk's servos were told, and of nothing that was measured."""
    servos = list(load_robot("nermo_lite").servos)
    return write_commands(walked, servos, tmp_path_factory.mktemp("bags") / "walk")
