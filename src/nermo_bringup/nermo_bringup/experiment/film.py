"""Films of an experiment's runs, tracked into recordings beside what was recorded."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nermo_bringup.experiment.plan import FILMED_FOLDER, Plan, Run
from nermo_description.results import CommandError, write_results
from nermo_gap.protocol.scene import SCENE_FILE

if TYPE_CHECKING:
    from nermo_track.work import Shot

TRACK_FILE = "track.json"
SUFFIXES = (".mp4", ".mov", ".avi", ".mkv", ".m4v", ".webm", ".mts")
_NUMBER = re.compile(r"(\d+)(?!\d)")

Say = Callable[[str, float], None]


@dataclass(frozen=True)
class Filming:
    """Films, and what took them."""

    films: Sequence[Path]
    """Files, or folders of them."""
    cameras: Sequence[Path]
    tags: Path | None
    fps: float | None


def films_of(paths: Sequence[Path], runs: Sequence[Run]) -> tuple[dict[int, list[Path]], list[Path]]:
    """Films by the number of their run, with which their names begin; and those of a folder that belong to none.

    Raises:
        CommandError: a file that was named belongs to no run, or there is no such file (status 2).
    """
    found: dict[int, list[Path]] = {}
    strange, numbers = [], {run.number for run in runs}
    for path in paths:
        inside = path.is_dir()
        if not inside and not path.is_file():
            raise CommandError(f"--film: {path} does not exist", status=2)
        files = sorted(file for file in path.iterdir() if file.suffix.lower() in SUFFIXES) if inside else [path]
        for file in files:
            number = _NUMBER.match(file.name)
            if number is not None and int(number[1]) in numbers:
                found.setdefault(int(number[1]), []).append(file)
            elif inside:
                strange.append(file)
            else:
                names = f"{min(numbers):02d} to {max(numbers):02d}"
                raise CommandError(
                    f"--film: {file} does not begin with the number of a run, {names}: as in 01.mp4", status=2
                )
    return found, strange


def track(plan: Plan, run: Run, films: Sequence[Path], filming: Filming, say: Say) -> None:
    """Follow the mouse through the films of one run, into a recording of its own; nothing where that is done.

    Raises:
        TrackError: a film cannot be used, or its clock cannot be told.
        RecordingError: the recording cannot be used, or the new one cannot be written.
        ParameterError: a camera, the tags or the robot cannot be read.
        CommandError: no camera belongs to a film (status 2).
    """
    from nermo_track.layout import load_layout
    from nermo_track.work import into_recording

    out, source = plan.folder / FILMED_FOLDER / run.name, plan.folder / run.name
    shots = [shot_of(film, filming) for film in films]
    taken = [{"film": str(shot.film.absolute()), "camera": shot.camera.model_dump(mode="json")} for shot in shots]
    told = _told(out)
    if told is not None and told["of"] == json.loads(json.dumps(taken)) and tracked(plan, run) is not None:
        return
    if out.exists():
        shutil.rmtree(out)
    written = into_recording(shots, load_layout(filming.tags), source, out, plan.about.robot, say)
    facts = {"of": taken, "films": [film.report() for film in written.films]}
    write_results(out / TRACK_FILE, "track", facts, robot=written.robot)


def tracked(plan: Plan, run: Run) -> Path | None:
    """Folder of a run's recording with what films tell; None where there is none, or it is of an earlier attempt."""
    out = plan.folder / FILMED_FOLDER / run.name
    try:
        same = (out / SCENE_FILE).read_bytes() == (plan.folder / run.name / SCENE_FILE).read_bytes()
    except OSError:
        return None
    return out if same and _told(out) is not None else None


def clock_deviation(folder: Path) -> float:
    """[s] Standard deviation of the clocks of the films of a run, of the least certain one; 0 where none was filmed."""
    told = _told(folder)
    return 0.0 if told is None else 1e-3 * max(film["clock_sd_ms"] for film in told["films"])


def _told(folder: Path) -> dict[str, Any] | None:
    try:
        return dict(json.loads((folder / TRACK_FILE).read_text(encoding="utf-8")))
    except (OSError, ValueError):
        return None


def shot_of(film: Path, filming: Filming) -> Shot:
    """A film with its camera: the only one, or that whose name ends the film's.

    Raises:
        CommandError: there is none, or more than one (status 2).
        ParameterError: the camera's file cannot be used.
    """
    from nermo_track.camera import load_camera
    from nermo_track.work import Shot

    cameras = filming.cameras
    if not cameras:
        raise CommandError("--film needs --camera, the file that nermo track calibrate wrote", status=2)
    if len(cameras) > 1:
        cameras = [camera for camera in cameras if film.stem.endswith(f"_{camera.stem}")]
        if len(cameras) != 1:
            names = ", ".join(f"_{camera.stem}" for camera in filming.cameras)
            raise CommandError(f"--film: {film}: of several cameras its name must end in one of {names}", status=2)
    return Shot(film, load_camera(cameras[0]), filming.fps)
