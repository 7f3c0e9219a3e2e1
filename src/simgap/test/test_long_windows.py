"""The winner's numbers in long windows: what a run that nobody puts back to the measurement needs."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray
from robots import plant_of, simulate

from simgap.analysis.diagnose import Diagnosis, diagnose
from simgap.analysis.options import Options
from simgap.analysis.recalibration import calibration
from simgap.data.recording import recording_from_table
from simgap.inference import budget, long_windows
from simgap.inference.long_windows import WIDER, folds_of_runs, refit, settled, some, undrawn
from simgap.report.sentences import sentences
from simgap.simulation.variant import Variant
from simgap.simulation.windows import Windows, compared

Array = NDArray[np.float64]
SECONDS, DRAG, FRICTION = 5.5, 1.7, 0.25


def _truth(model: mujoco.MjModel) -> None:
    model.actuator_biasprm[:, 2] *= DRAG
    model.dof_frictionloss[-1] += FRICTION


def _diagnosed(seconds: float | None = None, robot: str = "arm", runs: int = 3, length: float = SECONDS) -> Diagnosis:
    parts = []
    for run in range(runs):
        made = simulate(robot, length, run, change=_truth)
        parts.append(made | {"run": np.full(len(made["t"]), float(run))})
    table = {k: np.concatenate([p[k] for p in parts]) for k in parts[0]}
    plant = plant_of(robot, lambda data: data.update(segments={"column": "run"}))
    recording = recording_from_table(table, plant)
    options = Options(only=("coulomb_friction",), max_windows=12, baselines=False, budget=seconds)
    return diagnose([recording], plant, options)


@pytest.fixture(scope="module")
def found() -> Diagnosis:
    return _diagnosed()


def test_long_windows_tell_a_number_that_priors_held_back(found: Diagnosis) -> None:
    best, fitter, longer = found.selection.best.fit, found.selector.fitter, found.longer
    assert longer is not None
    assert longer.horizon == pytest.approx(5.0, abs=0.1)
    assert longer.gain > 0.0
    assert longer.wider in WIDER[1:]
    model = fitter.residuals.replayer.plant.model
    for joint in range(model.njnt):
        # Damping of the joint and of its servo are one to a joint.
        nominal, short, long = (_drag(found, z, joint) for z in (0.0 * best.z, best.z, longer.fit.z))
        truth = nominal + (DRAG - 1.0) * -float(model.actuator_biasprm[joint, 2])
        assert long == pytest.approx(truth, rel=0.1)
        assert abs(short - truth) > 2.0 * abs(long - truth)
    for row in calibration(fitter, best, longer):
        assert row["ci90"][0] <= row["value"] <= row["ci90"][1]
        assert abs(row["prior_deviations"]) <= longer.box.max() + 1e-9


def test_free_runs_and_the_report_take_its_numbers(found: Diagnosis) -> None:
    report = found.report
    assert report["long_windows"]["prior_wider"] in WIDER[1:]
    by_model = {(row["run"], row["model"]): row for row in report["free_running"]}
    for run in (0.0, 1.0, 2.0):
        nominal, ours = by_model[run, "nominal"], by_model[run, "diagnosed"]
        assert not ours["fitted_on_it"]
        assert all(ours["rmse"][q] < 0.05 * nominal["rmse"][q] for q in ("q0", "q1"))
    (effect,) = report["effects"]
    assert effect["parameters"]["friction_elbow"]["value"] == pytest.approx(FRICTION, rel=0.05)
    (said,) = [s for s in sentences(report) if "windows of 5 s" in s]
    assert "times as far off as usual" in said
    written = {(r["name"], r["site"]): r["value"] for r in report["calibration"]}
    assert written["rate gain", "elbow_servo"] == pytest.approx(DRAG * 0.5, rel=0.1)


def _drag(found: Diagnosis, z: Array, joint: int) -> float:
    """Damping of a joint with its servo's [N m s/rad]."""
    made = found.selector.fitter.variant(found.selection.best.fit.hypothesis, found.selection.best.fit.x, z).model
    return float(made.dof_damping[joint] - made.actuator_biasprm[joint, 2])


