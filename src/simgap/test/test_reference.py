"""What has changed since a robot was well, where its model is wrong all along."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray
from robots import plant_of, simulate

from simgap.analysis.diagnose import Diagnosis, diagnose
from simgap.analysis.options import Options
from simgap.analysis.reference import learn
from simgap.data.recording import recording_from_table
from simgap.report.sentences import sentences

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
    well = [recording_from_table(_table(seed), plant) for seed in (1,)]
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
    made = learn([recording_from_table(_table(1), plant)], plant, Options(only=SOME, threads=1))
    assert made.known and all(0.0 < sd <= 1.0 for sd in made.known.values())
    assert min(made.known.values()) < 0.5
    assert (made.scale >= 1.0).all()
    # The base is the robot as it is: heavier than the model.
    assert made.base.model.body_mass[2] > 1.05 * plant.model.body_mass[2]
