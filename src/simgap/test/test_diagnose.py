"""Whole diagnoses on small robots, and the command line."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import pytest
import yaml
from numpy.typing import NDArray
from robots import MAPS, PENDULUM, aligned_of, plant_of, simulate
from typer.testing import CliRunner

import simgap
from simgap.analysis.diagnose import Diagnosis, diagnose, write_report
from simgap.analysis.options import Options
from simgap.blind.cases import Case
from simgap.blind.recordings import simulate as recorded
from simgap.cli import app
from simgap.data.mapping import load_map, parse_map
from simgap.data.plant import build_plant, load_spec
from simgap.data.recording import load_table, recording_from_table
from simgap.inference.baselines import fit_everything
from simgap.inference.fit import MANY, Fitter
from simgap.inference.hypothesis import Hypothesis
from simgap.inference.model_selection import EVIDENCE
from simgap.inference.nuisance import enumerate_nuisances
from simgap.inference.residual import Residuals, channel_gap
from simgap.simulation.replay import Replayer
from simgap.simulation.variant import Variant
from simgap.simulation.windows import cut

Array = NDArray[np.float64]


SOME = ("coulomb_friction", "viscous_friction", "load_friction", "servo_delay", "servo_dead_band", "mass")
"""Enough rivals for a test; the benchmark of docs/gap.md runs the whole library."""


def _diagnose(name: str, change: Callable[[mujoco.MjModel], object] | None, seconds: float = 10.0) -> Diagnosis:
    plant = plant_of(name)
    table = simulate(name, seconds, change=change)  # type: ignore[arg-type]
    return diagnose([recording_from_table(table, plant)], plant, Options(baselines=False, only=SOME, threads=1))


def _own_coulomb(model: mujoco.MjModel) -> None:
    model.dof_frictionloss[:] = 0.1


def _both_frictions(model: mujoco.MjModel) -> None:
    model.dof_frictionloss[:] = 0.1
    model.dof_damping[:] += 0.15


@pytest.mark.parametrize("form", ["firm", ""])
def test_friction_that_holds_is_told_from_friction_that_creeps(form: str) -> None:
    """A pendulum whose model rubs by 0.05 N m, and that rubs by 0.35; held aloft it stays, or sinks."""
    rubs = PENDULUM.replace('damping="0.02"', 'damping="0.02" frictionloss="0.05"')
    robot = mujoco.MjModel.from_xml_string(rubs)
    robot.dof_frictionloss[:] = 0.35
    if form:
        robot.dof_solref[:], robot.dof_solimp[:, :2] = (0.005, 1.0), 0.9998
    rng, data, rows = np.random.default_rng(4), mujoco.MjData(robot), []
    for k in range(3000):
        if k % 160 == 0:
            data.ctrl[0] = rng.uniform(-1.2, 1.2)
        rows.append((0.005 * k, data.ctrl[0], data.qpos[0] + 2e-4 * rng.standard_normal()))
        mujoco.mj_step(robot, data, 2)
    table = dict(zip(("t", "u", "q"), np.array(rows).T, strict=True))
    plant = build_plant(mujoco.MjSpec.from_string(rubs), parse_map(MAPS["pendulum"]))
    options = Options(baselines=False, only=SOME[:3], threads=1)
    report = diagnose([recording_from_table(table, plant)], plant, options).report
    (effect,) = report["effects"]
    assert (effect["name"], effect.get("form", "")) == ("coulomb_friction", form)
    assert effect["parameters"]["friction"]["value"] == pytest.approx(0.3, rel=0.1)


def test_nuisances_take_up_nominal_numbers_that_are_off() -> None:
    def off(model: mujoco.MjModel) -> None:
        model.body_mass[:] *= 1.06
        model.body_inertia[:] *= 1.06
        model.dof_damping[:] *= 0.9

    plant, aligned, floor = aligned_of("arm", simulate("arm", 10.0, change=off))
    replayer = Replayer(plant, aligned, cut(aligned), floor)
    residuals = Residuals.build(replayer, Variant.nominal(plant))
    nuisances = enumerate_nuisances(plant, aligned.outputs.std(axis=0), np.ones(len(plant.inputs)), aligned.period)
    fitter = Fitter(residuals, nuisances)
    fit = fitter.fit_nuisances()
    assert fitter.nominal is not None
    before, after = (channel_gap(f.residual, residuals.mask) for f in (fitter.nominal, fit))
    assert before.max() > 3.0 and after.max() < 1.4
    assert np.abs(fit.z).max() < 2.0


def test_many_numbers_are_fitted_to_their_end() -> None:
    """A healthy camera of the blind check, whose gains were named where its 35 numbers were looked at once."""
    table = recorded(Case("000", "camera", "none", (11, 1), 15.0, [])).columns
    plant, aligned, floor = aligned_of("camera", table)
    residuals = Residuals.build(Replayer(plant, aligned, cut(aligned), floor), Variant.nominal(plant))
    swing, size = aligned.outputs.std(axis=0), np.sqrt((aligned.inputs**2).mean(axis=0))
    fitter = Fitter(residuals, enumerate_nuisances(plant, swing, size, aligned.period))
    assert len(fitter.nuisances) > MANY
    fit = fitter.fit_nuisances()
    fitter.refresh(fit.hypothesis, fit.x, fit.z, fit.residual)
    assert fit.cost - fitter.fit(fit.hypothesis, fit.x, fit.z, known=fit.residual).cost < EVIDENCE


def test_windows_in_which_nothing_was_recorded_are_not_fitted_or_scored() -> None:
    """Of a mouse whose tracker starts late, the first windows hold nothing; one fold might hold only such windows."""
    plant, aligned, floor = aligned_of("pendulum", simulate("pendulum", 8.0, change=_own_coulomb))
    windows = cut(aligned)
    residuals = Residuals.build(Replayer(plant, aligned, windows, floor, 1), Variant.nominal(plant))
    residuals.mask[windows.fold == 0] = False
    fitter = Fitter(
        residuals, enumerate_nuisances(plant, aligned.outputs.std(axis=0), np.ones(len(plant.inputs)), aligned.period)
    )
    report = fit_everything(fitter, 1)
    assert report["held_out"] == "fold 1"
    assert np.isfinite([report["gap"], report["shrink"], *report["ci90"], *report["shrink_ci90"]]).all()  # type: ignore[misc]


def test_a_number_that_cannot_be_computed_does_not_cost_the_report(tmp_path: Path) -> None:
    write_report({"gap": {"after": float("nan"), "ci90": [1.0, np.inf]}, "verdict": "no_gap"}, tmp_path / "d.json")
    written = json.loads((tmp_path / "d.json").read_text())
    assert written == {"gap": {"after": None, "ci90": [1.0, None]}, "verdict": "no_gap"}


def test_cost_is_bounded_by_the_floor_and_grows_with_the_residual() -> None:
    plant, aligned, floor = aligned_of("pendulum", simulate("pendulum", 6.0))
    replayer = Replayer(plant, aligned, cut(aligned), floor, 1)
    fitter = Fitter(Residuals.build(replayer, Variant.nominal(plant)), [])
    residual = fitter.replay(Hypothesis(), [(np.zeros(0), np.zeros(0))])[0]
    square = fitter.mean_square(residual)
    costs = [float(fitter.data_cost(k * square)) for k in (0.0, 1.0, 4.0, 100.0)]
    assert costs[0] == pytest.approx(0.0) and costs == sorted(costs)
    # The weights are the slope of the data term: d cost = sum of weights * residual * d residual.
    step = 1e-5 * residual
    slope = float(fitter.data_cost(fitter.mean_square(residual + step)) - fitter.data_cost(square))
    predicted = float((fitter.weights(square)[:, None, :] * residual * step).sum())
    assert slope == pytest.approx(predicted, rel=1e-3)


def test_one_friction_is_found_with_its_size() -> None:
    found = _diagnose("pendulum", _own_coulomb)
    assert found.report["verdict"] == "effect", found.report["reasons"]
    (effect,) = found.report["effects"]
    assert (effect["name"], effect["site"]) == ("coulomb_friction", "hinge")
    low, high = effect["parameters"]["friction"]["ci90"]
    assert low <= 0.1 <= high and high - low < 0.03
    assert found.report["gap"]["shrink"] > 0.8 and found.report["gap"]["after"] < 1.5


def test_a_few_windows_far_off_are_no_case_of_no_gap() -> None:
    """Something that acts seldom leaves the typical window alone; it is not explained away for that."""
    plant, table = plant_of("pendulum"), simulate("pendulum", 14.0)
    angle = table["q"].copy()
    for start in (3.1, 9.4):
        knock = (table["t"] - start) / 0.2
        angle += np.where((knock > 0) & (knock < 1), 0.02 * np.sin(np.pi * knock) ** 2, 0.0)
    options = Options(baselines=False, only=("viscous_friction", "servo_delay"), threads=1)
    found = diagnose([recording_from_table(table | {"q": angle}, plant)], plant, options)
    assert found.report["gap"]["typical"]["after"] < 2.0
    assert found.report["verdict"] == "unknown", found.report["reasons"]


def test_of_a_robot_that_stood_still_nothing_is_known() -> None:
    plant = plant_of("arm")
    table = simulate("arm", 5.0, told=0.0)
    found = diagnose([recording_from_table(table, plant)], plant, Options(baselines=False, only=SOME[:2], threads=1))
    assert found.report["verdict"] == "unknown"
    assert "move each joint" in " ".join(found.report["reasons"])
    assert sum("hardly moves" in warning for warning in found.report["warnings"]) == 2


def test_one_pose_that_differs_from_the_model_s_does_not_tell_why() -> None:
    """A forearm that somebody holds up: an effect fits it to its noise, and so would others that hold or let go."""
    plant, table = plant_of("arm"), simulate("arm", 5.0, told=0.0)
    noise = 2e-4 * np.random.default_rng(0).standard_normal((2, len(table["t"])))
    held = {"q0": float(table["q0"][-1]) + noise[0], "q1": 0.3 + noise[1]}
    options = Options(baselines=False, only=("servo_gain", "servo_offset"), threads=1)
    found = diagnose([recording_from_table(table | held, plant)], plant, options).report
    assert (found["verdict"], found["gap"]["before"] > 20.0) == ("unknown", True)
    assert found["reasons"][0].startswith("nothing was told to move and nothing moved, and one pose")


def test_friction_and_damping_are_not_taken_for_friction_alone() -> None:
    """Fitted with friction alone, a joint with both gives a confident wrong number: the pair, or no single effect."""
    report = _diagnose("pendulum", _both_frictions, 14.0).report
    keys = {f"{e['name']}@{e['site']}" for e in report["effects"]}
    if report["verdict"] == "effect":
        assert keys == {"coulomb_friction@hinge", "viscous_friction@hinge"}
        sizes = {e["name"]: next(iter(e["parameters"].values()))["value"] for e in report["effects"]}
        assert sizes["coulomb_friction"] == pytest.approx(0.1, rel=0.25)
        assert sizes["viscous_friction"] == pytest.approx(0.15, rel=0.25)
    else:
        assert report["verdict"] in ("ambiguous", "unknown")


def test_no_gap_is_no_gap() -> None:
    report = _diagnose("pendulum", None).report
    assert report["verdict"] == "no_gap" and report["effects"] == []
    assert 0.7 < report["gap"]["after"] < 1.3


@pytest.mark.long
@pytest.mark.parametrize("dead", [("pos2",), ("pos2", "vel2")])
def test_an_elbow_whose_angle_nobody_recorded_proves_no_effect(dead: tuple[str, ...]) -> None:
    """Windows of a real double pendulum would begin at a guess, and an armature of 0.9 kg m^2 explain it."""
    folder = Path(simgap.__file__).parent / "examples" / "double_pendulum"
    plant = build_plant(load_spec(folder / "model.xml"), load_map(folder / "map.yaml"))
    table = {name: column[:900].copy() for name, column in load_table(folder / "excerpt.csv").items()}
    for name in dead:
        table[name][:] = 0.5
    options = Options(baselines=False, only=("armature", "coulomb_friction"), threads=1)
    found = diagnose([recording_from_table(table, plant)], plant, options)
    assert found.selector.fitter.residuals.replayer.guesswork() > 2.0
    assert found.report["verdict"] == "unknown"
    assert any("elbow" in reason and "record it" in reason for reason in found.report["reasons"])


def test_what_is_finer_than_the_sensors_is_no_gap() -> None:
    """Whoever says that a sensor resolves 0.01 rad need not hear of what moves it by half as much."""
    plant, table = plant_of("pendulum"), simulate("pendulum", 10.0, change=_own_coulomb)
    options = Options(baselines=False, only=SOME, threads=1, resolution={"q": 0.01})
    found = diagnose([recording_from_table(table, plant)], plant, options)
    assert found.report["verdict"] == "no_gap" and "repeating" in found.report["reasons"][0]
    (channel,) = found.report["gap"]["by_channel"].values()
    assert channel["after"] < 1.0


KEYS = ("verdict", "gap", "where", "effects", "equivalent", "baselines", "next_experiment", "heldout", "noise_floor")
GRADED = {
    "waterfall": {"step", "gap", "rmse", "free_running"},
    "calibration": {"name", "site", "nominal", "value", "unit", "ci90", "gap_share"},
    "free_running": {"run", "model", "rmse"},
}
TOP = ("schema", "created", "command", "seed", "robot", "versions", "warnings", "wall_s")


@pytest.fixture
def files(tmp_path: Path) -> dict[str, Path]:
    table = simulate("pendulum", 8.0, change=_own_coulomb)
    log, model, mapping = tmp_path / "log.csv", tmp_path / "robot.xml", tmp_path / "map.yaml"
    rows = np.stack(list(table.values()), 1)
    np.savetxt(log, rows, delimiter=",", header=",".join(table), comments="")
    model.write_text(PENDULUM)
    mapping.write_text(yaml.safe_dump(MAPS["pendulum"]))
    return {"log": log, "model": model, "map": mapping, "json": tmp_path / "out" / "diagnosis.json"}


def _run(files: dict[str, Path], *more: str):  # type: ignore[no-untyped-def]
    arguments = ["diagnose", str(files["log"]), "--model", str(files["model"]), "--map", str(files["map"])]
    return CliRunner().invoke(app, [*arguments, "--json", str(files["json"]), *more])


def test_command_line_writes_every_key(files: dict[str, Path]) -> None:
    result = _run(files, "--only", "coulomb_friction", "--only", "servo_delay")
    assert result.exit_code == 0, result.output
    report = json.loads(files["json"].read_text())
    assert set(KEYS) | set(TOP) <= set(report)
    assert {"before", "after", "shrink", "ci90"} <= set(report["gap"])
    assert {"nominal", "fit_everything", "best_in_sample"} <= set(report["baselines"])
    assert report["where"] and {"channel", "subsystem", "phase", "share"} <= set(report["where"][0])
    assert sum(w["share"] for w in report["where"]) == pytest.approx(1.0)
    for effect in report["effects"]:
        assert {"name", "site", "parameters", "gap_gain", "ci90"} <= set(effect)
        for parameter in effect["parameters"].values():
            assert {"value", "unit", "ci90"} <= set(parameter)
    assert report["verdict"] in result.output
    for key, inside in GRADED.items():
        assert all(inside <= set(row) for row in report[key])
    assert {"share", "predictable_share", "goes_with", "sentence"} <= set(report["remainder"])
    assert {r["model"] for r in report["free_running"]} == {"nominal", "recalibrated", "diagnosed", "fit_everything"}
    assert report["remainder"]["sentence"] in " ".join(result.output.split())


@pytest.mark.parametrize("before", [["simgap"], ["/usr/bin/python", "-m", "simgap"]])
def test_the_command_is_kept_as_it_was_typed(
    files: dict[str, Path], monkeypatch: pytest.MonkeyPatch, before: list[str]
) -> None:
    given = ["diagnose", str(files["log"]), "--only", "coulomb_friction"]
    monkeypatch.setattr(sys, "argv", [*before, *given])
    assert _run(files, "--only", "coulomb_friction").exit_code == 0
    assert json.loads(files["json"].read_text())["command"].split() == ["simgap", *given]


def test_bad_input_ends_with_status_2_and_one_sentence(files: dict[str, Path]) -> None:
    def spoil(edit: Callable[[dict[str, object]], None]) -> str:
        data = yaml.safe_load(yaml.safe_dump(MAPS["pendulum"]))
        edit(data)
        files["map"].write_text(yaml.safe_dump(data))
        result = _run(files)
        assert result.exit_code == 2 and "Traceback" not in result.output
        lines = result.stderr.strip().splitlines()
        return lines[-1]

    assert "neither commanded nor measured" in spoil(lambda m: m.update(inputs=[]))
    assert "no sensor 'shoulder_pos'" in spoil(lambda m: m["outputs"][0].update(sensor="shoulder_pos"))  # type: ignore[index]
    assert "does not fit" in spoil(lambda m: m["outputs"][0].update(unit="m"))  # type: ignore[index]
    assert "degrees" in spoil(lambda m: m["outputs"][0].update(unit="deg"))  # type: ignore[index]
    files["log"] = files["log"].with_name("nothing.csv")
    assert "no such recording" in spoil(lambda m: None)