@pytest.mark.parametrize("off", [0.0, 0.5])
def test_wrong_sensitivities_to_begin_with_lead_to_the_same_end(found: Diagnosis, off: float) -> None:
    """And there a fit with new ones gains nothing to speak of."""
    fitter, best = found.selector.fitter, found.selection.best.fit
    wrong = (1.0 - off) * best.effect_jacobian
    with fitter.sensitivities_kept():
        fitter.jacobian = ((1.0 - off) * fitter.jacobian).astype(np.float32)
        end = settled(fitter, best.hypothesis, 0.5 * best.x, np.full_like(best.z, 0.5), wrong)
        fitter.refresh(end.hypothesis, end.x, end.z, end.residual)
        further = fitter.fit(end.hypothesis, end.x, end.z)
    assert end.cost - further.cost < 1.0
    assert end.cost == pytest.approx(best.cost, abs=1.0)
    np.testing.assert_allclose(end.x, best.x, rtol=0.05)


def test_a_damped_step_is_shorter_and_leads_down(found: Diagnosis) -> None:
    fitter, best = found.selector.fitter, found.selection.best.fit
    z = np.full_like(best.z, 0.3)
    residual = fitter.replay(best.hypothesis, [(best.x, z)])[0]
    far = np.full_like(best.x, 10.0)
    steps = []
    for damping in (0.0, 0.3, 30.0):
        dx, dz, normal = fitter.solve(residual, best.effect_jacobian, z, -far, far, damping=damping)
        steps.append(float(np.sqrt(np.diag(normal) @ np.concatenate([dx, dz]) ** 2)) / np.sqrt(1.0 + damping))
        foreseen = residual + np.tensordot(dx, best.effect_jacobian, 1) + np.tensordot(dz, fitter.jacobian, 1)
        assert fitter.cost(foreseen, z + dz) < fitter.cost(residual, z)
    assert steps[0] > steps[1] > steps[2] > 0.0


def test_its_numbers_are_in_the_units_of_the_short_windows(found: Diagnosis) -> None:
    fitter = found.selector.fitter
    nuisance = next(n for n in fitter.nuisances if undrawn(n) and n.name.startswith("damping"))
    one, other = (Variant.nominal(fitter.residuals.replayer.plant) for _ in range(2))
    nuisance.scaled(4.0).apply(one, 0.3)
    nuisance.apply(other, 1.2)
    np.testing.assert_allclose(one.model.dof_damping, other.model.dof_damping)
    assert nuisance.scaled(4.0).described().value(0.3) == pytest.approx(nuisance.described().value(1.2))


def test_drawn_numbers_keep_their_priors(found: Diagnosis) -> None:
    drawn = {n.name.split()[0] for n in found.selector.fitter.nuisances if not undrawn(n)}
    assert drawn >= {"mass", "com", "inertia"}


def test_two_runs_are_too_few(found: Diagnosis) -> None:
    whole, windows = found.aligned, found.selector.fitter.windows
    assert folds_of_runs(whole, windows) == {0.0: 0, 1.0: 1, 2.0: 2}
    assert folds_of_runs(replace(whole, runs=whole.runs[:2]), windows) is None
    assert folds_of_runs(replace(whole, held_out=(2.0,)), windows) is None


