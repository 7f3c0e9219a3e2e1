"""Nermo walks on oscillators and on its own loads."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from nermo_control.types import ControlCommand
from nermo_sim.disturbance import NO_DISTURBANCE
from nermo_sim.experiments import footstep, push
from nermo_sim.experiments.coordination import Case, cases, recovery_time, step_scatter, table, walking_loop
from nermo_sim.experiments.runs import Job, Settings, standing_loop
from nermo_sim.loop import constant
from nermo_sim.run_table import Recording
from nermo_sim.twin import Twin

SETTINGS = Settings(repeats=1, quick=True, disturbance=NO_DISTURBANCE)
WALK = ControlCommand(0, forward_velocity=0.096, gait="trot", gait_frequency=0.8)


def walk(case: Case, seconds: float = 4.0) -> tuple[Recording, Twin]:
    loop, _ = standing_loop(Job(case, 0, SETTINGS))
    walking = walking_loop(loop.twin, case, SETTINGS, seed=0)
    return walking.run(constant(WALK), seconds), loop.twin


def travel(recording: Recording) -> float:
    return float(np.hypot(*(recording.position[-1, :2] - recording.position[0, :2])))


@pytest.mark.parametrize("loads", ["true", "estimated"])
def test_mouse_walks_on_its_loads(loads: str) -> None:
    recording, twin = walk(Case("tegotae", loads))
    assert twin.tilt() < 0.5
    assert travel(recording) > 0.2
    # The loads were heard: the legs no longer keep the clock.
    duties = np.mean(recording.phases == 0, axis=0)
    assert np.any(np.abs(duties - 0.5) > 0.01)
    scatter = step_scatter(recording, twin)
    assert scatter["step_m"] is not None and 0.03 < scatter["step_m"] < 0.2


def test_oscillators_in_step_walk_as_the_clock_does() -> None:
    cpg, _ = walk(Case("cpg"), 2.5)
    timed, _ = walk(Case("timed"), 2.5)
    assert travel(cpg) == pytest.approx(travel(timed), rel=0.02)
    assert np.mean(cpg.phases == timed.phases) > 0.98


def test_leg_that_fell_out_stays_folded() -> None:
    recording, _ = walk(Case("timed", missing_leg="rear_left"), 1.5)
    for servo in ("rear_left_hip", "rear_left_knee"):
        assert len(set(recording.commands[:, recording.servos.index(servo)].tolist())) == 1


def test_every_case_has_a_name_and_a_row() -> None:
    whole = cases(quick=False)
    assert len({case.key for case in whole}) == len(whole)
    result = {"speed_m_s": 0.08, "roll_sd_deg": 7.0, "pitch_sd_deg": 2.0, "step_m": 0.1, "step_sd_m": 0.01}
    runs = [{**result, "recovery_s": 0.5, "fell": False}, {**result, "recovery_s": None, "fell": True}]
    (row,) = table(whole[:1], SETTINGS, None, [runs])  # type: ignore[arg-type]
    assert row["recovery_s"] == 0.5 and row["recovered"] == 1 and row["fell"] and row["repeats"] == 2


def test_recovery_lasts_as_long_as_the_mouse_drifts_aside() -> None:
    recording, _ = walk(Case("timed"), 16.0)  # knees that comply need ten cycles until all are as those before
    assert recovery_time(recording, 12.0) == pytest.approx(0.0, abs=0.3)
    root = recording.root.copy()
    root[:, 1] += 0.2 * np.clip(recording.time - 12.0, 0.0, 1.0)
    assert recovery_time(replace(recording, root=root), 12.0) == pytest.approx(1.0, abs=0.1)
    root[:, 1] += 0.2 * np.maximum(recording.time - 15.0, 0.0)
    assert recovery_time(replace(recording, root=root), 12.0) is None


def test_footsteps_follow_a_shorter_step(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(footstep, "STEPS", 2)
    job = Job(footstep.Case("tegotae", 0), 0, SETTINGS)
    base, moved = (footstep.footsteps(job, 1.5, change) for change in (0.0, 0.02))
    assert base.shape == moved.shape == (4, 2)
    displacement = (moved - base).mean(axis=0)
    assert displacement[1] < displacement[0] < 0.005
    assert displacement[1] < -0.01


def test_fit_finds_slope_and_first_signs() -> None:
    rows = [
        {"controller": "cpg", "delta_m": delta, "step": step, "displacement_m": -0.8 * delta * step}
        for delta in (0.01, 0.02)
        for step in (1, 2, 3)
    ]
    rows[0]["displacement_m"] = 0.001
    found = footstep.fit(rows)["cpg"]
    assert found["slope"] == pytest.approx(-0.8, rel=0.05)
    assert 0.8 < found["r2"] < 1.0 and found["first_step_right"] == 0.5


def test_a_hard_push_throws_the_mouse_over_and_a_soft_one_does_not(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(push, "BEFORE", 3.5)
    monkeypatch.setattr(push, "AFTER", 2.5)
    pair = [push.Case("tegotae", "true", force) for force in (0.5, 12.0)]
    runs = [[push.run(Job(case, 0, SETTINGS))] for case in pair]
    soft, hard = push.table(pair, SETTINGS, None, runs)  # type: ignore[arg-type]
    assert soft["survived"] == 1 and hard["survived"] == 0
    assert hard["recovery_s"] is None and hard["largest_roll_deg"] > soft["largest_roll_deg"] + 20.0
