"""N's experiments through the graph: what who stands beside the mouse is told, and runs played, filmed, measured."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from terminal import Terminal, left_running
from typer.testing import CliRunner

from nermo_bringup.experiment.cli import experiment_app
from nermo_bringup.experiment.measure import seen_in
from nermo_sim.experiments.registry import ON_ROBOT
from nermo_track.bench.command import PLACES
from nermo_track.bench.studio import Studio, look_at, save_film, shoot
from nermo_track.bench.walk import Walk
from nermo_track.camera import Camera, save_camera
from nermo_track.layout import load_layout

pytestmark = pytest.mark.long  # a whole graph


def only(name: str, case: str) -> str:
    """Program text after which an experiment has one case."""
    return f"""
import dataclasses, sys
from nermo_sim.experiments import balance, maze, registry, straight_line_robot as line
one = dataclasses.replace(registry.ON_ROBOT[{name!r}], cases=lambda quick: [{case}])
registry.ON_ROBOT[{name!r}] = one
"""


def command(of_one_case: str, *words: str) -> list[str]:
    """`nermo experiment WORDS` with `only` one case, as a process."""
    program = f"{of_one_case}\nfrom nermo_bringup.cli import main\nsys.argv[0] = 'nermo'\nmain()"
    return [sys.executable, "-c", program, "experiment", *words]


ONE_CASE = only("straight-line", "line.cases(True)[0]")
WORDS = command(ONE_CASE, "straight-line", "--target")
FPS = 15.0


def film_of(folder: Path, film: Path) -> Camera:
    """A film of what the emulated mouse did in a run, drawn from its truth."""
    place, seen, share = PLACES[0], seen_in(folder), 0.5
    assert seen is not None, "the emulated mouse tells its truth"
    size = {"width": round(share * place.camera.width), "height": round(share * place.camera.height)}
    scaled = {name: share * getattr(place.camera, name) for name in ("fx", "fy", "cx", "cy")}
    camera = place.camera.model_copy(update={**size, **scaled, "line_delay": place.camera.line_delay / share})
    time = (seen.stamp - seen.stamp[0]) * 1e-9
    walked = Walk(time, np.zeros((len(time), 1)), seen.position, seen.rotation)
    studio = Studio.of_layout(camera, look_at(place.eye, place.target), load_layout())
    save_film(shoot(studio, walked.poses, 1.0, time[-1] - 1.5, FPS), film, camera, FPS)
    return camera


def test_a_run_is_watched_recorded_filmed_and_measured(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """On the twin in the graph, which waits for every command: a busy machine spoils no walk."""
    short = ["--quick", "--repeats", "2", "--distance", "0.25", "--out", "out"]
    terminal = Terminal([*WORDS, "sim", "--dead-man", "space", *short], tmp_path)
    try:

        def hold() -> None:
            # Whoever types is late on a busy machine, which lets go: then it is done again.
            terminal.type("\n" if terminal.says("press Enter to do it again") else " ")

        terminal.until(lambda: terminal.says("press Enter when it is so"), "it says where to put the mouse")
        assert "run 01 of 2" in terminal.text and "put the mouse on the start line" in terminal.text
        terminal.type("\n")
        terminal.until(lambda: terminal.says("hold the space bar"), "the graph is up")
        terminal.until(lambda: terminal.says("2 of 2: trot"), "the mouse walks", hold)
        terminal.until(lambda: terminal.says("press Enter to keep it"), "it has walked", hold)
        terminal.type("\n")
        terminal.until(lambda: terminal.says("run 02 of 2"), "the next one")
        terminal.type("s\n")
        assert terminal.end() == 0, terminal.text
    finally:
        terminal.close()
    assert not left_running(os.environ["ROS_DOMAIN_ID"])
    assert "1 of 2 runs are recorded" in terminal.text
    robot = tmp_path / "out" / "straight-line" / "robot"
    (run,) = (path for path in robot.iterdir() if path.name.startswith("01_"))

    films = tmp_path / "films"
    films.mkdir()
    save_camera(film_of(run, films / "01.avi"), tmp_path / "camera.yaml")
    (films / "other.avi").write_bytes(b"")
    monkeypatch.chdir(tmp_path)
    scope: dict = {}
    monkeypatch.setitem(ON_ROBOT, "straight-line", ON_ROBOT["straight-line"])
    exec(ONE_CASE, scope)
    words = ["straight-line", "--film", "films", "--camera", "camera.yaml", "--out", "out", "--json", "out.json"]
    told = CliRunner().invoke(experiment_app, words)
    assert told.exit_code == 0, told.output
    assert "other.avi: its name does not begin with the number of a run" in told.output
    facts = json.loads((tmp_path / "out.json").read_text())
    (row,), (measured,) = facts["rows"], facts["runs"]
    assert facts["schema"] == "nermo/straight-line-robot/1"
    assert measured["seen_by"] == "/nermo/tracker/odom" and measured["reached"]
    assert row["runs"] == 1 and row["thesis_robot_speed_m_s"] == 0.067
    # The emulated mouse is the twin, on other ground; a film takes its servos' delay for its own clock's.
    assert row["speed_m_s"] == pytest.approx(row["twin_speed_m_s"], rel=0.15)
    assert 0.0 < row["tracker_speed_m_s"] < 0.02 * row["speed_m_s"]
    assert row["scatter_speed_m_s"] is None, "of one run"
    assert (robot / "straight-line.png").stat().st_size > 0
    truth, filmed = seen_in(run), seen_in(robot / "filmed" / run.name)
    assert truth is not None and filmed is not None
    there = np.interp(filmed.stamp, truth.stamp, truth.position[:, 0])
    assert np.abs(filmed.position[:, 0] - there).max() < 0.01


def test_who_stands_beside_a_real_mouse_is_told_what_to_film_and_may_leave(tmp_path: Path) -> None:
    words = [*WORDS, "serial", "--port", "nowhere", "--repeats", "2", "--quick", "--out", "out"]
    terminal = Terminal(words, tmp_path)
    try:
        terminal.until(lambda: terminal.says("press Enter when it is so"), "it says where to put the mouse")
        assert "one film a run, named 01.mp4" in " ".join(terminal.text.split())
        terminal.type("s\n")
        terminal.until(lambda: terminal.says("run 02 of 2"), "it goes on with the next one")
        terminal.type("q\n")
        assert terminal.end() == 0, terminal.text
    finally:
        terminal.close()
    assert "left; what is recorded stays" in terminal.text and "0 of 2 runs are recorded" in terminal.text
    assert [path.name for path in (tmp_path / "out" / "straight-line" / "robot").iterdir()] == ["experiment.yaml"]


def played_alone(case: str, name: str, folder: Path) -> dict:
    """What is found of one run of one case on the twin in the graph, beside which nobody stands."""
    words = ["--target", "sim", "--yes", "--quick", "--repeats", "1", "--out", "out", "--json", "out.json"]
    told = subprocess.run(command(only(name, case), name, *words), cwd=folder, capture_output=True, text=True)
    assert told.returncode == 0, told.stdout + told.stderr
    facts = json.loads((folder / "out.json").read_text())
    assert (folder / "out" / name / "robot" / f"{name}.png").stat().st_size > 0
    (row,), (measured,) = facts["rows"], facts["runs"]
    assert row["runs"] == 1 and measured["seen_by"] == "/nermo/truth/odom" and measured["reached"]
    return facts


def test_a_leg_is_lifted_and_the_body_is_seen_to_tip(tmp_path: Path) -> None:
    """The rear left one without compensation: N's robot and both twins fall on it."""
    facts = played_alone("balance.Case('rear_left', False)", "balance", tmp_path)
    (row,) = facts["rows"]
    assert row["passed"] is row["twin_passed"] is row["thesis_robot_passed"] is False
    # In the graph the servos are told a little later than in process.
    assert row["up_s"] == pytest.approx(row["twin_up_s"], abs=0.2)
    assert row["sunk_mm"] == pytest.approx(row["twin_sunk_mm"], rel=0.2)


@pytest.mark.slow
def test_a_maze_is_steered_to_its_end(tmp_path: Path) -> None:
    """By the stand-in, which says what a stick says: the mouse itself is told no path."""
    facts = played_alone("maze.Case(True, maze.QUICK_LANES)", "maze", tmp_path)
    (row,) = facts["rows"]
    assert row["finished"] and row["cross_track_m"] < 0.1
    assert row["time_s"] == pytest.approx(row["twin_time_s"], rel=0.25)
