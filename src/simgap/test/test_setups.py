"""Runs that differ in gains, payload or supply, as the map says."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray
from robots import plant_of, simulate

from simgap.analysis.diagnose import diagnose
from simgap.analysis.options import Options
from simgap.data.align import align
from simgap.data.errors import GapInputError
from simgap.data.noise_floor import noise_floor
from simgap.data.recording import concatenate, recording_from_table
from simgap.data.setup import add_point_mass
from simgap.simulation.replay import Replayer
from simgap.simulation.variant import Variant
from simgap.simulation.windows import cut

Array = NDArray[np.float64]
LOAD, PLACE = 0.4, (0.02, 0.0, -0.25)
RUNS = {
    1.0: {"gains": {"elbow_servo": {"kp": 6.0, "kd": 0.5}}},
    2.0: {"payload": {"body": "fore", "mass": LOAD, "pos": PLACE}},
    3.0: {"supply": 10.0},
}


def _segments(data: dict[str, object]) -> None:
    data["segments"] = {"column": "run", "supply": 12.0, "runs": RUNS}


def _soft(model: mujoco.MjModel) -> None:
    model.actuator_gainprm[1, 0], model.actuator_biasprm[1, 1] = 6.0, -6.0


def _loaded(model: mujoco.MjModel) -> None:
    add_point_mass(model, model.body("fore").id, LOAD, PLACE)


def _weak(model: mujoco.MjModel) -> None:
    model.actuator_gainprm[:, 0] *= 10.0 / 12.0
    model.actuator_biasprm[:, 1] *= 10.0 / 12.0


def _table(fault: float = 0.0) -> dict[str, Array]:
    parts = []
    for run, change in enumerate((lambda model: None, _soft, _loaded, _weak)):

        def changed(model: mujoco.MjModel, change: object = change) -> None:
            change(model)  # type: ignore[operator]
            model.dof_frictionloss[1] += fault

        made = simulate("arm", 5.0, run, change=changed)
        parts.append(made | {"run": np.full(len(made["t"]), float(run))})
    return {k: np.concatenate([p[k] for p in parts]) for k in parts[0]}


def test_each_window_is_replayed_as_its_run_was() -> None:
    plant = plant_of("arm", _segments)
    aligned = align(recording_from_table(_table(), plant), plant)
    assert [run.setup for run in aligned.runs] == [0, 1, 2, 3]
    floor = noise_floor(aligned)
    replayer = Replayer(plant, aligned, cut(aligned), floor, 1)
    measured = aligned.outputs[replayer.windows.rows()]
    found = replayer.run([Variant.nominal(plant)])[0]
    error = np.sqrt((((found - measured) / floor) ** 2).mean(axis=(1, 2)))
    assert np.median(error) < 3.0
    blind = plant_of("arm", lambda data: data.update(segments={"column": "run"}))
    other = Replayer(blind, align(recording_from_table(_table(), blind), blind), replayer.windows, floor, 1)
    wrong = np.sqrt((((other.run([Variant.nominal(blind)])[0] - measured) / floor) ** 2).mean(axis=(1, 2)))
    run = np.searchsorted([r.start for r in aligned.runs], replayer.windows.start, side="right") - 1
    for label in (1, 2, 3):
        assert np.median(wrong[run == label]) > 3.0 * np.median(error[run == label])


def test_whole_runs_are_held_out_and_a_fault_is_found_in_all_of_them() -> None:
    plant = plant_of("arm", _segments)
    table = _table(0.1)
    aligned = align(recording_from_table(table, plant), plant)
    windows = cut(aligned)
    for run in aligned.runs:
        inside = (windows.start >= run.start) & (windows.start < run.stop)
        assert len(set(windows.fold[inside].tolist())) == 1
    options = Options(only=("coulomb_friction", "servo_gain", "mass"), threads=1, baselines=False)
    report = diagnose([recording_from_table(table, plant)], plant, options).report
    assert [(e["name"], e["site"]) for e in report["effects"]] == [("coulomb_friction", "elbow")]
    assert all(not row["fitted_on_it"] for row in report["free_running"])


def test_several_recordings_keep_their_setups() -> None:
    plant = plant_of("arm", _segments)
    table = _table()
    halves = [recording_from_table({k: v[table["run"] == run] for k, v in table.items()}, plant) for run in (2.0, 1.0)]
    assert [run.setup for run in align(concatenate(halves), plant).runs] == [2, 1]
    assert any("no run 3" in warning for recording in halves for warning in recording.warnings)


def test_a_point_mass_moves_mass_centre_and_inertia() -> None:
    """Against MuJoCo's own: the same mass as a small sphere, welded on."""
    xml = """<mujoco><worldbody><body name="b"><joint type="ball"/>
    <geom type="box" size=".1 .03 .05" pos=".1 .02 0" euler="20 30 0" mass="0.7"/>{}</body>
    </worldbody></mujoco>"""
    welded = xml.format('<body pos=".02 .1 -.25"><geom type="sphere" size="1e-4" mass="0.4"/></body>')
    model, truth = (mujoco.MjModel.from_xml_string(text) for text in (xml.format(""), welded))
    add_point_mass(model, 1, 0.4, (0.02, 0.1, -0.25))
    mujoco.mj_setConst(model, mujoco.MjData(model))
    rng = np.random.default_rng(0)
    for _ in range(5):
        acceleration, found = rng.standard_normal(3), []
        for m in (model, truth):
            data = mujoco.MjData(m)
            data.qvel[:], data.qacc[:] = 0.5, acceleration
            mujoco.mj_inverse(m, data)
            found.append(np.array(data.qfrc_inverse))
        np.testing.assert_allclose(found[0], found[1], atol=1e-5)


def test_names_that_the_model_lacks_are_refused() -> None:
    def wrong(data: dict[str, object]) -> None:
        data["segments"] = {"column": "run", "runs": {2.0: {"payload": {"body": "forearm", "mass": 1.0}}}}

    with pytest.raises(GapInputError, match=r"segments.runs.2.payload.body: the model has no body 'forearm'.*fore"):
        plant_of("arm", wrong)

    def negative(data: dict[str, object]) -> None:
        data["segments"] = {"column": "run", "runs": {2.0: {"supply": -1.0}}}

    with pytest.raises(GapInputError, match="supply"):
        plant_of("arm", negative)
