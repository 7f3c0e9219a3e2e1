"""A hidden mouse is filmed, tracked and diagnosed, and its seal is opened: which faults a film alone finds.

Each step leaves what the user's own command takes, or would have left, so that each can be done again by hand; and a
file when it is done, so that a call that was stopped goes on there.
"""

from __future__ import annotations

import dataclasses
import json
import shutil
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from nermo_description.model import build_model
from nermo_description.parameter_files import write_yaml
from nermo_description.parameters import RobotParameters
from nermo_description.stand import Stand
from nermo_gap.blind.mice.mouse import draw
from nermo_gap.blind.mice.seal import SEALED, Answer, judge, open_seal, seal
from nermo_gap.protocol.play import Body, play
from nermo_gap.protocol.scene import BAG_FOLDER, SCENE_FILE, SceneFile
from nermo_gap.protocol.standard import WALKING, protocol_of
from nermo_gap.protocol.types import Protocol, Segment
from nermo_gap.robots.channels import TRACKER, command
from nermo_gap.robots.diagnosis import diagnose_recordings
from nermo_gap.robots.simulated import Noise
from nermo_track.bench.recorded import START, write_commands
from nermo_track.bench.studio import Studio, look_at, save_film, shoot
from nermo_track.bench.walk import Walk
from nermo_track.camera import Camera, save_camera
from nermo_track.layout import load_layout
from nermo_track.work import Shot, into_recording
from simgap.analysis.options import Options
from simgap.console import write_diagnosis
from simgap.data.errors import GapInputError

CAMERA = Camera(
    width=1280,
    height=720,
    fx=1150.0,
    fy=1152.0,
    cx=644.0,
    cy=356.0,
    distortion=(-0.25, 0.08, 1e-3, -5e-4, 0.0),
    line_delay=2e-5,
    exposure=4e-3,
)
EYE, TARGET = (0.2, -0.7, 0.55), (0.2, 0.0, 0.0)
"""[m] Where the camera stands and looks, the floor's sheet at the origin; 0.9 m from the mouse."""
FPS = 30.0
LATE = 0.7
"""[s] by which a film begins after its commands. Nobody but the score knows."""
TRACKED, ROW = "tracked.json", "row.json"
"""What is left when the films are tracked, and when the diagnosis is judged. The seal is left when all is filmed."""
SEGMENTS = ("standing", WALKING)
"""Of the standard protocol. What hangs in the stand has no clock on film."""

Say = Callable[[str, float], None]


@dataclass(frozen=True)
class Filmed:
    """A segment on film, and how far its track is off."""

    name: str
    pictures: int
    seen: float
    """Share of the pictures that have a pose."""
    clock_error_ms: float
    clock_said_ms: float


def film(robot: RobotParameters, name: str, number: int, fault: str | None, out: Path, say: Say) -> None:
    """Film hidden mouse ``number``: ``out``/films, its camera, and ``out``/told, what its servos were told.

    ``name``: under which the robot is loaded. ``fault`` asks for one instead of drawing it.

    Raises:
        GapInputError: ``out`` holds something already, or there is no such fault.
        SimulationDivergedError: the mouse's simulation broke down.
    """
    if out.exists() and any(out.iterdir()):
        raise GapInputError(f"{out}: holds something already; give a folder that is new or empty")
    body, wrong = draw(robot, number, fault)
    body = dataclasses.replace(body, noise=Noise(place=0.0, turn=0.0, hidden=0.0))
    standard = protocol_of("standard", robot, filmed=True)
    protocol = dataclasses.replace(standard, segments=tuple(s for s in standard.segments if s.name in SEGMENTS))
    (out / "films").mkdir(parents=True)
    save_camera(CAMERA, out / "camera.yaml")
    for order, segment in enumerate(protocol.segments, start=1):
        say(f"{segment.name}: move", 0.0)
        walked = _walk(segment, body, robot, number)
        folder = out / "told" / f"{order}_{segment.name}"
        _tell(protocol, segment, walked, robot, folder)
        seconds = float(walked.time[-1]) - LATE
        studio = Studio.of_layout(CAMERA, look_at(EYE, TARGET), load_layout(), number)
        pictures = shoot(studio, walked.poses, LATE, seconds, FPS)
        total = round(seconds * FPS)

        def drawn(pictures: Any = pictures, total: int = total, what: str = segment.name) -> Any:
            for count, picture in enumerate(pictures):
                say(f"{what}: film", count / total)
                yield picture

        save_film(drawn(), out / "films" / f"{folder.name}.avi", CAMERA, FPS)
    seal(Answer.of(name, number, wrong), out)


