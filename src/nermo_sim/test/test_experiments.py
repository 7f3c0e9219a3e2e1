"""Experiments: what they measure on known motion, what they keep, and short real runs of each."""

from __future__ import annotations

import json
import math
import signal
import subprocess
import sys
from collections import Counter
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import mujoco
import numpy as np
import pytest
from rows_of_ones import rows_of_ones

from nermo_control.gait.knowledge_base import GaitParameters
from nermo_control.head import FRONT_SHARE
from nermo_control.path import Path as Way
from nermo_control.types import ControlCommand, SpineModes, TrajectoryMode
from nermo_description.model import build_model
from nermo_description.parameters import LEGS, RobotParameters
from nermo_sim.calibrate.numbers import variant
from nermo_sim.calibrate.trials import all_cases
from nermo_sim.experiments import balance, gaze, maze, straight_line, turning
from nermo_sim.experiments.claims import Claims, comparison, score, summary
from nermo_sim.experiments.claims.halves import CHECKED, FITTED, draw
from nermo_sim.experiments.losses import TERMS, stride_losses
from nermo_sim.experiments.orientation import orientation_noise
from nermo_sim.experiments.result_log import ResultLog
from nermo_sim.experiments.runs import Job, Settings, run_cases
from nermo_sim.loop import Loop, constant
from nermo_sim.run_table import Recording

QUICK = Settings(quick=True, repeats=1)
TICK = 5_000_000


def moving(positions: np.ndarray, angles: np.ndarray) -> Recording:
    """A recording of a body that goes where it is told, upright but for the given roll, pitch, yaw [rad]."""
    from scipy.spatial.transform import Rotation

    count = len(positions)
    quaternions = Rotation.from_euler("ZYX", angles[:, ::-1]).as_quat()[:, [3, 0, 1, 2]]
    empty = np.zeros((count, 0))
    return Recording(
        robot="none",
        servos=("spine_lateral",),
        stamps=np.arange(count, dtype=np.int64) * TICK,
        states=empty,
        root=np.hstack([positions, quaternions]),
        base_in_root=np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]),
        commands=np.zeros((count, 1)),
        servo_positions=np.zeros((count, 1)),
        servo_velocities=np.zeros((count, 1)),
        servo_torques=np.zeros((count, 1)),
        angular_velocity=np.zeros((count, 3)),
        linear_acceleration=np.zeros((count, 3)),
        foot_forces=np.zeros((count, 4)),
        phases=np.zeros((count, 4), dtype=np.int8),
    )


def test_orientation_noise_of_a_known_swing() -> None:
    time = np.arange(2001) * TICK * 1e-9
    roll = np.radians(1.0) + np.radians(4.0) * np.sin(2.0 * math.pi * 0.8 * time)
    noise = orientation_noise(moving(np.zeros((2001, 3)), np.stack([roll, 0.0 * roll, 0.0 * roll], axis=1)), 0.8)
    assert noise["roll_mean_deg"] == pytest.approx(1.0, abs=0.02)
    assert noise["roll_sd_deg"] == pytest.approx(4.0 / math.sqrt(2.0), rel=0.01)
    assert noise["roll_amplitude_deg"] == pytest.approx(4.0, rel=0.01)
    assert noise["yaw_sd_deg"] == pytest.approx(0.0, abs=1e-9)


def test_the_radius_is_found_in_spite_of_what_swings_with_the_gait() -> None:
    time = np.arange(4001) * TICK * 1e-9
    angle = 0.2 * time
    wobble = 0.3 + 0.01 * np.sin(2.0 * math.pi * 0.8 * time)
    points = np.stack([wobble * np.sin(angle), 0.3 - wobble * np.cos(angle)], axis=1)
    recording = moving(np.zeros((4001, 3)), np.zeros((4001, 3)))
    # The moving mean over 1.25 s cuts a chord's height off: r (1 - sin(a) / a), a = 0.125 rad.
    assert turning.fitted_radius(points, recording, 0.8) == pytest.approx(0.3 * math.sin(0.125) / 0.125, rel=2e-3)
    assert turning.fitted_radius(points[:300], recording.part(0.0, 1.49), 0.8) is None