def test_a_search_that_ended_in_time_leaves_them_theirs(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a budget gives to long windows is not thrown away where the search has used up its own part."""
    reached: list[str] = []
    monkeypatch.setattr(
        budget.Budget, "spent", lambda self, share=1.0: "screen partners" in reached and share == budget.SEARCH
    )
    watch = budget.Budget.watch
    monkeypatch.setattr(budget.Budget, "watch", lambda self, _: watch(self, lambda name, _: reached.append(name)))
    hurried = _diagnosed(60.0)
    assert any("within the budget" in warning for warning in hurried.report["warnings"])
    assert [e["name"] for e in hurried.report["effects"]] == ["coulomb_friction"]
    assert hurried.longer is not None and hurried.longer.gain > 0.0


def test_time_that_ends_between_two_priors_leaves_what_earlier_ones_told(monkeypatch: pytest.MonkeyPatch) -> None:
    shares: list[float] = []
    watch = budget.Budget.watch

    def noting(stage: str, share: float) -> None:
        if stage == "long windows":
            shares.append(share)

    monkeypatch.setattr(budget.Budget, "spent", lambda self, share=1.0: max(shares, default=0.0) > 0.6 and share < 1.0)
    monkeypatch.setattr(budget.Budget, "watch", lambda self, _: watch(self, noting))
    report = _diagnosed(1e6).report
    assert report["long_windows"]["prior_wider"] in WIDER[:2]
    assert any("numbers were not fitted again by every prior" in w for w in report["warnings"])
    assert shares == sorted(shares) and len(shares) > 3


def _windows(*runs: int) -> tuple[Windows, NDArray[np.int64]]:
    """Windows of 50 rows, so many of each run, and whose each is; each is a block of its own."""
    count, run = sum(runs), np.repeat(np.arange(len(runs)), runs)
    return Windows(50 * np.arange(count) + 5, 5, 50, compared(50), np.arange(count), run % 3), run


def test_some_windows_are_of_every_run_and_spread_over_it() -> None:
    windows, run = _windows(6, 6, 2, 5, 2, 6)
    few = some(windows, run, rows=10 * 50)
    assert few is not None
    assert few.start.tolist() == [windows.start[i] for i in (1, 4, 7, 10, 13, 16, 20, 22, 25)]
    assert few.fold.tolist() == [0, 0, 1, 1, 2, 0, 1, 2, 2]


@pytest.mark.parametrize(("runs", "rows"), [((6, 6, 6), 700), ((1, 1, 1, 1, 1, 1), 50), ((9, 9, 1), 50)])
def test_all_windows_are_begun_with_where_few_would_save_little(runs: tuple[int, ...], rows: int) -> None:
    """Or where they would be too few to fit and to hold out."""
    assert some(*_windows(*runs), rows) is None


@pytest.fixture(scope="module")
def long_runs() -> Diagnosis:
    return _diagnosed(robot="pendulum", runs=6, length=15.8)


def test_long_runs_are_begun_with_some_windows_and_ended_with_all(
    long_runs: Diagnosis, monkeypatch: pytest.MonkeyPatch
) -> None:
    ended = long_runs.longer
    assert ended is not None and ended.windows == 18
    monkeypatch.setattr(long_windows, "_SAVES", 0.0)
    whole = refit(long_runs.selector.fitter, long_runs.selection.best.fit)
    assert whole is not None and whole.windows == 18
    assert ended.fit.cost == pytest.approx(whole.fit.cost, abs=1.0)
    np.testing.assert_allclose(ended.fit.x, whole.fit.x, rtol=0.01)


def test_some_windows_stand_where_the_time_is_over_before_all_are_fitted(
    long_runs: Diagnosis, monkeypatch: pytest.MonkeyPatch
) -> None:
    fitter, settle = long_runs.selector.fitter, long_windows.settled
    left = replace(fitter.budget, left_out=[], asked=60.0)

    def hurried(own: long_windows.Fitter, *given: object) -> long_windows.Fit:
        if len(own.windows) == 18:
            raise budget.OutOfTimeError("long windows")
        return settle(own, *given)  # type: ignore[arg-type]

    monkeypatch.setattr(long_windows, "settled", hurried)
    monkeypatch.setattr(fitter, "budget", left)
    near = refit(fitter, long_runs.selection.best.fit)
    assert near is not None and near.windows == 6
    assert near.gain > 0.0
    assert "in a part of them" in left.warning()
