"""Torque that ripples with a joint's angle: its law, where a fit begins, what is found, and the corrected model."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
import yaml
from numpy.typing import NDArray
from robots import MAPS, MODELS, aligned_of, plant_of, simulate
from typer.testing import CliRunner

from simgap.analysis.diagnose import Diagnosis
from simgap.analysis.ripples import waves
from simgap.cli import app
from simgap.console import write_diagnosis
from simgap.correction.signals import Signals
from simgap.effects.base import Context, Wave
from simgap.effects.joint import TorqueRipple
from simgap.effects.library import enumerate_effects
from simgap.inference.fit import Fitter
from simgap.inference.hypothesis import Hypothesis
from simgap.inference.residual import Residuals
from simgap.many import Wanted, diagnose_files
from simgap.simulation.replay import Replayer
from simgap.simulation.scales import measure_scales
from simgap.simulation.variant import Variant
from simgap.simulation.windows import cut

Array = NDArray[np.float64]
Table = dict[str, Array]
_ORIGIN = 0.05


def _rippling(robot: str, joint: str, amplitude: float, period: float, off: float = 1.08, seed: int = 0) -> Table:
    """What a robot logs whose every mass is another too."""
    model = plant_of(robot).model
    j = model.joint(joint)
    dof, address = int(j.dofadr[0]), int(j.qposadr[0])

    def push(data: mujoco.MjData) -> None:
        data.qfrc_applied[dof] = amplitude * np.sin(2.0 * np.pi * (data.qpos[address] - _ORIGIN) / period)

    def heavier(model: mujoco.MjModel) -> None:
        model.body_mass[:] *= off

    return simulate(robot, 10.0, seed, change=heavier, push=push)


def _looked_at(robot: str, table: Table) -> tuple[Replayer, Context]:
    plant, aligned, floor = aligned_of(robot, table)
    replayer, nominal = Replayer(plant, aligned, cut(aligned), floor, 1), Variant.nominal(plant)
    scales = measure_scales(replayer, nominal)
    found = waves(replayer, replayer.run([nominal])[0], scales)
    return replayer, Context(plant, scales, waves=found)


def _ripples(context: Context) -> dict[str, TorqueRipple]:
    effects = enumerate_effects(context, only=("torque_ripple",))
    return {e.site.name: e for e in effects if isinstance(e, TorqueRipple)}


def test_the_replay_is_a_plain_simulation_with_the_torque_applied() -> None:
    plant, aligned, floor = aligned_of("arm", simulate("arm", 6.0))
    replayer, variant = Replayer(plant, aligned, cut(aligned, 0.3), floor, 1), Variant.nominal(plant)
    effect = _ripples(Context(plant, measure_scales(replayer, variant)))["elbow"]
    amplitude, period, origin = 0.4, 0.3, 0.1
    effect.apply(variant, (amplitude, period, origin))
    windows, model = replayer.windows, plant.model
    nominal, found = replayer.run([Variant.nominal(plant), variant], np.array([2]))[:, 0]
    data, row, rows = mujoco.MjData(model), int(windows.start[2]), []
    data.qpos[replayer.state.qpos] = replayer.state.position[row]
    data.qvel[replayer.state.dof] = replayer.state.velocity[row]
    dof, steps = int(model.joint("elbow").dofadr[0]), round(aligned.period / model.opt.timestep)
    for k in range(windows.length):
        for i, channel in enumerate(plant.inputs):
            data.ctrl[channel.actuator] = aligned.inputs[row + k, i]
        mujoco.mj_forward(model, data)
        rows.append(plant.read(data.sensordata))
        for _ in range(steps):
            turned = data.qpos[model.joint("elbow").qposadr[0]] - origin
            data.qfrc_applied[dof] = amplitude * np.sin(2.0 * np.pi * turned / period)
            mujoco.mj_step(model, data)
    expected = np.array(rows)[windows.sample]
    assert np.abs(found - nominal).max() > 0.01
    np.testing.assert_allclose(found, expected, atol=1e-9)


@pytest.mark.parametrize(
    ("robot", "joint", "amplitude", "share"),
    [("pendulum", "hinge", 0.1, 0.11), ("pendulum", "hinge", 0.3, 0.3), ("arm", "elbow", 0.2, 0.2)],
)
def test_period_and_amplitude_are_found(robot: str, joint: str, amplitude: float, share: float) -> None:
    """Beside masses that are 8 % off, from what the recording suggests."""
    swing = float(np.ptp(simulate(robot, 10.0)["q1" if robot == "arm" else "q"]))
    replayer, context = _looked_at(robot, _rippling(robot, joint, amplitude, share * swing))
    effect = _ripples(context)[joint]
    nominal = Variant.nominal(context.plant)
    fitter = Fitter(Residuals.build(replayer, nominal), [])
    points = [(np.array(start), np.zeros(0)) for start in effect.starts()]
    costs = fitter.data_cost(fitter.mean_square(fitter.replay(Hypothesis((effect,)), points)))
    begun = points[int(np.argmin(costs))][0]
    assert begun[1] == pytest.approx(share * swing, rel=0.04)
    fit = fitter.fit(Hypothesis((effect,)), begun, np.zeros(0), iterations=8)
    assert fit.x[0] == pytest.approx(amplitude, rel=0.1)
    assert fit.x[1] == pytest.approx(share * swing, rel=0.02)
    waves_off = (fit.x[2] - _ORIGIN) / (share * swing)
    assert abs(waves_off - round(waves_off)) < 0.05


def test_how_strong_it_is_says_nothing_of_its_period() -> None:
    _, context = _looked_at("pendulum", simulate("pendulum", 8.0))
    (effect,) = _ripples(context).values()
    amplitude, period, origin = effect.starts()[0]
    assert effect.times(0.5, (amplitude, period, origin)) == (0.5 * amplitude, period, origin)
    assert effect.times(-1.0, (amplitude, period, origin)) is None


def test_it_is_sought_at_measured_joints_that_a_drive_moves() -> None:
    _, context = _looked_at("finger", simulate("finger", 8.0))
    assert set(_ripples(context)) == {"wrist"}, "a cable moves the knuckle"
    context.waves = {}
    assert not _ripples(context)
    known = {"where": "joint", "name": "wrist", "value": 0.1}
    rows = [{**known, "quantity": q} for q in ("ripple", "ripple_period", "ripple_origin")]
    corrected = plant_of("finger", lambda data: data.update(signals=rows))
    joint = int(corrected.model.joint("wrist").id)
    assert not _ripples(Context(corrected, context.scales, waves={joint: (Wave(0.1, 0.1, 0.0),)}))


def test_the_exported_wrapper_applies_it() -> None:
    model = mujoco.MjModel.from_xml_string(MODELS["arm"])
    rows = {"ripple": 0.4, "ripple_period": 0.3, "ripple_origin": 0.1}
    signals = Signals(model, [{"where": "joint", "name": "elbow", "quantity": q, "value": v} for q, v in rows.items()])
    data = mujoco.MjData(model)
    for angle in (0.1, 0.175, 0.3, -0.2):
        data.qpos[model.joint("elbow").qposadr[0]] = angle
        signals.step(data, np.zeros(model.nu))
        expected = 0.4 * np.sin(2.0 * np.pi * (angle - 0.1) / 0.3)
        np.testing.assert_allclose(data.qfrc_applied, [0.0, expected], atol=1e-12)


def test_a_corrected_model_leaves_nothing_to_find(tmp_path: Path) -> None:
    """It is named alone among what it could be taken for; the model that `apply` writes has no gap in a second log."""
    only = ("torque_ripple", "coulomb_friction", "viscous_friction", "joint_stiffness", "servo_gain", "servo_dead_band")

    def answer(seed: int, model: Path, map_: Path) -> Diagnosis:
        table = _rippling("pendulum", "hinge", 0.15, 0.45, off=1.03, seed=seed)
        log = tmp_path / f"log_{seed}.npz"
        np.savez(log, **table)  # type: ignore[arg-type]
        return diagnose_files(Wanted((log,), model, map_, only=only, baselines=False, threads=1))

    robot, mapping = tmp_path / "robot.xml", tmp_path / "map.yaml"
    robot.write_text(MODELS["pendulum"])
    mapping.write_text(yaml.safe_dump(MAPS["pendulum"]))
    found = answer(0, robot, mapping)
    (effect,) = found.report["effects"]
    assert (effect["name"], effect["site"]) == ("torque_ripple", "hinge")
    assert effect["parameters"]["amplitude"]["value"] == pytest.approx(0.15, rel=0.1)
    assert effect["parameters"]["period"]["value"] == pytest.approx(0.45, rel=0.02)
    write_diagnosis(found, tmp_path / "diagnosis", None)
    given = ["--model", str(robot), "--map", str(mapping), "--out", str(tmp_path / "new.xml")]
    result = CliRunner().invoke(app, ["apply", str(tmp_path / "diagnosis"), *given])
    assert result.exit_code == 0, result.output
    assert answer(1, tmp_path / "new.xml", tmp_path / "new_map.yaml").verdict.kind == "no_gap"
