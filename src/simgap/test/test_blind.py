"""The blind check: a truth of its own, answers that stay sealed, a score that counts right, and six cases of it."""

from __future__ import annotations

import functools
import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from simgap.analysis.isolability import angle_matrix
from simgap.blind.cases import SMALL, Case, draw, robot_of
from simgap.blind.faults.base import Fault, Scale
from simgap.blind.faults.table import FAULTS, UNKNOWN
from simgap.blind.imitate import nominal_numbers
from simgap.blind.make import BlindError, make
from simgap.blind.recordings import simulate, told
from simgap.blind.reliability import reliability, table
from simgap.blind.run import Plan, experiment_file, read_results, run
from simgap.blind.score import confusion, judged, metrics, rate, score
from simgap.blind.settle import settle
from simgap.blind.sites import sites
from simgap.blind.stand import Stand
from simgap.blind.truth import PERIOD, Link, Run, Soft, Truth, build, record
from simgap.effects.library import effect_classes

Array = NDArray[np.float64]

SMALL_CHECK = 34
"""A seed that gives six cases of all four kinds."""


def test_the_truth_shares_no_code_with_the_library() -> None:
    code = (
        "import sys, simgap.blind.cases, simgap.blind.make\n"
        "diagnosing = ('data', 'simulation', 'effects', 'inference', 'analysis', 'report')\n"
        "print([m for m in sys.modules if m.startswith(tuple(f'simgap.{d}' for d in diagnosing))])"
    )
    path = os.pathsep.join(p for p in sys.path if p)
    out = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env=os.environ | {"PYTHONPATH": path}
    )
    assert out.stdout.strip() == "[]", out.stderr


def test_every_fault_has_a_name_that_the_library_knows_and_the_unknown_ones_have_none() -> None:
    names = {f.name for f in FAULTS}
    assert names <= set(effect_classes())
    # What else the library has is there for real recordings: clocks differ, trackers stand on the slope, servos are
    # switched off (no robot of the check is, so it is offered for none; see test_switched_servos.py).
    assert set(effect_classes()) - names <= {"clock_offset", "gravity_lean", "servo_damping"}
    assert not names & {f.name for f in UNKNOWN} and not set(effect_classes()) & {f.name for f in UNKNOWN}


# -- the truth ---------------------------------------------------------------------------------------------------------


def _truth(robot: str = "arm", soft: dict[str, Soft | Stand] | None = None, spread: float = 0.0) -> Truth:
    chosen = robot_of(robot)
    between = (spread and 0.05, spread)
    return build(chosen.spec(), chosen.mapping, np.random.default_rng(1), soft, between, chosen.start)


def _commands(truth: Truth, robot: str = "arm", seconds: float = 1.5) -> Array:
    chosen = robot_of(robot)
    return told(truth.model, chosen.mapping, chosen.commands(3, int(seconds / PERIOD)))


def _run(truth: Truth, robot: str = "arm", seconds: float = 1.5) -> Run:
    return record(truth, _commands(truth, robot, seconds), {}, np.random.default_rng(0))


def _shift(one: Run, two: Run) -> float:
    return float(np.mean([np.abs(one.columns[c] - two.columns[c]).mean() for c in one.columns]))


@functools.cache
def _healthy(robot: str) -> tuple[Run, Scale]:
    truth = _truth(robot)
    run = _run(truth, robot)
    return run, Scale.of(truth, run, _commands(truth, robot))


_ON = {"cable": "finger", "sprung": "finger", "foot": "leg", "axes": "camera"}