def test_the_losses_account_for_the_whole_speed(robot: RobotParameters) -> None:
    loop = Loop.build(robot, GaitParameters())
    command = ControlCommand(
        0,
        forward_velocity=0.096,
        trajectory_mode=TrajectoryMode.STRAIGHT_LINE,
        gait="trot",
        gait_frequency=0.8,
        spine_modes=SpineModes(stride_extension=True, offset_compensation=True),
    )
    recording = loop.run(constant(command), 6.0)
    losses = stride_losses(recording, loop.twin.model, robot, 0.06, 1.25)
    lost = losses.steering + losses.legs + losses.pitch + losses.yaw + losses.slip + losses.contact
    assert losses.theory + losses.spine - lost == pytest.approx(losses.reached, abs=1e-9)
    # Over whole gait cycles the body goes on at the speed that the stances add up to: f_g g_f times the stride.
    cycles = recording.part(1.25, 1.25 + 3 * 1.25)
    way = np.hypot(*(cycles.position[-1] - cycles.position[0])[:2])
    assert losses.reached * 1.6 == pytest.approx(way / 3.75, rel=0.03)
    # What (5.32) says, less what the bent hip turns the rear legs off their way: 0.06 m (1 - cos 0.4) for two legs.
    assert losses.spine == pytest.approx(0.0157 - 0.5 * 0.06 * (1.0 - math.cos(0.4)), abs=0.0015)
    assert set(losses.as_speeds(1.6)) == {f"{name}_m_s" for name in ("theory", *TERMS, "reached")}


def test_a_soft_ankle_gives_way_and_a_pretensioned_knee_does_not(robot: RobotParameters) -> None:
    case = straight_line.Case("trot", 0.8, 0.06)
    stiff = variant(robot, {"rear_knee_rest": 1.5})
    soft = variant(robot, {"ankle_stiffness": 0.15, "rear_knee_rest": 2.0})
    stiffer, softer = (straight_line.run(Job(case, 0, replace(QUICK, variant=each))) for each in (stiff, soft))
    assert stiffer["rear_knee_yield_p95_deg"] < 1.0
    assert softer["rear_knee_yield_p95_deg"] > 2.0 * stiffer["rear_knee_yield_p95_deg"]
    assert softer["front_ankle_yield_mean_deg"] > 3.0 * stiffer["front_ankle_yield_mean_deg"]
    assert softer["front_ankle_yield_mean_deg"] <= softer["front_ankle_yield_p95_deg"]


# Real runs, short ones


def test_a_straight_run_gives_the_keys_of_its_row(robot: RobotParameters) -> None:
    case = straight_line.Case("trot", 0.8, 0.06, True, True)
    (row,) = straight_line.table([case], QUICK, robot, [[straight_line.run(Job(case, 0, QUICK))]])
    wanted = {"gait", "frequency_hz", "stride_m", "spine", "repeats", "speed_m_s", "speed_sd_m_s", "thesis_m_s", "fell"}
    assert wanted | {f"{axis}_sd_deg" for axis in ("roll", "pitch", "yaw")} <= set(row)
    assert row["theory_m_s"] == pytest.approx(0.12, rel=0.02)  # N 6.2.1
    assert 0.5 * row["theory_m_s"] < row["speed_m_s"] < row["theory_m_s"]
    assert row["fell"] is False
    json.dumps(row)


def test_an_arc_too_tight_for_the_strategy_is_not_followed() -> None:
    result = turning.run(Job(turning.Case("trot", 0.8, "spine", 0.25), 0, QUICK))
    assert (result["followed"], result["time_s"], result["ended"]) == (False, None, "too tight")


