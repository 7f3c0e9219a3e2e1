"""What has changed since a robot was well, where its model is wrong all along."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray
from robots import plant_of, simulate

from simgap.analysis.comparison import Comparison
from simgap.analysis.diagnose import Diagnosis, diagnose
from simgap.analysis.options import Options
from simgap.analysis.reference import learn
from simgap.analysis.search import search
from simgap.data.align import align
from simgap.data.noise_floor import noise_floor
from simgap.data.plant import Plant
from simgap.data.recording import recording_from_table
from simgap.inference.budget import Budget
from simgap.inference.familiar import Motion
from simgap.inference.healthy import Healthy, fitting
from simgap.inference.nuisance import Nuisance, enumerate_nuisances
from simgap.inference.verdict import judge
from simgap.report.sentences import sentences
from simgap.simulation.replay import Replayer
from simgap.simulation.variant import Variant
from simgap.simulation.windows import cut

Array = NDArray[np.float64]
SOME = ("coulomb_friction", "servo_gain", "mass")


def _never_right(model: mujoco.MjModel) -> None:
    """Many numbers are off, and a joint rubs; the robot has always been so."""
    model.body_mass[:] *= 1.2
    model.body_inertia[:] *= 1.2
    model.actuator_gainprm[:, 0] *= 0.9
    model.actuator_biasprm[:, 1] *= 0.9
    model.dof_frictionloss[0] += 0.15


def _uneven(data: mujoco.MjData) -> None:
    """And something that no library has."""
    data.qfrc_applied[1] += 0.08 * np.cos(5.0 * data.qpos[1]) - data.qfrc_applied[1]


def _table(seed: int, fault: Callable[[mujoco.MjModel], None] | None = None) -> dict[str, Array]:
    def change(model: mujoco.MjModel) -> None:
        _never_right(model)
        if fault:
            fault(model)

    return simulate("arm", 8.0, seed, change=change, push=_uneven)


def _diagnosed(table: dict[str, Array]) -> Diagnosis:
    plant = plant_of("arm")
    well = [recording_from_table(_table(1), plant)]
    options = Options(only=SOME, threads=1, baselines=False, reference=well, keep=lambda e: not e.form)
    return diagnose([recording_from_table(table, plant)], plant, options)


def test_what_has_always_been_so_is_no_fault() -> None:
    found = _diagnosed(_table(3))
    assert found.report["verdict"] in ("no_gap", "calibration") and found.report["effects"] == []
    assert found.report["reference"]["recordings"] == 1 and "coulomb_friction@shoulder" in (
        " ".join(found.report["reference"]["constant"])
    )
    assert found.report["gap"]["before"] < 1.6


def test_what_is_new_is_named_with_its_size() -> None:
    def rubbing(model: mujoco.MjModel) -> None:
        model.dof_frictionloss[1] += 0.12

    found = _diagnosed(_table(3, rubbing))
    assert [(e["name"], e["site"]) for e in found.report["effects"]] == [("coulomb_friction", "elbow")]
    assert found.report["effects"][0]["parameters"]["friction"]["value"] == pytest.approx(0.12, rel=0.2)
    assert any("healthy robot" in text for text in sentences(found.report))


def test_nominal_numbers_are_known_better_than_before() -> None:
    plant = plant_of("arm")
    made, *_ = learn([recording_from_table(_table(1), plant)], plant, Options(only=SOME, threads=1))
    assert made.known and all(0.0 < sd <= 1.0 for sd in made.known.values())
    assert min(made.known.values()) < 0.5
    assert (made.scale >= 1.0).all()
    # The base is the robot as it is: heavier than the model.
    assert made.base.model.body_mass[2] > 1.05 * plant.model.body_mass[2]


@pytest.mark.parametrize("gentle", [True, False])
def test_what_shows_only_where_the_reference_never_was_is_not_new(gentle: bool) -> None:
    """A servo that has always been weak, which shows in large motions only."""

    def weak(model: mujoco.MjModel) -> None:
        model.actuator_forcerange[0] = (-0.5, 0.5)

    plant = plant_of("pendulum")
    tables = [simulate("pendulum", 6.0, s, change=weak, told=t) for s, t in ((1, 0.2 if gentle else 1.0), (3, 1.0))]
    well, new = (recording_from_table(table, plant) for table in tables)
    only = ("coulomb_friction", "servo_torque_limit")
    options = Options(only=only, threads=1, baselines=False, reference=[well], keep=lambda e: not e.form)
    found = diagnose([new], plant, options).report
    warned = [text for text in found["warnings"] if "where the reference never was" in text]
    if gentle:
        assert found["verdict"] == "unknown" and "where the reference never was" in found["reasons"][0]
        assert found["reference"]["windows"]["unlike"] == found["reference"]["windows"]["of"] and warned
    else:
        assert found["verdict"] in ("no_gap", "calibration")
        assert found["reference"]["windows"]["unlike"] == 0 and not warned


@pytest.mark.parametrize(("friction", "missed", "named"), [(0.003, 1.0, True), (0.003, 3.0, False), (0.02, 3.0, True)])
def test_no_cause_is_named_that_explains_what_is_missed_anyway(friction: float, missed: float, named: bool) -> None:
    """What is missed of the healthy robot is no noise where it is a gap (more than 1.6)."""

    def rubbing(model: mujoco.MjModel) -> None:
        model.dof_frictionloss[0] += friction

    plant = plant_of("pendulum")
    new = recording_from_table(simulate("pendulum", 6.0, 3, change=rubbing), plant)
    options = Options(only=("coulomb_friction",), threads=1, baselines=False, keep=lambda e: not e.form)
    found = search([new], plant, options, Budget())
    replayer = found.fitter.residuals.replayer
    nominal = Variant.nominal(plant)
    well = Healthy(nominal, {}, np.ones(1), Motion.of(replayer, nominal), 0.0, {"typical": missed})
    beside = Comparison(well, replayer)
    assert found.selection.best.key == "coulomb_friction@hinge"
    beside.settle(found.selector.scores, found.selection)
    assert (found.selection.best is not found.selection.reference) == named
    assert bool(beside.warnings) != named
    # The answer is the likeliest, and says so.
    verdict = judge(found.selector, found.selection)
    assert (verdict.kind in ("no_gap", "calibration")) != named and verdict.sure > 0.5


def test_a_motion_is_strange_by_how_far_and_where_it_goes() -> None:
    def motion(low: list[float], high: list[float], on: bool = True, bounded: bool = True, s: float = 0.6) -> Motion:
        rows = np.array([low, high]).T[:, :, None]
        count = len(low)
        return Motion(rows[:, 0], rows[:, 1], np.full(count, on), np.array([bounded]), np.array([1e-3]), s)

    known = motion([-1.0, 0.0], [0.0, 1.0])
    assert not motion([-0.5, 0.2], [0.5, 1.1]).strange(known)[0].any()
    strange, times = motion([-1.0, 0.0], [1.0, 0.5]).strange(known)
    assert strange.tolist() == [True, False] and times == pytest.approx([2.0])
    # As fast over twice the time; another place, which counts for joints only; and servos that are off.
    assert not motion([-1.0], [1.0], s=1.2).strange(known)[0].any()
    assert motion([3.0], [3.5]).strange(known)[0].all()
    assert not motion([3.0], [3.5], bounded=False).strange(known)[0].any()
    assert motion([0.0], [0.5], on=False).strange(known)[0].all()


@pytest.mark.parametrize("rubs", [False, True])
def test_a_new_recording_tells_what_the_reference_left_open(rubs: bool) -> None:
    def rubbing(model: mujoco.MjModel) -> None:
        model.dof_frictionloss[1] += 0.12

    plant = plant_of("arm")
    table = simulate("arm", 6.0, 3, change=rubbing if rubs else None)
    aligned = align(recording_from_table(table, plant), plant)
    replayer = Replayer(plant, aligned, cut(aligned), noise_floor(aligned), 1)
    other = plant_of("arm")
    rubbing(other.model)
    # The reference speaks for a joint that runs free, but not much.
    bases = [
        Healthy(base, {}, np.ones(len(plant.outputs)), Motion.of(replayer, base), score, {})
        for base, score in ((Variant.nominal(plant), 100.0), (Variant.nominal(other), 105.0))
    ]

    def nuisances(of: Plant) -> list[Nuisance]:
        return enumerate_nuisances(of, aligned.outputs.std(axis=0), np.ones(len(of.inputs)), aligned.period)

    assert fitting(bases, replayer, nuisances, Budget()) is bases[rubs]