@pytest.mark.parametrize(
    "fault",
    [f for f in (*FAULTS, *UNKNOWN) if f.kind not in ("play", "flexing", "elastic", "mounted", "ground", "strap")],
    ids=lambda f: f"{f.name}-{f.kind}",
)
def test_every_fault_changes_the_recording_and_more_when_it_is_stronger(fault: Fault) -> None:
    name = _ON.get(fault.kind, "arm")
    robot, (healthy, scale) = robot_of(name), _healthy(name)
    member = sites(robot.spec().compile(), robot.mapping)[fault.kind][-1].members[-1]
    moved = []
    for size in (fault.sizes[0], fault.sizes[2]):
        truth = _truth(name)
        fault.inject(truth, scale, member, size)
        moved.append(_shift(_run(truth, name), healthy))
    assert 0 < moved[0] <= moved[1]
    assert moved[1] > 3e-4


def test_a_horn_slips_once_in_mid_run_and_stays_where_it_is() -> None:
    truth, (healthy, scale) = _truth(), _healthy("arm")
    slipped = next(f for f in UNKNOWN if f.name == "slipped_horn")
    assert slipped.inject(truth, scale, "shoulder_servo", 0.2) == {}
    off = np.abs(_run(truth).columns["q0"] - healthy.columns["q0"])
    assert off[: round(0.3 * len(off))].max() < 1e-9
    jump = 0.2 * scale.swing[truth.model.actuator("shoulder_servo").id]
    assert np.median(off[round(0.85 * len(off)) :]) == pytest.approx(jump, rel=0.3)


def test_a_play_joint_is_loose_by_its_width_and_a_flexing_link_hides() -> None:
    healthy = _run(_truth())
    loose = _run(_truth(soft={"elbow": Soft(width=0.1)}))
    tight = _run(_truth(soft={"elbow": Soft(width=0.002)}))
    assert _shift(tight, healthy) < 0.2 * _shift(loose, healthy)
    assert 0.03 < np.abs(loose.columns["q1"] - healthy.columns["q1"]).max() < 0.3
    stiff, soft = (_run(_truth(soft={"elbow": Soft(stiffness=k)})) for k in (5e3, 10.0))
    assert _shift(stiff, healthy) < 0.3 * _shift(soft, healthy)


@pytest.mark.parametrize("robot", ["arm", "camera"])
def test_a_stand_tilts_as_far_as_its_fault_says_and_a_stiff_one_not(robot: str) -> None:
    base = sites(robot_of(robot).spec().compile(), robot_of(robot).mapping)["mounted"][0].name
    scale = _healthy(robot)[1]
    healthy = _truth(robot)
    stiff, soft = (_run(_truth(robot, {base: Stand(k)}), robot) for k in (np.float64(2e3), 20.0))
    assert _shift(stiff, _healthy(robot)[0]) < 0.1 * _shift(soft, _healthy(robot)[0])
    truth = _truth(robot, {base: Stand(20.0)})
    compliance = next(f for f in FAULTS if f.name == "soft_mount").inject(truth, scale, base, 0.0)["compliance"]
    # Its joints held.
    truth.model.dof_damping[:2] *= 10.0
    truth.model.dof_damping[2:] = 1e5
    data = mujoco.MjData(truth.model)
    data.qpos[2:] = 0.3
    mujoco.mj_step(truth.model, data, 4000)
    lever = data.subtree_com[2] - data.xpos[1]
    moment = np.cross(lever, truth.model.body_subtreemass[2] * truth.model.opt.gravity)
    np.testing.assert_allclose(data.qpos[:2], compliance * moment[:2], rtol=0.2, atol=2e-4)
    assert truth.model.nbody == healthy.model.nbody + 1
    assert truth.kp.tolist() == healthy.kp.tolist(), "a stand changes no number of the robot's"


def test_a_stand_is_no_number_that_a_healthy_robot_may_be_off_by() -> None:
    plain, standing = _truth("camera"), _truth("camera", {"column": Stand(20.0)})
    assert len(nominal_numbers(standing)) == len(nominal_numbers(plain))