def test_full_lock_turns_left_within_a_body_length() -> None:
    result = turning.run(Job(turning.Case("trot", 0.8, "mix", turning.FULL_LOCK), 0, QUICK))
    assert result["followed"]
    assert 0.05 < result["radius_m"] < 0.2


@pytest.mark.parametrize("leg", ["front_left", "rear_right"])
@pytest.mark.parametrize("compensation", [False, True])
def test_the_balance_table_comes_out_as_the_thesis_has_it(leg: str, compensation: bool) -> None:
    case = balance.Case(leg, compensation)
    result = balance.run(Job(case, 0, QUICK))
    assert result["passed"] == balance.THESIS_PASSED[leg, compensation]
    assert sum(result["four_feet_forces_n"]) == pytest.approx(0.27 * 9.81, rel=0.05)


def test_a_mouse_too_heavy_in_front_fails_where_the_thesis_passes() -> None:
    front = [balance.Case("front_left", False)]
    assert balance.table_holds(QUICK, 0.0272, front)
    assert not balance.table_holds(QUICK, 0.045, front)


# What a rigid tail changes: the bands within which it may stand in for the chain


def with_either_tail(module: ModuleType, case: Any) -> tuple[Any, Any]:
    chain, rigid = (module.run(Job(case, 0, replace(QUICK, tail=tail))) for tail in ("chain", "rigid"))
    return chain, rigid


@pytest.mark.parametrize("spine", [False, True])
def test_a_rigid_tail_walks_as_the_chain_does(spine: bool) -> None:
    chain, rigid = with_either_tail(straight_line, straight_line.Case("trot", 0.8, 0.06, spine, spine))
    for quantity in ("speed_m_s", "roll_sd_deg", "pitch_sd_deg", "pitch_mean_deg"):
        assert rigid[quantity] == pytest.approx(chain[quantity], rel=0.02), quantity


def test_a_rigid_tail_turns_as_the_chain_does() -> None:
    chain, rigid = with_either_tail(turning, turning.Case("trot", 0.67, "mix", turning.FULL_LOCK))
    assert rigid["radius_m"] == pytest.approx(chain["radius_m"], rel=0.05)
    assert rigid["time_s"] == pytest.approx(chain["time_s"], rel=0.05)


def test_a_rigid_tail_stands_as_the_chain_does() -> None:
    chain, rigid = with_either_tail(balance, balance.Case("rear_left", True))
    assert rigid["passed"] == chain["passed"]
    assert rigid["four_feet_forces_n"] == pytest.approx(chain["four_feet_forces_n"], rel=0.03)


# The maze


def test_the_way_through_the_maze_keeps_clear_of_the_walls(robot: RobotParameters) -> None:
    model = build_model(robot, maze.SCENE)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("stand").id)
    mujoco.mj_forward(model, data)
    assert data.ncon == len(LEGS)  # no wall touches the standing mouse
    way = maze.maze_path((robot.hip_positions[0][0], 0.0, 0.0))
    assert way.length == pytest.approx(5.0, abs=0.05)  # N 6.2.4: time times speed
    walls = [number for number in range(model.ngeom) if model.geom(number).name.startswith("scene_")]
    walls = [number for number in walls if model.geom_type[number] == mujoco.mjtGeom.mjGEOM_BOX]
    assert len(walls) == 7
    nearest = min(clearance(way, model.geom_pos[wall], model.geom_size[wall]) for wall in walls)
    assert nearest > 0.15


def clearance(way: Way, centre: np.ndarray, size: np.ndarray) -> float:
    points = np.array([way.pose(0.01 * step)[:2] for step in range(int(way.length / 0.01))])
    beyond = np.maximum(np.abs(points - centre[:2]) - size[:2], 0.0)
    return float(np.hypot(*beyond.T).min())


# What is kept, and what is made of it


