"""The straight-line experiment: resumable, repeatable, with the thesis's order of the gaits."""

from __future__ import annotations

import contextlib
import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from matplotlib.collections import QuadMesh
from matplotlib.figure import Figure

from nermo_control.gait.knowledge_base import GaitParameters
from nermo_description.parameters import LEGS, RobotParameters
from nermo_sim.experiments import straight_line
from nermo_sim.experiments.result_log import ResultLog, seed_for
from nermo_sim.experiments.runs import Job, Progress, Settings, run_cases
from nermo_sim.experiments.straight_line import STRIDE, Case, cases, measure, theory
from nermo_sim.plots import draw_gait, plot_run, plot_speeds
from nermo_sim.render import RenderingUnavailableError, save_picture, save_video
from nermo_sim.run_table import Recording
from nermo_sim.twin import Twin

SHORT = Settings(distance=0.15, repeats=1)


def run_table(robot: RobotParameters, table: list[Case], log: Path, progress: Progress | None = None) -> list[dict]:
    results = run_cases(straight_line.run, table, SHORT, "straight-line", log, 1, progress)
    return straight_line.table(table, SHORT, robot, results)


def test_theory_is_the_thesis_s(robot: RobotParameters) -> None:
    parameters = GaitParameters()
    assert theory(Case("trot", 0.8, STRIDE), parameters, robot) == pytest.approx(0.096)
    assert theory(Case("trot", 0.8, STRIDE, True), parameters, robot) == pytest.approx(0.12, rel=0.02)
    assert theory(Case("trot", 0.8, 0.0), parameters, robot) == 0.0
    slower = [theory(Case(gait, 0.8, STRIDE), parameters, robot) for gait in straight_line.GAITS]
    assert slower == sorted(slower, reverse=True)


def test_table_covers_the_thesis_s_axes() -> None:
    table = cases()
    assert {case.gait for case in table} == {"trot", "walking_trot", "lateral_walk"}
    assert {case.frequency_hz for case in table} == {0.5, 0.67, 0.8}
    strides = {case.stride_m / STRIDE for case in table if case.gait == "trot" and case.frequency_hz == 0.8}
    assert sorted(strides) == pytest.approx([0.0, 0.5, 0.8, 1.0])
    assert len(set(table)) == len(table)


def test_trot_walks_near_the_thesis_and_the_gaits_keep_their_order() -> None:
    settings = Settings(distance=0.5, repeats=1)
    speeds = {
        gait: straight_line.run(Job(Case(gait, 0.8, STRIDE), 0, settings))["speed_m_s"] for gait in straight_line.GAITS
    }
    assert speeds["trot"] == pytest.approx(0.086, rel=0.15)
    assert speeds["trot"] > speeds["walking_trot"] > speeds["lateral_walk"]


def test_each_run_has_a_seed_of_its_own_that_never_changes() -> None:
    seeds = {seed_for(seed, case.key, repeat) for seed in (0, 1) for case in cases() for repeat in range(3)}
    assert len(seeds) == 2 * 3 * len(cases())
    assert seed_for(0, "a", 1) == seed_for(0, "a", 1)


def test_same_seed_same_result() -> None:
    job = Job(Case("trot", 0.8, STRIDE), 1, SHORT)
    assert straight_line.run(job) == straight_line.run(job)
    other = dataclasses.replace(job, settings=dataclasses.replace(SHORT, seed=1))
    assert straight_line.run(job) != straight_line.run(other)


def test_a_stopped_experiment_goes_on_where_it_was(robot: RobotParameters, tmp_path: Path) -> None:
    table, log = [Case("trot", 0.8, STRIDE), Case("trot", 0.8, 0.03)], tmp_path / "runs.jsonl"
    first = run_table(robot, table[:1], log)
    calls: list[tuple[int, int]] = []
    rows = run_table(robot, table, log, lambda done, total: calls.append((done, total)))
    assert calls == [(1, 2), (2, 2)]
    assert rows[0] == first[0]
    assert len(log.read_text().splitlines()) == 2
    assert rows[1]["speed_m_s"] < rows[0]["speed_m_s"]
    assert rows[0]["thesis_m_s"] == 0.086
    assert rows[1]["thesis_m_s"] is None
    assert not rows[0]["fell"]


def test_results_of_another_configuration_are_not_used(tmp_path: Path) -> None:
    log = ResultLog(tmp_path / "runs.jsonl", "one")
    log.add("a", {"x": 1.0})
    assert ResultLog(tmp_path / "runs.jsonl", "one")["a"] == {"x": 1.0}
    assert "a" not in ResultLog(tmp_path / "runs.jsonl", "two")
    assert SHORT.digest("a") != dataclasses.replace(SHORT, distance=0.2).digest("a")
    assert SHORT.digest("a") == dataclasses.replace(SHORT, repeats=3).digest("a")
    assert SHORT.digest("a") != SHORT.digest("b")