def test_a_link_that_flexes_like_a_stand_is_no_unknown_fault() -> None:
    """Where its joint is the only one between the world and the robot, and tilts it."""
    of = {name: [s.name for s in sites(r.spec().compile(), r.mapping)["flexing"]] for name, r in _ROBOTS.items()}
    assert of == {"pendulum": [], "arm": ["elbow_servo"], "camera": ["pan_servo", "tilt_servo", "roll_servo"]}
    mounted = {n: [s.name for s in sites(r.spec().compile(), r.mapping)["mounted"]] for n, r in _ROBOTS.items()}
    assert mounted == {"pendulum": [], "arm": ["upper"], "camera": ["column"]}


_ROBOTS = {name: robot_of(name) for name in ("pendulum", "arm", "camera")}


def test_a_link_that_is_late_and_loses() -> None:
    truth = _truth()
    truth.link = Link(latency=0.02)
    late, healthy = _run(truth), _run(_truth())
    np.testing.assert_allclose(late.columns["q0"][200:], healthy.columns["q0"][196:-4], atol=2e-3)
    truth.link = Link(loss=1.0)
    assert np.ptp(_run(truth).columns["q0"][200:]) < 1e-2


def test_a_late_link_s_answer_is_what_the_robot_waits() -> None:
    """It takes up what has arrived at its next tick."""
    truth = _truth()
    fault = next(f for f in FAULTS if f.name == "link_latency")
    answer = fault.inject(truth, _healthy("arm")[1], "all", 0.021)
    ticks = round(answer["delay"] / PERIOD)
    late, healthy = _run(truth), _run(_truth())
    np.testing.assert_allclose(late.columns["q0"][200:], healthy.columns["q0"][200 - ticks : -ticks], atol=2e-3)


@pytest.mark.parametrize(("begin", "end"), [(-1.0, "upper"), (0.95, "lower")])
def test_a_robot_begins_on_the_free_side_of_a_stop(begin: float, end: str) -> None:
    truth, scale = _truth(), _healthy("arm")[1]
    moved = replace(scale, low={"elbow": -1.0}, high={"elbow": 1.0}, begin={"elbow": begin})
    fault = next(f for f in FAULTS if f.name == "joint_range")
    answer = fault.inject(truth, moved, "elbow", 0.25)
    assert answer == {end: pytest.approx(0.5 if end == "upper" else -0.5)}
    place = truth.addresses("elbow")[0]
    data = mujoco.MjData(truth.model)

    def pushed(angle: float) -> float:
        data.qpos[place], data.qfrc_applied[:] = angle, 0.0
        truth.forces[-1](data)
        return float(data.qfrc_applied[truth.dof("elbow")])

    (limit,) = answer.values()
    assert pushed(begin) == 0.0
    beyond = 0.01 if end == "upper" else -0.01
    assert pushed(limit - beyond) == 0.0
    assert pushed(limit + beyond) * beyond < 0.0


def test_numbers_are_off_by_five_to_ten_percent() -> None:
    ratio = _truth(spread=0.10).kp / _truth().kp
    assert ((np.abs(ratio - 1) >= 0.05 - 1e-9) & (np.abs(ratio - 1) <= 0.10 + 1e-9)).all()


# -- the cases ---------------------------------------------------------------------------------------------------------


def test_cases_depend_on_seed_and_number_and_come_in_their_shares() -> None:
    one, two = draw(200, 5), draw(200, 5)
    assert [c.answer() for c in one] == [c.answer() for c in two] != [c.answer() for c in draw(200, 6)]
    kinds = [c.kind for c in one]
    assert [kinds.count(k) for k in ("none", "single", "pair", "unknown")] == [40, 100, 30, 30]
    singles = {f.name for c in one if c.kind == "single" for f in c.faults}
    assert singles == {f.name for f in FAULTS}
    assert {c.robot for c in one} == set(SMALL)