def counted(job: Job[balance.Case]) -> dict[str, int]:
    log = Path(job.case.leg)
    log.write_text(log.read_text() + "x")
    return {"repeat": job.repeat}


def test_runs_that_are_in_the_log_are_not_run_again_and_a_cut_off_one_is(tmp_path: Path) -> None:
    counter = tmp_path / "count"
    counter.write_text("")
    settings, cases = Settings(repeats=2), [balance.Case(str(counter), True)]
    log = tmp_path / "log" / "runs.jsonl"
    first = run_cases(counted, cases, settings, "test", log, workers=1)
    assert counter.read_text() == "xx"
    log.write_text(log.read_text()[:-20])  # as a kill in the middle of a write leaves it
    assert run_cases(counted, cases, settings, "test", log, workers=1) == first
    assert counter.read_text() == "xxx"
    run_cases(counted, cases, replace(settings, seed=1), "test", log, workers=1)
    assert counter.read_text() == "xxxxx"
    assert len(ResultLog(log, settings.digest("test"))._results) == 2


KILLED = """
import json, os, signal, sys
from pathlib import Path
from nermo_sim.experiments import gaze
from nermo_sim.experiments.runs import Settings, run_cases

def die(done, total):
    if done == int(sys.argv[2]):
        os.kill(os.getpid(), signal.SIGKILL)

gaze.QUICK_DURATION = 3.0
settings = Settings(quick=True, repeats=2, seed=4)
results = run_cases(gaze.run, gaze.cases()[:2], settings, "gaze", Path(sys.argv[1]), workers=1, progress=die)
print(json.dumps(results))
"""


def test_an_experiment_killed_in_the_middle_goes_on_to_the_same_result(tmp_path: Path) -> None:
    """SIGKILL for real, twice: nothing that was finished runs again, and the end is that of a run left in peace."""

    def run(log: str, die_after: int) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-c", KILLED, str(tmp_path / log), str(die_after)]
        return subprocess.run(command, capture_output=True, text=True, check=False)

    log = tmp_path / "killed.jsonl"
    for finished in (1, 3):
        assert run(log.name, finished).returncode == -signal.SIGKILL
        assert log.read_bytes().count(b"\n") == finished
    before = log.read_bytes()
    resumed, undisturbed = run(log.name, -1), run("whole.jsonl", -1)
    assert json.loads(resumed.stdout) == json.loads(undisturbed.stdout), resumed.stderr + undisturbed.stderr
    assert log.read_bytes().startswith(before)
    keys = [json.loads(line)["key"] for line in log.read_text().splitlines()]
    assert len(keys) == len(set(keys)) == 4


def test_the_neck_holds_the_cameras_still(robot: RobotParameters) -> None:
    runs = [[gaze.run(Job(case, 0, QUICK))] for case in gaze.cases()]
    off, spine, imu = gaze.table(gaze.cases(), QUICK, robot, runs)
    assert [row["gaze"] for row in (off, spine, imu)] == ["off", "spine", "imu"]
    assert off["head_yaw_sd_deg"] == pytest.approx(off["body_yaw_sd_deg"], rel=0.05)
    assert spine["head_yaw_sd_deg"] < 0.3 * off["head_yaw_sd_deg"]
    assert imu["head_yaw_sd_deg"] < 0.1 * off["head_yaw_sd_deg"]
    assert off["front_share"] == pytest.approx(FRONT_SHARE, abs=0.03)


def test_claims_know_what_is_within_and_leave_out_what_is_missing() -> None:
    claims = Claims()
    topic = claims.about("trot speed")
    topic.number("a", 2.0, 2.2, (0.85, 1.15))
    topic.number("b", 2.0, 2.4, (0.85, 1.15))
    topic.number("c", 1.22, 1.16, (0.85, 1.15), of_ours=(1.15, 1.30))
    topic.number("d", 2.0, None, (0.85, 1.15))
    topic.number("e", 2.0, math.nan, (0.85, 1.15))
    topic.words("f", lambda: False)
    topic.words("g", lambda: None < 0)  # type: ignore[operator]
    assert [(row["claim"], row["within"]) for row in claims.rows] == [
        ("a", True),
        ("b", False),
        ("c", True),
        ("f", False),
    ]