def test_a_log_that_was_cut_off_is_read_up_to_the_cut_and_goes_on(tmp_path: Path) -> None:
    path = tmp_path / "runs.jsonl"
    ResultLog(path, "one").add("a", 1)
    with path.open("a") as file:
        file.write('{"configuration": "one", "key": "b", "res')
    log = ResultLog(path, "one")
    assert "b" not in log
    log.add("c", 3)
    again = ResultLog(path, "one")
    assert (again["a"], again["c"]) == (1, 3)
    assert json.loads(path.read_text().splitlines()[-1])["key"] == "c"


@pytest.fixture(scope="module")
def walked() -> tuple[Recording, Twin]:
    return straight_line.walk(Job(Case("trot", 0.8, STRIDE), 0, SHORT))


@pytest.fixture(scope="module")
def recording(walked: tuple[Recording, Twin]) -> Recording:
    return walked[0]


def test_measured_speed_is_the_way_over_the_time(recording: Recording) -> None:
    result = measure(recording, 0.8)
    assert result["distance_m"] == pytest.approx(0.15, abs=0.005)
    assert result["speed_m_s"] == pytest.approx(result["distance_m"] / recording.time[-1])
    assert abs(result["lateral_drift_m"]) < 0.03


def test_pictures_are_drawn(walked: tuple[Recording, Twin], tmp_path: Path) -> None:
    recording, twin = walked
    row = {"gait": "trot", "spine": False, "offset_compensation": False, "stride_m": 0.06, "repeats": 5}
    row |= {"speed_m_s": 0.09, "speed_sd_m_s": 0.001}
    rows = [{**row, "frequency_hz": f, "theory_m_s": 0.12 * f, "thesis_m_s": None} for f in (0.5, 0.8)]
    plot_run(recording, tmp_path / "run.png", "a run")
    plot_speeds(rows, tmp_path / "speed.png")
    with contextlib.suppress(RenderingUnavailableError):  # the one way in which a machine without OpenGL says so
        save_picture(tmp_path / "mouse.png", twin.model, recording.states[-1])
        save_video(tmp_path / "mouse.mp4", twin.model, recording.part(0.0, 0.2))
        assert (tmp_path / "mouse.mp4").read_bytes()[4:8] == b"ftyp"
        assert (tmp_path / "mouse.png").stat().st_size > 5000
    assert (tmp_path / "run.png").stat().st_size > 5000
    assert (tmp_path / "speed.png").stat().st_size > 5000


def test_an_empty_recording_makes_no_video(walked: tuple[Recording, Twin], tmp_path: Path) -> None:
    recording, twin = walked
    with pytest.raises(ValueError, match="empty"):
        save_video(tmp_path / "mouse.mp4", twin.model, recording.part(2.0, 1.0))


def test_lines_join_runs_of_one_kind_and_single_runs_have_no_error_bars(tmp_path: Path) -> None:
    row = {"gait": "trot", "stride_m": 0.07, "thesis_m_s": None, "theory_m_s": 0.1, "repeats": 1, "speed_sd_m_s": 0.0}
    rows = [
        {
            **row,
            "frequency_hz": frequency,
            "spine": spine,
            "offset_compensation": offsets,
            "speed_m_s": 0.05 + frequency,
        }
        for frequency in (0.4, 0.8)
        for spine, offsets in ((False, False), (True, False), (True, True))
    ]
    drawn: list[Figure] = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Figure, "savefig", lambda figure, *_, **__: drawn.append(figure))
        plot_speeds(rows, tmp_path / "speeds.png")
        plot_speeds([{**one, "repeats": 5, "speed_sd_m_s": 0.01} for one in rows], tmp_path / "speeds.png")
    single, repeated = (figure.axes[0] for figure in drawn)
    names = [text.get_text() for text in single.get_legend().get_texts()]
    assert names == ["trot, spine off", "trot, spine on", "trot, spine with offsets"]
    for line in single.lines:
        places = list(line.get_xdata())
        assert len(places) == len(set(places)), "a line goes straight up"
    assert not [bars for container in single.containers for bars in container[2]]
    assert len([bars for container in repeated.containers for bars in container[2]]) == 3


def test_a_gait_diagram_shows_how_much_a_foot_carries_and_a_bounce_as_what_it_is() -> None:
    time = np.arange(0.0, 1.0, 0.01)
    load = np.full((len(time), 4), 1.0)
    load[50:53, 2] = 0.0
    axes = Figure().subplots()
    draw_gait(axes, time, np.ones((len(time), 4), bool), load)
    bars = [mesh for mesh in axes.collections if isinstance(mesh, QuadMesh)]
    np.testing.assert_array_equal(np.array([bar.get_array()[0] for bar in bars]).T, load)
    # All four together carry 4 N nearly all the time.
    assert [bar.get_clim()[1] for bar in bars] == [pytest.approx(2.0, rel=0.01)] * 4
    assert [label.get_text() for label in axes.get_yticklabels()] == [leg.replace("_", " ") for leg in LEGS]