def test_cases_may_be_of_chosen_effects_alone(tmp_path: Path) -> None:
    chosen = ("soft_mount", "tendon_slack")
    cases = draw(18, 5, ("pendulum", "finger", "quad"), only=chosen)
    assert {c.kind for c in cases} == {"single"}
    levels = [(f.name, f.kind, f.level) for c in cases for f in c.faults]
    assert {name for name, _, _ in levels} == set(chosen)
    # Those of one level and kind of site come as often as the others, within one.
    counts = [levels.count(level) for level in set(levels)]
    assert max(counts) - min(counts) <= 1
    with pytest.raises(BlindError, match=r"fault 'soft_table' is unknown: choose of .*soft_mount"):
        make(tmp_path / "check", tmp_path / "answers", 1, 5, ("pendulum",), 6.0, only=("soft_table",))
    with pytest.raises(BlindError, match=r"fault 'tendon_slack': none of pendulum, camera can have it"):
        make(tmp_path / "check", tmp_path / "answers", 1, 5, ("pendulum", "camera"), 6.0, only=("tendon_slack",))


def test_the_same_case_gives_the_same_bytes() -> None:
    one, two = (simulate(Case("000", "pendulum", "none", (1, 2), 6.0, [])) for _ in range(2))
    assert all(np.array_equal(one.columns[c], two.columns[c]) for c in one.columns)


@pytest.mark.long
def test_a_small_check_is_made_diagnosed_and_scored(tmp_path: Path) -> None:
    """Six sealed cases from end to end, each diagnosed by a process of its own with the whole library."""
    folder, answers, out = tmp_path / "check", tmp_path / "sealed", tmp_path / "results"
    make(folder, answers, 6, seed=SMALL_CHECK, robots=("pendulum", "cart_pole"), seconds=6.0, workers=2)
    found = run(folder, out, Plan(workers=2, threads=1, baselines=False, answers=[answers]))
    assert {row["status"] for row in found.values()} == {"done"}
    scored = score(folder, answers, out)
    wrong = [(r["truth"], r["verdict"], r["found"]) for r in scored["cases"] if not r["correct"]]
    assert scored["scored"] == 6 and {r["kind"] for r in scored["cases"]} == {"none", "single", "pair", "unknown"}
    assert len(wrong) <= 1 and scored["false_alarms"]["value"] == 0.0, wrong
    asked = [i for i, row in found.items() if row["verdict"] == "ambiguous" and experiment_file(out, i).exists()]
    if asked:
        again = tmp_path / "next"
        assert settle(folder, answers, out, again) == asked
        assert all(len(list((again / "data" / i).glob("recording*.npz"))) == 2 for i in asked)
        settled = run(again, tmp_path / "settled", Plan(asked[:1], threads=1, baselines=False, answers=[answers]))
        assert settled[asked[0]]["status"] == "done"
    else:
        with pytest.raises(BlindError, match="no ambiguous case"):
            settle(folder, answers, out, tmp_path / "next")
    (answers / "000.json").write_text("{}")
    with pytest.raises(BlindError, match="not the answer that was sealed"):
        score(folder, answers, out)


def test_results_of_another_check_are_neither_gone_on_with_nor_scored(tmp_path: Path) -> None:
    folder, answers, out = tmp_path / "check", tmp_path / "sealed", tmp_path / "results"
    manifest = make(folder, answers, 1, seed=3, robots=("pendulum",), seconds=6.0)
    out.mkdir()
    row = {"id": "000", "status": "done", "verdict": "no_gap", "robot": "pendulum"}
    lines = out / "results.jsonl"
    lines.write_text(json.dumps(row | {"recording_sha256": "0" * 64}) + "\n", encoding="utf-8")
    with pytest.raises(BlindError, match="case 000 is of another check"):
        run(folder, out, Plan())
    with pytest.raises(BlindError, match="case 000 is of another check"):
        score(folder, answers, out)
    own = manifest["cases"][0]["recording_sha256"]
    lines.write_text(json.dumps(row | {"recording_sha256": own}) + "\n", encoding="utf-8")
    assert score(folder, answers, out)["scored"] == 1