def test_only_what_the_thesis_s_twin_and_robot_claim_is_counted_and_the_halves_apart() -> None:
    claims = Claims()
    for topic, kind, holds in (
        ("trot speed", "twin", True),
        ("mean pitch", "twin", False),
        ("speed", "robot", True),
        ("no-slip speed", "theory", True),
        ("gaze", "own", True),
    ):
        claims.about(topic, kind).words(topic, lambda holds=holds: holds)
    assert [row["half"] for row in claims.rows] == ["fitted", "checked", None, None, None]
    counts = {name: (count["within"], count["of"]) for name, count in score(claims.rows).items()}
    assert counts["headline"] == (2, 3)
    assert (counts["twin, fitted"], counts["twin, checked"]) == ((1, 1), (0, 1))


def test_a_topic_that_was_never_drawn_belongs_to_no_half() -> None:
    with pytest.raises(ValueError, match="'mood' is in neither half"):
        Claims().about("mood")


def test_the_halves_are_those_that_the_seed_gives() -> None:
    """Of rows of ones, which have a value for every claim."""
    facts = rows_of_ones(all_cases())
    topics = Counter(row["topic"] for row in summary(facts) if row["kind"] == "twin")
    halves = draw(topics)
    assert (set(halves["fitted"]), set(halves["checked"])) == (FITTED, CHECKED)


def test_the_summary_of_the_thesis_s_own_numbers_is_all_within() -> None:
    """Rows filled with N's values where it prints any: every number among the claims must then be right."""
    noise = {f"{a}_{k}_deg": 1.0 for a in ("roll", "pitch", "yaw") for k in ("mean", "sd", "amplitude")}

    def walk(gait: str, frequency: float, spine: bool, speed: float, theory: float, stride: float = 0.06) -> dict:
        names = {"gait": gait, "frequency_hz": frequency, "stride_m": stride, "spine": spine, "fell": False}
        values = {
            "offset_compensation": spine,
            "speed_m_s": speed,
            "theory_m_s": theory,
            "losses": None,
            "cycles": None,
        }
        return {**names, **values, **noise}

    facts = {
        "straight-line": {
            "rows": [
                walk("trot", 0.8, False, 0.0864, 0.096),
                walk("trot", 0.8, True, 0.1054, 0.12),
                walk("trot", 0.8, True, 0.019, 0.024, 0.0),
                walk("lateral_walk", 0.8, False, 0.068, 0.0706),
            ]
        },
        "turning": {"rows": []},
        "balance": {
            "rows": [
                {"leg": leg, "compensation": on, "passed": passed, "thesis_passed": passed, "pitch_deg": 1.0}
                | {"ground_impact_s": None}
                | {"four_feet_forces_n": [0.7] * 4, "foot_forces_n": [1.0, 0.1, 0.0, 1.0]}
                for (leg, on), passed in balance.THESIS_PASSED.items()
            ],
            "com_interval_m": [0.02, 0.03],
        },
        "maze": {
            "rows": [
                {"spine": on, "finished": True, **values, **{f"thesis_{name}": value for name, value in values.items()}}
                for on, values in maze.THESIS.items()
            ]
        },
    }
    rows = {row["claim"]: row["within"] for row in summary(facts)}
    assert all(
        rows[claim] for claim in rows if claim.startswith(("speed of", "no-slip", "maze", "balance: ", "trot over"))
    )
    assert len([claim for claim in rows if claim.startswith("balance: ")]) == 8
    table = {row["quantity"]: row["ratio"] for row in comparison(facts)}
    assert table["maze, spine [s]"] == 1.0
    assert table["balance cells as in the thesis's twin"] == 1.0
