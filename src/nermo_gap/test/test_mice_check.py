"""The blind check of mice: what is wrong with them, what is sealed, and a check from its making to its score."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray
from typer.testing import CliRunner

from nermo_control.types import ControlCommand
from nermo_description.model import build_model
from nermo_description.parameters import RobotParameters
from nermo_description.robots import load_robot
from nermo_gap.blind.mice.check import Case, draw_cases, make
from nermo_gap.blind.mice.faults import KNOWN, UNKNOWN, Fault, all_servos
from nermo_gap.blind.mice.mouse import PERIOD, draw
from nermo_gap.blind.mice.places import sites_of
from nermo_gap.blind.mice.seal import Answer, judge
from nermo_gap.cli import gap_app
from nermo_gap.protocol.play import play
from nermo_gap.protocol.standard import PROTOCOLS, protocol_of
from nermo_gap.protocol.types import Piece, Protocol, Segment
from nermo_gap.robots.diagnosis import robot_plant
from nermo_gap.robots.simulated import simulate
from nermo_gap.robots.sites import groups, worth_a_look
from simgap.blind.make import read_manifest
from simgap.blind.score import judged
from simgap.data.align import align
from simgap.data.noise_floor import noise_floor
from simgap.data.recording import recording_from_table
from simgap.effects.base import Context
from simgap.effects.library import enumerate_effects
from simgap.simulation.replay import Replayer
from simgap.simulation.scales import measure_scales
from simgap.simulation.variant import Variant
from simgap.simulation.windows import cut

Array = NDArray[np.float64]
EVERY = KNOWN | UNKNOWN
ROBOT = "nermo_lite"


def fault(kind: str, seed: int = 4) -> Fault:
    return EVERY[kind](np.random.default_rng(seed))


@pytest.fixture(scope="module")
def offered() -> dict[str, set[str]]:
    """{name@site: names of parameters} of all that a diagnosis of the mouse looks for."""
    table = simulate(load_robot(ROBOT), 6.0, seed=1)
    plant = robot_plant(load_robot(ROBOT), list(table))
    aligned = align(recording_from_table(table, plant, "walk"), plant)
    floor = noise_floor(aligned)
    replayer = Replayer(plant, aligned, cut(aligned, 0.4, 1.0, 6), floor)
    context = Context(plant, measure_scales(replayer, Variant.nominal(plant)), groups(plant.model))
    keep, found = worth_a_look(plant), dict[str, set[str]]()
    for effect in enumerate_effects(context):
        if keep(effect):
            found.setdefault(effect.key, set()).update(p.name for p in effect.parameters)
    return found


@pytest.mark.parametrize("kind", sorted(KNOWN))
def test_a_known_fault_is_one_that_the_diagnosis_can_name(kind: str, offered: dict[str, set[str]]) -> None:
    one = fault(kind)
    assert one.parameter in offered[f"{one.says}@{one.site}"]
    assert one.site in sites_of(ROBOT, one.parts)


@pytest.mark.parametrize("kind", sorted(UNKNOWN))
def test_for_an_unknown_fault_there_is_no_word(kind: str) -> None:
    one = fault(kind)
    assert not one.says and not one.parameter and one.parts


@pytest.mark.parametrize("robot", ["nermo", "nermo_lite"])
@pytest.mark.parametrize("kind", sorted(EVERY))
def test_a_fault_works_by_one_mechanism(robot: str, kind: str) -> None:
    """In the model, between commands and servos, or by a force from outside."""
    one, parameters = fault(kind), load_robot(robot)
    well, ill = build_model(parameters), build_model(parameters)
    one.enter(ill)
    names = [n for n in dir(well) if isinstance(getattr(well, n), np.ndarray)]
    in_model = {n for n in names if not np.array_equal(getattr(well, n), getattr(ill, n))}
    servos = list(parameters.servos)
    path = one.servos(servos, PERIOD)
    told = 0.4 * np.sin(np.arange(300)[:, None] * PERIOD * 10.0) * np.ones(len(servos))
    made = np.array([path(row) for row in told])
    moved = {name for name, column in zip(servos, np.abs(made - told).max(axis=0), strict=True) if column > 1e-9}
    forces, data = one.forces(), mujoco.MjData(well)
    pulled: set[str] = set()
    mujoco.mj_resetDataKeyframe(well, data, 0)
    height = data.qpos[2]
    for tick in range(600):
        data.qpos[0], data.qpos[2] = 0.001 * tick, height + 0.02 * np.sin(0.1 * tick)
        data.time, data.qvel[0] = tick * PERIOD, 0.2
        mujoco.mj_forward(well, data)
        data.xfrc_applied[:] = 0.0
        forces(well, data)
        pulled |= {well.body(int(b)).name for b in np.flatnonzero(np.abs(data.xfrc_applied).max(axis=1))}
    assert bool(in_model) + bool(moved) + bool(pulled) == 1
    assert moved <= set(one.parts)


def test_servos_of_a_pair_get_both_faults() -> None:
    late, off = fault("late_hips"), fault("hip_offset")
    names = list(load_robot(ROBOT).servos)
    both = all_servos([late, off], names, PERIOD)
    told = [np.full(len(names), 0.01 * tick) for tick in range(20)]
    made = np.array([both(row) for row in told])
    place = names.index(off.parts[0])
    assert made[15, place] == pytest.approx(0.01 * (15 - round(0.03 / PERIOD)) + off.value)


def test_a_knee_that_catches_stands_still_and_then_follows() -> None:
    one = fault("catching_cable")
    names = list(load_robot(ROBOT).servos)
    place, path = names.index(one.parts[0]), one.servos(names, PERIOD)
    told = np.concatenate([np.zeros(40), np.linspace(0.0, 0.5, 100), np.full(100, 0.5)])
    made = np.array([path(np.full(len(names), value))[place] for value in told])
    waits = round(0.15 / PERIOD)
    assert (made[: 40 + waits - 1] == 0.0).all() and made[40 + waits + 2] > 0.0
    assert made[-1] == 0.5


def test_what_pulls_at_a_mouse_moves_it() -> None:
    robot = load_robot(ROBOT)
    body, _ = draw(robot, 5, "draught")
    calm = dataclasses.replace(body, forces=None)
    (walking,) = protocol_of("walk", robot, False).segments
    segment = dataclasses.replace(walking, pieces=walking.pieces[:1])
    stand, rest = _stand(robot)
    blown, still = (play(segment, b, stand, rest, np.random.default_rng(1))[0] for b in (body, calm))
    assert np.abs(blown["base_y"] - still["base_y"]).max() > 0.005


def _stand(robot):
    from nermo_description.stand import Stand

    stand = Stand()
    return stand, stand.rest(build_model(robot))


def test_the_same_seed_draws_the_same_mice_and_every_fault_before_one_twice() -> None:
    cases = draw_cases(60, 7, ["nermo_lite", "nermo"])
    assert cases == draw_cases(60, 7, ["nermo_lite", "nermo"]) != draw_cases(60, 8, ["nermo_lite", "nermo"])
    assert {c.kind: sum(d.kind == c.kind for d in cases) for c in cases} == {
        "none": 12,
        "single": 30,
        "pair": 9,
        "unknown": 9,
    }
    singles = [c.faults[0] for c in cases if c.kind == "single"]
    assert set(singles) == set(KNOWN) and max(map(singles.count, singles)) <= 2
    assert {c.faults[0] for c in cases if c.kind == "unknown"} == set(UNKNOWN)
    assert {c.robot for c in cases} == {"nermo_lite", "nermo"}
    for case in cases:
        assert [f.parts for f in case.made()] == [f.parts for f in case.made()]
        if case.kind == "pair":
            one, two = case.made()
            assert one.kind != two.kind


@pytest.mark.parametrize("kind", sorted(UNKNOWN))
def test_whoever_says_that_the_library_lacks_it_is_right(kind: str) -> None:
    answer = Answer.of(ROBOT, 1, fault(kind))
    effect = {"name": "mass", "site": "torso", "parameters": {}}
    assert judge(answer, {"verdict": "unknown", "effects": []}) == "right"
    assert judge(answer, {"verdict": "effect", "effects": [effect]}) == "wrong"
    assert judge(answer, {"verdict": "calibration", "effects": []}) == "missed"
    assert "no word" in answer.sentence()


def test_an_answer_is_judged_as_that_of_any_robot() -> None:
    case = Case("000", ROBOT, "single", ("weak_hip",), (7, 0))
    (truth,) = case.answer()["faults"]
    value = truth["parameters"]["factor"]
    said = {"name": "servo_gain", "site": truth["site"], "parameters": {"factor": {"value": value, "ci90": [0.4, 0.8]}}}
    row = judged(case.answer(), {"verdict": "effect", "effects": [said], "status": "done"})
    assert row["top1"] and row["located"] and row["covered"]
    joint = said | {"name": "coulomb_friction", "site": f"{truth['site']}_joint"}
    row = judged(case.answer(), {"verdict": "effect", "effects": [joint], "status": "done"})
    assert not row["top1"] and row["located"]


def _three_steps(robot: RobotParameters, markers: bool = False) -> Protocol:
    """As short as a diagnosis lets it be; what it finds is another matter."""
    walk = ((0.0, ControlCommand(0, forward_velocity=0.06)),)
    pieces = tuple(Piece(name, "walk", 1.5, commands=walk, looks=(0.35,)) for name in ("one", "two", "three"))
    return Protocol("short", (Segment("walking", "floor", "Set the mouse down.", pieces),))


@pytest.mark.long
def test_a_mouse_is_recorded_sealed_diagnosed_behind_bars_and_scored(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(PROTOCOLS, "short", _three_steps)
    check, sealed, results = tmp_path / "mice", tmp_path / "sealed", tmp_path / "results"
    manifest = make(check, sealed, 1, 3, protocol="short", salt="salt")
    (case,) = manifest["cases"]
    truth = json.loads((sealed / f"{case['id']}.json").read_text(encoding="utf-8"))
    told = (check / "manifest.json").read_text(encoding="utf-8")
    assert truth["kind"] not in told and str(truth["seed"]) not in told
    assert read_manifest(check) == manifest
    asked = ["mice", "diagnose", str(check), "--out", str(results), "--answers", str(sealed)]
    asked += ["--workers", "1", "--only", "ground_friction"]
    run = CliRunner().invoke(gap_app, asked)
    assert run.exit_code == 0, run.output
    (line,) = (results / "results.jsonl").read_text(encoding="utf-8").splitlines()
    row = json.loads(line)
    assert row["status"] == "done" and row["robot"] == ROBOT
    assert row["isolation"]["readable_beyond_the_case"] == []
    score = tmp_path / "score.json"
    run = CliRunner().invoke(gap_app, ["mice", "score", str(check), str(sealed), str(results), "--json", str(score)])
    assert run.exit_code == 0, run.output
    assert json.loads(score.read_text(encoding="utf-8"))["scored"] == 1


def test_mice_are_not_made_where_that_cannot_be_sealed(tmp_path: Path) -> None:
    def asked(*more: str):
        return CliRunner().invoke(gap_app, ["mice", "make", "--cases", "1", "--seed", "1", *more])

    inside = asked("--out", str(tmp_path / "a"), "--answers", str(tmp_path / "a" / "answers"))
    assert inside.exit_code == 2 and "must lie outside" in inside.output
    robot = asked("--out", str(tmp_path / "b"), "--robots", "rat")
    assert robot.exit_code == 2 and "rat" in robot.output
    assert asked("--out", str(tmp_path / "c"), "--robots", "").exit_code == 2
    protocol = asked("--out", str(tmp_path / "d"), "--protocol", "dance")
    assert protocol.exit_code == 2 and "dance" in protocol.output
    assert not (tmp_path / "d").exists()