def test_a_make_that_is_interrupted_goes_on_where_it_was(tmp_path: Path) -> None:
    def made(name: str, stop: int | None = None) -> dict[str, Any]:
        def told(done: int, count: int) -> None:
            if done == stop:
                raise KeyboardInterrupt

        folder = tmp_path / name
        return make(folder, tmp_path / f"{name}-answers", 5, 8, ("pendulum",), 6.0, salt="s", progress=told)

    def files(name: str) -> dict[str, bytes]:
        """All but the manifest, which says when it was made."""
        places = (tmp_path / name, tmp_path / f"{name}-answers")
        found = {str(f.relative_to(place)): f.read_bytes() for place in places for f in place.rglob("*") if f.is_file()}
        return {file: data for file, data in found.items() if file != "manifest.json"}

    whole = made("whole")
    with pytest.raises(KeyboardInterrupt):
        made("cut", stop=3)
    kept = tmp_path / "cut" / "data" / "001" / "recording.npz"
    before = kept.stat().st_mtime_ns
    # A case whose answer was not written to its end is made anew.
    answer = tmp_path / "cut-answers" / "002.json"
    answer.write_bytes(answer.read_bytes()[:40])
    again = made("cut")
    assert kept.stat().st_mtime_ns == before
    assert again["cases"] == whole["cases"] and files("cut") == files("whole")
    with pytest.raises(BlindError, match="already exists"):
        made("cut")


