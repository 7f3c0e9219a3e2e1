"""The graded part of the report, on robots whose truth is known: free runs, waterfall, calibration, remainder."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from robots import aligned_of, plant_of, simulate

import simgap
from simgap.analysis.diagnose import Diagnosis, diagnose
from simgap.analysis.errors import by_channel
from simgap.analysis.free_running import STRETCH, Model, fold_of, free_runs
from simgap.analysis.options import Options
from simgap.analysis.recalibration import calibration
from simgap.analysis.remainder import describe, shares_of
from simgap.analysis.waterfall import models, steps, waterfall
from simgap.data.align import Run, align
from simgap.data.mapping import load_map
from simgap.data.noise_floor import noise_floor
from simgap.data.plant import Plant, build_plant, load_spec
from simgap.data.recording import load_table, recording_from_table
from simgap.effects.base import Context
from simgap.effects.library import enumerate_effects
from simgap.inference.fit import Fitter
from simgap.inference.hypothesis import Hypothesis
from simgap.inference.nuisance import Nuisance, Number, enumerate_nuisances
from simgap.inference.residual import Residuals
from simgap.inference.scores import Scores
from simgap.inference.selection import Selection
from simgap.inference.verdict import judge
from simgap.simulation.replay import Replayer
from simgap.simulation.scales import measure_scales
from simgap.simulation.variant import Variant
from simgap.simulation.windows import Windows, cut

Array = NDArray[np.float64]
FRICTION = 0.1


def _runs(data: dict[str, object]) -> None:
    data["segments"] = {"column": "run", "held_out": [2.0]}


@pytest.fixture(scope="module")
def table() -> dict[str, Array]:
    def dry(model: mujoco.MjModel) -> None:
        model.dof_frictionloss[1] += FRICTION

    made = simulate("arm", 12.0, change=dry)
    return made | {"run": np.floor(made["t"] / 4.0)}


@pytest.fixture(scope="module")
def found(table: dict[str, Array]) -> Diagnosis:
    """Without nuisances, so that the diagnosed model is the nominal one with one number changed."""
    plant = plant_of("arm", _runs)
    options = Options(
        only=("coulomb_friction",), baselines=False, threads=1, nuisances=lambda *_: [], keep=lambda e: not e.form
    )
    return diagnose([recording_from_table(table, plant)], plant, options)


# -- free runs ---------------------------------------------------------------------------------------------------------


def test_a_free_run_is_a_plain_simulation_of_the_corrected_model(found: Diagnosis, table: dict[str, Array]) -> None:
    (run,), replayer = found.runs, found.selector.fitter.residuals.replayer
    (effect,) = found.report["effects"]
    assert (effect["name"], effect["site"]) == ("coulomb_friction", "elbow")
    begin = next(r.start for r in replayer.aligned.runs if r.label == 2.0) + replayer.windows.warm_up
    model = plant_of("arm").model
    # The fit that has not seen the run gave this value.
    model.dof_frictionloss[1] = found.selection.best.fit.fold_x[0][0]
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = replayer.state.position[begin], replayer.state.velocity[begin]
    first = int(np.flatnonzero(table["run"] == 2.0)[0]) + replayer.windows.warm_up
    rows = []
    for k in range(first, len(table["t"])):
        for channel in replayer.plant.inputs:
            data.ctrl[channel.actuator] = table[channel.column][k]
        mujoco.mj_forward(model, data)
        rows.append(np.array(data.qpos))
        for _ in range(2):
            mujoco.mj_step(model, data)
    assert run.simulated["diagnosed"].shape == (1, len(rows), 2)
    assert np.abs(run.simulated["diagnosed"][0] - np.array(rows)).max() < 1e-6
    measured = np.stack([table[c.column][first:] for c in replayer.plant.outputs], 1)
    plain = np.sqrt(((measured - np.array(rows)) ** 2).mean(axis=0))
    assert list(run.error(replayer.plant, "diagnosed").values()) == pytest.approx(plain.tolist(), abs=1e-6)


def test_free_runs_are_of_the_held_out_run_and_far_better_with_the_cause(found: Diagnosis) -> None:
    rows = {row["model"]: row for row in found.report["free_running"]}
    assert set(rows) == {"nominal", "recalibrated", "diagnosed"}
    for row in rows.values():
        assert row["run"] == 2.0 and row["fitted_on_it"] is False and row["broke_down"] is False
        assert row["duration_s"] == pytest.approx(4.0, abs=0.2) and row["stretch_s"] is None
        assert set(row["rmse"]) == set(row["unit"]) and set(row["unit"].values()) == {"rad"}
    for name, error in rows["diagnosed"]["rmse"].items():
        assert error < 0.3 * rows["nominal"]["rmse"][name] and error < 4e-4


def test_a_run_that_was_fitted_in_parts_is_said_to_be() -> None:
    plant, aligned, floor = aligned_of("pendulum", simulate("pendulum", 8.0))
    replayer = Replayer(plant, aligned, cut(aligned), floor, 1)
    fitter = Fitter(Residuals.build(replayer, Variant.nominal(plant)), [])
    nominal = Model.nominal(fitter)
    fitted = Model("diagnosed", nominal.hypothesis, nominal.common, dict.fromkeys(range(3), nominal.common))
    (run,) = free_runs(fitter, [nominal, fitted])
    assert run.seen == {"nominal": False, "diagnosed": True}
    (whole,) = aligned.runs
    assert fold_of(replayer.windows, whole) is None


def test_a_run_in_one_fold_is_run_by_the_fit_that_has_not_seen_it() -> None:
    runs = [Run(100 * i, 100 * (i + 1), float(i)) for i in range(3)]
    start = np.array([10, 50, 110, 150, 210, 250])
    windows = Windows(start, 5, 20, np.arange(20), np.arange(6), np.array([0, 0, 1, 2, -1, -1]))
    assert [fold_of(windows, run) for run in runs] == [0, None, None]
    none = (np.zeros(0), np.zeros(0))
    own = (np.ones(1), np.zeros(0))
    model = Model("diagnosed", Hypothesis(), none, {0: own})
    assert model.values(0) == (own, False) and model.values(None) == (none, True) and model.values(1) == (none, True)


def test_a_robot_that_blows_up_errors_of_its_start_is_compared_in_stretches() -> None:
    """The double pendulum; its whole run is told beside, broken down or not."""
    folder = Path(simgap.__file__).parent / "examples" / "double_pendulum"
    plant = build_plant(load_spec(folder / "model.xml"), load_map(folder / "map.yaml"))
    rows = {name: column[:900] for name, column in load_table(folder / "excerpt.csv").items()}
    aligned = align(recording_from_table(rows, plant), plant)
    replayer = Replayer(plant, aligned, cut(aligned, 0.2), noise_floor(aligned), 1)
    fitter = Fitter(Residuals.build(replayer, Variant.nominal(plant), start=False), [])
    (run,) = free_runs(fitter, [Model.nominal(fitter)])
    assert run.chaotic and run.measured.shape[1] == round(STRETCH / aligned.period)
    assert set(run.whole["nominal"]) == set(run.error(plant, "nominal"))
    assert all(0.0 < value < 20.0 for value in run.error(plant, "nominal").values())


def test_a_run_in_which_a_joint_stands_still_is_not_taken_for_chaos() -> None:
    plant = plant_of("arm", lambda data: data.update(segments={"column": "run"}))
    made = simulate("arm", 8.0)
    still = {name: np.where(made["t"] < 3.0, column, 0.0) for name, column in made.items() if name.startswith("u")}
    table = simulate("arm", 8.0, signal=lambda _: still) | still | {"run": np.floor(made["t"] / 4.0)}
    aligned = align(recording_from_table(table, plant), plant)
    replayer = Replayer(plant, aligned, cut(aligned), noise_floor(aligned), 1)
    fitter = Fitter(Residuals.build(replayer, Variant.nominal(plant), start=False), [])
    assert [run.chaotic for run in free_runs(fitter, [Model.nominal(fitter)])] == [False, False]


def test_errors_leave_out_what_was_not_measured_and_say_what_broke_down() -> None:
    plant = plant_of("arm")
    measured = np.zeros((1, 5, 2))
    measured[..., 1] = np.nan
    assert by_channel(plant, measured, np.ones((1, 5, 2))) == {"q0": 1.0}
    lost = by_channel(plant, np.zeros((1, 5, 2)), np.full((1, 5, 2), np.nan))
    assert set(lost) == {"q0", "q1"} and np.isnan(list(lost.values())).all()


# -- waterfall ---------------------------------------------------------------------------------------------------------


def test_the_waterfall_leads_from_before_to_after(found: Diagnosis) -> None:
    steps, gap = found.report["waterfall"], found.report["gap"]
    assert [s["step"] for s in steps] == ["nominal", "recalibrated", "coulomb_friction@elbow", "remainder"]
    assert steps[0]["gap"] == gap["before"] and steps[1]["gap"] == gap["nuisances_only"]
    assert steps[-1]["gap"] == steps[-2]["gap"] == gap["after"]
    by_model = {row["model"]: row["rmse"] for row in found.report["free_running"]}
    for step, model in zip(steps[:3], ("nominal", "recalibrated", "diagnosed"), strict=True):
        assert step["free_running"] == pytest.approx(by_model[model])
    for name in steps[0]["rmse"]:
        assert steps[-1]["rmse"][name] < steps[0]["rmse"][name]
    assert found.report["remainder"]["share"] == pytest.approx(
        max(gap["after"] ** 2 - 1.0, 0.0) / (gap["before"] ** 2 - 1.0)
    )


def test_every_cause_has_its_own_step_in_the_order_in_which_it_was_found() -> None:
    def rubbing(model: mujoco.MjModel) -> None:
        model.dof_frictionloss[1] += FRICTION
        model.dof_damping[0] += 0.2

    plant, aligned, floor = aligned_of("arm", simulate("arm", 10.0, change=rubbing))
    replayer = Replayer(plant, aligned, cut(aligned), floor, 1)
    fitter = Fitter(Residuals.build(replayer, Variant.nominal(plant)), [])
    context = Context(plant, measure_scales(replayer, Variant.nominal(plant)))
    known = {e.key: e for e in enumerate_effects(context, (), ("coulomb_friction", "viscous_friction")) if not e.form}
    both = Hypothesis((known["viscous_friction@shoulder"], known["coulomb_friction@elbow"]))
    scores = Scores(fitter)
    reference, best = (
        scores.scored(fitter.cross_validate(fitter.fit(h, np.full(h.size, 0.05), np.zeros(0), 8)))
        for h in (Hypothesis(), both)
    )
    found = steps(fitter, scores, Selection(reference, reference.gap, best), reference.gap)
    assert [s.name for s in found] == ["nominal", "recalibrated", *(e.key for e in both.effects)]
    assert [s.gap for s in found[2:]] == pytest.approx(sorted((s.gap for s in found[2:]), reverse=True))
    assert found[1].gap > 1.5 * found[2].gap > 2.0 * found[3].gap and found[3].gap == best.gap < 1.3
    rows = waterfall(fitter, found, free_runs(fitter, models(found)))
    assert [r["step"] for r in rows] == [*(s.name for s in found), "remainder"]
    errors = [r["free_running"]["q0"] for r in rows[1:]]
    assert errors == sorted(errors, reverse=True) and errors[-1] < 4e-4


# -- what is left -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("left", "kind"), [(math.inf, "effect"), (1.4, "partial")])
def test_who_knows_what_such_a_robot_leaves_is_told_that_more_is_left(left: float, kind: str) -> None:
    """Drag at the shoulder is found; a little dry friction at the elbow is what the library here has no word for."""

    def rubbing(model: mujoco.MjModel) -> None:
        model.dof_damping[0] += 0.3
        model.dof_frictionloss[1] += 0.01

    plant = plant_of("arm")
    recording = recording_from_table(simulate("arm", 8.0, change=rubbing), plant)
    options = Options(only=("viscous_friction",), max_windows=12, baselines=False, left=left)
    verdict = diagnose([recording], plant, options).verdict
    assert (verdict.kind, verdict.best.key) == (kind, "viscous_friction@shoulder")
    assert ("which nothing in the library explains" in verdict.reasons[0]) == (kind == "partial")


# -- calibration -------------------------------------------------------------------------------------------------------


def _fitted(factor: float, only: str = "", floors: tuple[float, float] = (1.0, 1.0)) -> list[dict[str, object]]:
    """Calibration of an arm whose forearm is heavier by a factor; of nuisances whose names begin with ``only``.

    floors: Of the two joints, in theirs: a tracker that claims less than it can do.
    """

    def heavier(model: mujoco.MjModel) -> None:
        model.body_mass[2] *= factor
        model.body_inertia[2] *= factor

    plant, aligned, floor = aligned_of("arm", simulate("arm", 10.0, change=heavier))
    replayer = Replayer(plant, aligned, cut(aligned), floor * floors, 1)
    nuisances = enumerate_nuisances(plant, aligned.outputs.std(axis=0), np.ones(len(plant.inputs)), aligned.period)
    chosen = [n for n in nuisances if n.name.startswith(only)]
    fitter = Fitter(Residuals.build(replayer, Variant.nominal(plant)), chosen)
    return calibration(fitter, fitter.cross_validate(fitter.fit_nuisances()))


def test_what_takes_a_trifle_contradicts_no_calibration(monkeypatch: pytest.MonkeyPatch) -> None:
    def off(model: mujoco.MjModel) -> None:
        model.body_mass[2] *= 1.05
        model.body_inertia[2] *= 1.05
        model.dof_damping[:] *= 0.95

    plant = plant_of("arm")
    recording = recording_from_table(simulate("arm", 8.0, change=off), plant)
    options = Options(only=("mass", "viscous_friction", "servo_gain"), max_windows=12, baselines=False, threads=1)
    found = diagnose([recording], plant, options)
    alone = found.report["probabilities"]["nominal numbers"]
    assert (found.verdict.kind, found.verdict.probability) == ("calibration", pytest.approx(1.0))
    assert alone < 0.99
    # A robot that lands hides what is wrong with it in its numbers.
    monkeypatch.setattr(found.selector.fitter, "lands", True)
    landed = judge(found.selector, found.selection)
    assert landed.probability == pytest.approx(sum(c.probability for c in landed.classes if not c.names))
    assert landed.probability < 0.99


def test_a_mass_that_is_off_is_said_with_its_interval_and_its_share() -> None:
    (row,) = _fitted(1.06, "mass")
    assert (row["name"], row["site"], row["unit"], row["at_limit"]) == ("mass", "fore", "kg", False)
    low, high = row["ci90"]  # type: ignore[misc]
    assert row["nominal"] == pytest.approx(0.6) and low <= 1.06 * 0.6 <= high and high - low < 0.05
    assert row["gap_share"] == pytest.approx(1.0, abs=0.1)


def test_channels_within_their_noise_do_not_hide_the_share_of_what_explains_the_rest() -> None:
    (row,) = _fitted(1.06, "mass", floors=(40.0, 1.0))
    assert row["gap_share"] == pytest.approx(1.0, abs=0.1)


def test_beside_numbers_that_can_imitate_it_intervals_still_hold_the_truth() -> None:
    rows = _fitted(1.06)
    truth = {("mass", "fore"): 0.636}
    held = [r["ci90"][0] <= truth.get((r["name"], r["site"]), r["nominal"]) <= r["ci90"][1] for r in rows]  # type: ignore[index, call-overload]
    assert rows and np.mean(held) >= 0.75
    assert sum(float(str(r["gap_share"])) for r in rows) == pytest.approx(1.0, abs=0.35)


def test_a_number_at_its_limit_is_marked() -> None:
    (row,) = [r for r in _fitted(1.4, "mass") if r["site"] == "fore"]
    assert row["at_limit"] and row["value"] == pytest.approx(0.6 * np.exp(1.5 * 0.08))


_READ: dict[str, Callable[[Variant], float]] = {
    "mass fore": lambda v: v.model.body_mass[2],
    "com fore z": lambda v: v.model.body_ipos[2, 2],
    "inertia fore": lambda v: v.model.body_inertia[2].max(),
    "damping 1": lambda v: v.model.dof_damping[1],
    "armature 0": lambda v: v.model.dof_armature[0],
    "gain elbow_servo": lambda v: v.model.actuator_gainprm[1, 0],
    "rate gain elbow_servo": lambda v: -v.model.actuator_biasprm[1, 2],
    "timing of inputs": lambda v: v.inputs.delay[0],
    "zero q1": lambda v: v.outputs.bias[1],
}


@settings(max_examples=20, deadline=None)
@given(st.floats(-1.5, 1.5), st.sampled_from(sorted(_READ)))
def test_a_number_says_what_its_nuisance_does(z: float, name: str) -> None:
    plant = plant_of("arm")
    (nuisance,) = [n for n in enumerate_nuisances(plant, np.ones(2), np.ones(2), 0.005) if n.name == name]
    variant, number = Variant.nominal(plant), nuisance.described()
    assert number.value(0.0) == pytest.approx(_READ[name](variant), abs=1e-12)
    nuisance.apply(variant, z)
    assert number.value(z) == pytest.approx(_READ[name](variant), abs=1e-12)


@pytest.mark.parametrize("robot", ["pendulum", "cart_pole", "arm", "leg"])
def test_every_nuisance_of_the_library_is_described(robot: str) -> None:
    plant = plant_of(robot)
    size = np.ones(len(plant.inputs))
    for nuisance in enumerate_nuisances(plant, np.ones(len(plant.outputs)), size, 0.005):
        number = nuisance.described()
        assert number.unit != "prior deviations", nuisance.name
        assert number.value(1.0) != number.value(0.0)
        assert not number.site or number.site in nuisance.name or not nuisance.name.split()[-1].isalpha()


def test_a_nuisance_without_a_description_is_told_in_prior_deviations() -> None:
    assert Nuisance("mine", lambda v, z: None).described() == Number("mine", "", 0.0, 1.0, "prior deviations", False)


# -- remainder ---------------------------------------------------------------------------------------------------------


def _left(
    change: Callable[[mujoco.MjModel], None] | None = None,
    push: Callable[[mujoco.MjData], None] | None = None,
    auxiliary: dict[str, Array] | None = None,
) -> tuple[Residuals, Variant, Array]:
    """What the nominal arm leaves of a changed one."""

    def told(data: dict[str, object]) -> None:
        data["auxiliary"] = [{"column": name} for name in auxiliary or {}]

    plant: Plant = plant_of("arm", told)
    table = simulate("arm", 16.0, change=change, push=push) | (auxiliary or {})
    aligned = align(recording_from_table(table, plant), plant)
    replayer = Replayer(plant, aligned, cut(aligned), noise_floor(aligned), 1)
    nominal = Variant.nominal(plant)
    residuals = Residuals.build(replayer, nominal)
    return residuals, nominal, residuals.of([nominal])[0]


def _gap(residuals: Residuals, residual: Array) -> dict[str, object]:
    size = float(np.sqrt((residual[residuals.mask] ** 2).mean()))
    return {"before": 2.0 * size, "after": size, "typical": {"before": 2.0 * size, "after": size}}


def test_dry_friction_goes_with_the_direction_of_motion_at_its_joint() -> None:
    def dry(model: mujoco.MjModel) -> None:
        model.dof_frictionloss[1] = FRICTION

    residuals, nominal, residual = _left(dry)
    remainder = describe(residuals, nominal, residual, _gap(residuals, residual), 0.5)
    assert remainder["goes_with"][0]["variable"] == "the direction of motion at elbow"
    assert "most of it goes with the direction of motion at elbow" in remainder["sentence"]
    assert remainder["sentence"].endswith("so look for friction or play.") and remainder["predictable_share"] > 0.8


def test_a_force_that_depends_on_the_position_goes_with_it() -> None:
    def bumpy(data: mujoco.MjData) -> None:
        data.qfrc_applied[0] = 0.3 * np.cos(4.0 * data.qpos[0])

    residuals, nominal, residual = _left(push=bumpy)
    best, share = max(shares_of(residuals, nominal, residual)[0], key=lambda pair: pair[1])
    assert best.name == "the position of shoulder" and share > 0.8


def test_a_push_at_regular_times_is_told_with_its_frequency() -> None:
    def pushing(data: mujoco.MjData) -> None:
        data.qfrc_applied[1] = 0.15 * np.sin(2.0 * np.pi * 2.3 * data.time)

    residuals, nominal, residual = _left(push=pushing)
    remainder = describe(residuals, nominal, residual, _gap(residuals, residual), 0.1)
    assert remainder["goes_with"][0]["variable"] == "regular times (2.3 times a second)"
    assert remainder["goes_with"][0]["share"] > 0.8
    assert "fan" in remainder["sentence"]


def test_friction_that_changes_with_a_temperature_goes_with_it_and_not_with_time() -> None:
    t = 0.005 * np.arange(3200)
    warm = 30.0 + 10.0 * np.sin(2.0 * np.pi * t / 3.7)

    def rubbing(data: mujoco.MjData) -> None:
        now = float(np.interp(data.time, t, warm))
        data.qfrc_applied[1] = -0.012 * (now - 20.0) * np.tanh(50.0 * data.qvel[1])

    residuals, nominal, residual = _left(push=rubbing, auxiliary={"temperature": warm})
    shares = {v.name: s for v, s in shares_of(residuals, nominal, residual)[0]}
    assert shares["the temperature"] > 0.5 > 0.1 > shares["time"]


def test_a_remainder_of_the_size_of_the_noise_is_said_to_be_that() -> None:
    residuals, nominal, residual = _left()
    remainder = describe(residuals, nominal, residual, _gap(residuals, residual), 0.0)
    assert "about what repeating the experiment would leave" in remainder["sentence"]