def follow(out: Path, say: Say) -> list[Filmed]:
    """Track the films of `film` into ``out``/filmed, as `nermo track film` does.

    Raises:
        TrackError: a film cannot be used, or its clock cannot be told.
    """
    shutil.rmtree(out / "filmed", ignore_errors=True)
    found = []
    for told in sorted((out / "told").iterdir()):
        shot = Shot(out / "films" / f"{told.name}.avi", CAMERA)
        written = into_recording([shot], load_layout(), told, out / "filmed" / told.name, None, say)
        tracked = written.films[0]
        if tracked.clock is None:
            raise ValueError("a film without a clock")
        missing = tracked.track.missing
        off, said = 1e3 * (tracked.clock.offset - LATE), 1e3 * tracked.clock.deviation
        found.append(Filmed(told.name.partition("_")[2], missing.pictures, 1.0 - missing.share, off, said))
    return found


def whole_way(
    robot: RobotParameters, name: str, number: int, fault: str | None, out: Path, budget: float | None, say: Say
) -> dict[str, Any]:
    """Film a hidden mouse, track it, diagnose what was tracked, open the seal; a row of the bench's table.

    What an earlier call has done in ``out`` is not done again. See `film` and `follow`.
    """
    if (out / ROW).is_file():
        return _read(out / ROW)
    if not (out / SEALED).is_file():
        shutil.rmtree(out, ignore_errors=True)
        film(robot, name, number, fault, out, say)
    if not (out / TRACKED).is_file():
        films = follow(out, say)
        _write(out / TRACKED, {film.name: dataclasses.asdict(film) for film in films})
    begun = time.monotonic()
    found = diagnose_recordings([out / "filmed"], name, Options(baselines=False, progress=say, budget=budget))
    seconds = time.monotonic() - begun
    write_diagnosis(found, out / "diagnosis", None)
    answer, films = open_seal(out), [Filmed(**row) for row in _read(out / TRACKED).values()]
    row = {
        "mouse": number,
        "truth": answer.sentence(),
        "verdict": found.report["verdict"],
        "named": ", ".join(f"{e['name']}@{e['site']}" for e in found.report["effects"]) or None,
        "judged": judge(answer, found.report),
        **{f"{film.name}_seen": film.seen for film in films},
        **{f"{film.name}_clock_ms": film.clock_error_ms for film in films},
        **{f"{film.name}_clock_said_ms": film.clock_said_ms for film in films},
        "seconds": seconds,
    }
    _write(out / ROW, row)
    return row


def _read(path: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(path.read_text("utf-8"))
    return found


def _write(path: Path, facts: dict[str, Any]) -> None:
    """Whole or not at all."""
    part = path.with_suffix(".part")
    part.write_text(json.dumps(facts, indent=2) + "\n", "utf-8")
    part.rename(path)


def _walk(segment: Segment, body: Body, robot: RobotParameters, seed: int) -> Walk:
    """A segment played: what the servos were told, and where base_link was."""
    stand = Stand()
    table, _ = play(segment, body, stand, stand.rest(build_model(robot)), np.random.default_rng(seed))
    told = np.column_stack([table[command(servo)] for servo in robot.servos])
    place, turn = (np.column_stack([table[name] for name in part]) for part in (TRACKER[:3], TRACKER[3:]))
    return Walk(table["t"], told, place, Rotation.from_quat(turn, scalar_first=True))


def _tell(protocol: Protocol, segment: Segment, walked: Walk, robot: RobotParameters, folder: Path) -> None:
    """Write a segment's commands and its scene, as a recording through the graph leaves them."""
    folder.mkdir(parents=True)
    stand = Stand()
    scene = SceneFile.of(protocol, segment, robot.name, stand, stand.rest(build_model(robot)))
    told = scene.model_copy(update={"begun": START})
    write_yaml(told.model_dump(mode="json", exclude_none=True), folder / SCENE_FILE)
    write_commands(walked, list(robot.servos), folder / BAG_FOLDER)