def test_a_check_that_was_begun_is_not_mixed_with_another(tmp_path: Path) -> None:
    def make_one(seed: int, progress: Any = None) -> None:
        make(tmp_path / "check", tmp_path / "answers", 2, seed, ("pendulum",), 6.0, progress=progress)

    def cut(done: int, count: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        make_one(1, cut)
    with pytest.raises(BlindError, match="begin of another check"):
        make_one(2)
    # Nor with answers of which nothing says what was asked.
    (tmp_path / "answers" / "asked.json").unlink()
    with pytest.raises(BlindError, match="begin of another check"):
        make_one(1)


@pytest.mark.long
def test_an_interrupted_run_ends_at_once_and_keeps_what_is_done(tmp_path: Path) -> None:
    folder, answers, out = tmp_path / "check", tmp_path / "sealed", tmp_path / "results"
    make(folder, answers, 6, seed=SMALL_CHECK, robots=("pendulum",), seconds=6.0, workers=2)
    # A shell starts what runs in the background deaf to SIGINT, this test perhaps with it.
    command = ["env", "--default-signal=INT", sys.executable, "-m", "simgap.blind"]
    command += ["diagnose", folder, "--out", out, "--workers", "1"]
    running = subprocess.Popen([str(word) for word in command], start_new_session=True)
    while not read_results(out):
        assert running.poll() is None
        time.sleep(0.05)
    os.killpg(running.pid, signal.SIGINT)
    assert running.wait(timeout=60) != 0
    found = read_results(out)
    assert 0 < len(found) < 6 and {row["status"] for row in found.values()} == {"done"}
    found = run(folder, out, Plan([*sorted(found)[:1], "005"], threads=1, baselines=False, only=["mass"]))
    assert found["005"]["status"] == "done"


# -- the score ---------------------------------------------------------------------------------------------------------


def _answer(kind: str, *faults: dict[str, Any]) -> dict[str, Any]:
    return {"id": "0", "robot": "arm", "kind": kind, "faults": list(faults)}


_MASS = {
    "name": "mass",
    "site": "fore",
    "level": "weak",
    "size": 0.2,
    "parameters": {"change": 0.1},
    "places": ["fore", "elbow"],
}
_SLOW = {
    "name": "servo_delay",
    "site": "s",
    "level": "weak",
    "size": 0.01,
    "parameters": {"delay": 0.01},
    "places": ["s"],
}


def _said(verdict: str, *effects: tuple[str, str, float], equivalent: list[list[str]] | None = None) -> dict[str, Any]:
    return {
        "status": "done",
        "verdict": verdict,
        "wall_s": 2.0,
        "gap": {"before": 5.0, "after": 1.4, "shrink": 0.72},
        "equivalent": equivalent or [],
        "where": [{"channel": "q1", "subsystem": "elbow"}],
        "effects": [
            {"name": n, "site": s, "parameters": {"change": {"value": v, "ci90": [v - 0.02, v + 0.02]}}}
            for n, s, v in effects
        ],
    }


def test_the_score_counts() -> None:
    single = _answer("single", _MASS)
    right = judged(single, _said("effect", ("mass", "fore", 0.11)))
    alias = judged(single, _said("ambiguous", ("inertia", "fore", 1.0), equivalent=[["inertia@fore", "mass@fore"]]))
    wrong = judged(single, _said("effect", ("armature", "elbow", 1.0)))
    shy = judged(single, _said("unknown"))
    rows = [right, alias, wrong, shy]
    rows += [judged(_answer("none"), _said("no_gap")), judged(_answer("none"), _said("effect", ("mass", "fore", 1.0)))]
    rows.append(judged(_answer("pair", _MASS, _SLOW), _said("effect", ("servo_delay", "s", 1), ("mass", "fore", 0.2))))
    counted = metrics(rows)
    assert (counted["top1_effect_and_site"]["value"], counted["top1_effect_and_site"]["n"]) == (0.25, 4)
    assert counted["equivalence_class"]["value"] == 0.5
    assert counted["localisation"]["value"] == 1.0
    assert counted["parameter_error"] == {"value": pytest.approx(0.1), "ci90": [pytest.approx(0.1)] * 2, "n": 1}
    assert counted["interval_coverage"] == rate([True])
    # The pair's mass is said to be 0.18 to 0.22, and is 0.1; the true delay has no number of the same name.
    assert counted["interval_coverage_with_pairs"] == rate([True, False])
    assert counted["false_alarms"]["value"] == 0.5
    assert counted["exact_pairs"]["value"] == 1.0
    assert counted["heldout_shrink"]["value"] == pytest.approx(0.9)
    assert counted["unknown_abstention"]["n"] == 0
    assert confusion(rows)["mass"] == {"mass": 1, "inertia (class holds the truth)": 1, "armature": 1, "unknown": 1}


def test_reliability_counts_verdicts_by_how_sure_they_were() -> None:
    single = _answer("single", _MASS)

    def said(sure: float, right: bool) -> dict[str, Any]:
        told = _said("effect", ("mass", "fore", 0.11) if right else ("armature", "elbow", 1.0))
        return judged(single, told | {"probabilities": {"effect": sure, "mass@fore": 0.2}})

    rows = [said(0.95, True), said(0.93, True), said(0.91, False), said(1.0, True), said(0.4, False)]
    rows.append(judged(single, _said("unknown")))
    bins = {(b["low"], b["high"]): b for b in reliability(rows)}
    assert sum(b["n"] for b in bins.values()) == 5, "an old result does not say how sure it was"
    assert bins[0.9, 0.97]["right"] == pytest.approx(2 / 3)
    assert bins[0.9, 0.97]["said"] == pytest.approx(0.93)
    assert (bins[0.97, 1.0]["right"], bins[0.97, 1.0]["n"]) == (1.0, 1)
    assert bins[0.0, 0.5]["right"] == 0.0
    assert bins[0.5, 0.7]["right"] is None
    assert len(table(reliability(rows))) == 2 + 3


def test_a_case_without_result_counts_as_wrong() -> None:
    row = judged(_answer("single", _MASS), {"status": "timeout"})
    assert not row["correct"] and json.dumps(row)


def test_angles_are_between_lines() -> None:
    one, two = np.array([1.0, 0.0]), np.array([1.0, 1.0])
    angles = angle_matrix([one, -2 * one, two, 0 * one])
    np.testing.assert_allclose(angles[0], [0, 0, 45, 90], atol=1e-6)
