"""What a diagnosis has found, written into models of any robot, and what no model holds, beside them."""

from __future__ import annotations

import importlib.util
import json
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import mujoco
import numpy as np
import pytest
import yaml
from numpy.typing import NDArray
from robots import ARM, MAPS, MODELS, simulate
from typer.testing import CliRunner

from simgap.cli import app
from simgap.correction.apply import apply
from simgap.correction.changes import Change, Correction, Signal, correction
from simgap.correction.mjcf import write_mjcf
from simgap.correction.ranges import draw, ranges, write_ranges
from simgap.correction.signals import Signals
from simgap.data.errors import GapInputError
from simgap.data.mapping import parse_map
from simgap.data.plant import Plant, build_plant
from simgap.simulation.variant import Variant

Array = NDArray[np.float64]

ROBOT = """<mujoco model="robot"><!-- of a workshop -->
  <compiler angle="{angle}"/>
  <default><default class="servo"><position kp="20" kv="0.7"/></default></default>
  <worldbody>
    <geom name="floor" type="plane" size="2 2 .1"/>
    <body name="upper" pos="0 0 1">   <!-- turned from one piece -->
      <joint name="shoulder" axis="0 1 0" damping="0.1" range="{range}"
             springref="{spring}" stiffness="2"/>
      <geom name="tube" type="capsule" fromto="0 0 0 0 0 -.3" size=".02"/>
      <body name="fore" pos="0 0 -.3">
        <inertial pos="0 0 -.1" mass=".4" fullinertia="0.004 0.003 0.002 0.0001 0 0"/>
        <joint name="elbow" axis="0 1 0"/>
        <geom name="tip" size=".03" pos="0 0 -.2"/>
      </body>
    </body>
  </worldbody>
  <tendon><fixed name="belt" stiffness="3"><joint joint="shoulder" coef="1"/></fixed></tendon>
  <actuator>
    <position name="shoulder_servo" joint="shoulder" class="servo" forcerange="-5 5"/>
    <motor name="elbow_motor" joint="elbow"/>
  </actuator>
</mujoco>
"""
NATIVE = ROBOT.format(angle="radian", range="-1 2", spring="0.3")
DEGREES = ROBOT.format(angle="degree", range=f"{np.degrees(-1)} {np.degrees(2)}", spring=f"{np.degrees(0.3)}")
MAP: dict[str, Any] = {
    "time": {"column": "t", "unit": "s"},
    "inputs": [
        {"column": "u0", "unit": "rad", "actuator": "shoulder_servo", "kind": "position"},
        {"column": "u1", "unit": "N m", "actuator": "elbow_motor", "kind": "torque"},
    ],
    "outputs": [{"column": f"q{i}", "unit": "rad", "joint": j, "quantity": "position"}
                for i, j in enumerate(("shoulder", "elbow"))],
}  # fmt: skip


def _plant(xml: str, **more: object) -> Plant:
    return build_plant(mujoco.MjSpec.from_string(xml), parse_map({**MAP, **more}))


def _everything(model: mujoco.MjModel) -> None:
    """What the library's effects do to a model, all at once."""
    shoulder, elbow = (int(model.jnt_dofadr[model.joint(n).id]) for n in ("shoulder", "elbow"))
    model.dof_damping[shoulder] += 0.2
    model.dof_frictionloss[elbow] = 0.08
    model.dof_solref[elbow] = (0.006, 1.0)
    model.dof_solimp[elbow, :2] = 0.97
    model.dof_armature[elbow] = 0.004
    model.jnt_stiffness[shoulder] *= 0.5
    model.qpos_spring[shoulder] += 0.1
    model.jnt_range[elbow] = (-1e3, 0.7)
    model.jnt_limited[elbow] = 1
    model.jnt_solref[elbow] = (0.004, 1.0)
    model.actuator_gainprm[0, 0] *= 0.6
    model.actuator_biasprm[0, 1] *= 0.6
    model.actuator_forcerange[0] = (-2.5, 2.5)
    model.actuator_gainprm[1, 0] *= 0.9
    model.actuator_forcerange[1] = (-1.0, 1.0)
    model.actuator_forcelimited[1] = 1
    for body in ("upper", "fore"):
        index = model.body(body).id
        model.body_mass[index] *= 1.3
        model.body_inertia[index] *= 1.1
        model.body_ipos[index] += (0.01, 0.0, -0.02)
        model.body_sameframe[index] = model.body_simple[index] = 0
    model.tendon_stiffness[0] *= 0.8
    model.geom_friction[model.geom("tip").id] = (0.4, 0.005, 0.0001)
    model.geom_priority[model.geom("tip").id] = 1
    model.opt.gravity[:] = (0.3, 0.0, -9.8)


def _corrected(plant: Plant, change: Callable[[mujoco.MjModel], None]) -> tuple[Variant, Correction]:
    variant = Variant.nominal(plant)
    change(variant.model)
    return variant, correction(plant, variant)


def _motion(model: mujoco.MjModel) -> Array:
    """(n, nq) of a fall with both actuators at work."""
    mujoco.mj_setConst(model, mujoco.MjData(model))
    data, rows = mujoco.MjData(model), []
    data.ctrl[:] = (0.4, 0.3)
    for _ in range(400):
        mujoco.mj_step(model, data)
        rows.append(data.qpos.copy())
    return np.array(rows)


@pytest.mark.parametrize("xml", [NATIVE, DEGREES])
def test_every_change_is_written_into_the_models_own_text(xml: str, tmp_path: Path) -> None:
    model = tmp_path / "robot.xml"
    model.write_text(xml)
    variant, found = _corrected(_plant(xml), _everything)
    assert found.unnamed == () and not found.signals
    written = write_mjcf(model, found.changes, tmp_path / "new.xml")
    assert written.kept_text and written.left_out == ()
    text = (tmp_path / "new.xml").read_text()
    assert "<!-- turned from one piece -->" in text and 'class="servo"' in text
    # Lines without a change stay as they were.
    assert sum(line in text.splitlines() for line in xml.splitlines()) > 0.5 * len(xml.splitlines())
    # The map's clamp of the controls is no part of the model.
    again = mujoco.MjModel.from_xml_path(str(tmp_path / "new.xml"))
    np.testing.assert_allclose(_motion(again), _motion(variant.model), atol=1e-7)


def test_a_model_whose_text_names_nothing_is_written_by_mujoco(tmp_path: Path) -> None:
    """Unnamed joints, or a file that includes another, cannot be found in the text."""
    xml = NATIVE.replace('name="elbow" ', "").replace('joint="elbow"', 'joint="shoulder"')
    xml = xml.replace('<joint joint="shoulder" coef="1"/>', '<joint joint="shoulder" coef="2"/>')
    (tmp_path / "robot.xml").write_text(xml)
    spec = mujoco.MjSpec.from_string(xml)
    model = spec.compile()
    index = 1
    changes = [
        Change("joint", f"joint_{index}", index, "damping", (0.0,), (0.25,), "N m s/rad"),
        Change("joint", "shoulder", 0, "range", (-1.0, 2.0), (-0.5, 1.5), "rad"),
        Change("body", "upper", 1, "mass", tuple(model.body_mass[1:2]), (2.0,), "kg"),
        Change("actuator", "shoulder_servo", 0, "gainprm", (20.0, 0.0, 0.0), (12.0, 0.0, 0.0), "1"),
    ]
    written = write_mjcf(tmp_path / "robot.xml", changes, tmp_path / "new.xml")
    assert not written.kept_text and written.left_out == ()
    again = mujoco.MjModel.from_xml_path(str(tmp_path / "new.xml"))
    assert again.dof_damping[1] == pytest.approx(0.25) and again.body_mass[1] == pytest.approx(2.0)
    assert again.actuator_gainprm[0, 0] == pytest.approx(12.0)
    np.testing.assert_allclose(again.jnt_range[0], (-0.5, 1.5), atol=1e-5)


def test_another_model_than_the_diagnosed_one_is_refused(tmp_path: Path) -> None:
    _, found = _corrected(_plant(NATIVE), _everything)
    for change, message in (
        (NATIVE.replace('damping="0.1"', 'damping="0.3"'), "damping of joint 'shoulder' is 0.3.*began from 0.1"),
        (NATIVE.replace('"belt"', '"strap"'), "has no tendon 'belt'"),
    ):
        (tmp_path / "robot.xml").write_text(change)
        with pytest.raises(GapInputError, match=message):
            write_mjcf(tmp_path / "robot.xml", found.changes, tmp_path / "new.xml")
    with pytest.raises(GapInputError, match="no such model file"):
        write_mjcf(tmp_path / "none.xml", found.changes, tmp_path / "new.xml")


def test_a_correction_survives_json() -> None:
    variant = Variant.nominal(_plant(NATIVE))
    _everything(variant.model)
    variant.inputs.delay[:] = 0.02
    variant.servos.dead_band[0] = 0.01
    stronger = variant.copy()
    stronger.model.dof_frictionloss[1] += 0.02
    stronger.inputs.delay[:] = 0.03
    found = correction(variant.plant, variant, [stronger])
    assert Correction.of(json.loads(json.dumps(found.report()))) == found
    friction = next(c for c in found.changes if c.attribute == "frictionloss")
    assert (friction.low, friction.high) == (pytest.approx((0.08,)), pytest.approx((0.1,)))
    delay = next(s for s in found.signals if s.quantity == "delay")
    assert (delay.low, delay.high) == (0.02, 0.03)


def _load(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_what_mjcf_cannot_say_goes_into_a_wrapper_that_runs_alone(tmp_path: Path) -> None:
    (tmp_path / "robot.xml").write_text(NATIVE)
    plant = _plant(NATIVE)
    variant = Variant.nominal(plant)
    variant.inputs.delay[0] = 0.02
    variant.inputs.rate_limit[0] = 1.5
    variant.friction.load[1] = 0.1
    variant.outputs.bias[1] = 0.05
    variant.inputs.delay[1] = -0.01
    report = {"correction": correction(plant, variant).report()}
    applied = apply(report, tmp_path / "robot.xml", tmp_path / "new.xml", tmp_path / "new_signals.py")
    # MuJoCo delays an actuator by itself.
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "new.xml"))
    assert model.actuator_delay[0] == pytest.approx(0.02)
    assert [s.quantity for s in applied.wrapped] == ["rate_limit", "load_friction", "bias"]
    (note,) = applied.notes
    assert "-0.01 s" in note and "nothing can do that" in note
    module = _load(tmp_path / "new_signals.py")
    assert "new.xml" in str(module.__doc__) and {s["quantity"] for s in module.SIGNALS} == {
        "rate_limit", "load_friction", "bias"}  # fmt: skip
    data, signals = mujoco.MjData(model), module.Signals(model, module.SIGNALS)
    signals.step(data, [0.0, 0.0])
    for k in range(100):
        signals.step(data, [1.0, 0.2])
        assert data.ctrl[0] == pytest.approx(min(1.5 * model.opt.timestep * (k + 1), 1.0))
        mujoco.mj_step(model, data)
    assert model.dof_frictionloss[1] == pytest.approx(0.1 * 0.2)
    assert signals.measure(0.0, {"q1": 0.3, "q0": 0.1}) == {"q1": pytest.approx(0.35), "q0": 0.1}


def test_a_delay_adds_to_one_that_the_model_has(tmp_path: Path) -> None:
    xml = NATIVE.replace('class="servo" force', 'class="servo" delay="0.01" nsample="6" interp="linear" force')
    (tmp_path / "robot.xml").write_text(xml)
    variant = Variant.nominal(_plant(xml))
    variant.inputs.delay[0] = 0.02
    report = {"correction": correction(variant.plant, variant).report()}
    applied = apply(report, tmp_path / "robot.xml", tmp_path / "new.xml", tmp_path / "signals.py")
    assert applied.wrapper is None and applied.notes == () and not (tmp_path / "signals.py").exists()
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "new.xml"))
    assert model.actuator_delay[0] == pytest.approx(0.03)


def _told(signals: list[dict[str, Any]], commands: Array, model: mujoco.MjModel | None = None) -> Array:
    """Controls (n,) of the first actuator of an arm that is held at rest."""
    model = model or mujoco.MjModel.from_xml_string(ARM)
    data, made, found = mujoco.MjData(model), Signals(model, signals), []
    for command in commands:
        made.step(data, np.concatenate([[command], np.zeros(model.nu - 1)]))
        found.append(data.ctrl[0])
        data.time += model.opt.timestep
    return np.array(found)


def _command(quantity: str, value: float, where: str = "command") -> dict[str, Any]:
    return {"where": where, "name": "shoulder_servo", "quantity": quantity, "value": value}


def test_signals_do_what_they_say() -> None:
    ramp, step = np.linspace(0.0, 1.0, 201), 0.0025
    np.testing.assert_allclose(_told([], ramp), ramp)
    late = _told([_command("delay", 0.05)], ramp)
    np.testing.assert_allclose(late[20:], ramp[:-20], atol=1e-12)
    np.testing.assert_allclose(_told([_command("scale", 0.9), _command("offset", 0.1)], ramp), 0.9 * ramp + 0.1)
    there_and_back = np.concatenate([ramp, ramp[::-1]])
    for play in (_command("play", 0.2), _command("backlash", 0.2, "servo")):
        found = _told([play], there_and_back)
        assert found[200] == pytest.approx(0.9) and found.max() == pytest.approx(0.9)
        assert found[220] == pytest.approx(0.9), "the play is crossed first"
        assert found[-1] == pytest.approx(0.1)
    limited = _told([_command("rate_limit", 1.0)], ramp)
    assert limited[-1] == pytest.approx(200 * step)
    # At rest at 0, the servo's error is its command.
    hard = _told([_command("dead_band", 0.3, "servo")], ramp)
    assert (hard[:60] == 0).all() and hard[-1] == pytest.approx(1.0)
    soft = _told([_command("dead_band_in_part", 0.3, "servo")], ramp)
    assert soft[-1] == pytest.approx(0.7)
    # Two springs in a row: the servo's and one as soft.
    stiffness = -float(mujoco.MjModel.from_xml_string(ARM).actuator_biasprm[0, 1])
    assert _told([_command("compliance", 1.0 / stiffness, "servo")], ramp)[-1] == pytest.approx(0.5)


def test_a_filtered_reading_lags_by_its_time() -> None:
    model = mujoco.MjModel.from_xml_string(ARM)
    signals = Signals(model, [{"where": "sensor", "name": "q1", "quantity": "lag", "value": 0.05}])
    read = [signals.measure(k * 0.001, {"q1": k * 0.001, "q2": k * 0.001}) for k in range(1001)]
    assert read[0]["q1"] == 0.0
    assert read[-1]["q1"] == pytest.approx(1.0 - 0.05, abs=1e-6)
    assert read[-1]["q2"] == pytest.approx(1.0)


def test_a_dead_band_of_a_controlled_motor_is_an_angle_whatever_its_gear() -> None:
    """Held at 0.4 rad and told to be at 0.5: nothing within the band, all of it beyond."""
    model = mujoco.MjModel.from_xml_string(NATIVE.replace("<motor", '<motor gear="3"'))
    data = mujoco.MjData(model)
    data.qpos[model.jnt_qposadr[model.actuator_trnid[1, 0]]] = 0.4
    mujoco.mj_forward(model, data)
    for band, torque in ((0.15, 0.0), (0.05, 4.0 * 0.1)):
        rows = [("controller", "kp", 4.0), ("servo", "dead_band", band)]
        signals = Signals(model, [{"where": w, "name": "elbow_motor", "quantity": q, "value": v} for w, q, v in rows])
        signals.step(data, [0.0, 0.5])
        assert 3.0 * data.ctrl[1] * model.actuator_gainprm[1, 0] == pytest.approx(torque, abs=1e-9)


def test_a_lossy_link_holds_the_last_command() -> None:
    ramp = np.linspace(0.0, 1.0, 2001)
    found = _told([_command("loss", 0.5), _command("update", 0.01)], ramp)
    assert set(np.round(found, 9)) <= set(np.round(ramp, 9)), "nothing is made up"
    assert (np.diff(found) >= 0).all()
    updates = np.flatnonzero(np.diff(found))
    assert np.mean(np.diff(updates)) == pytest.approx(8.0, rel=0.15), "half of the updates, each of four steps"


def test_a_controlled_motor_holds_its_position() -> None:
    plant = _plant(NATIVE.replace("<motor", '<motor gear="3"'), inputs=[
        {"column": "u1", "unit": "rad", "actuator": "elbow_motor", "kind": "position"}],
        gains={"elbow_motor": {"kp": 4.0, "kd": 0.2}})  # fmt: skip
    variant = Variant.nominal(plant)
    variant.model.actuator_gainprm[1, 0] *= 1.5
    variant.model.actuator_biasprm[1, 1:3] *= 1.5
    found = correction(plant, variant)
    assert not found.changes, "the gains are the controller's, not the model's"
    assert {(s.where, s.quantity): s.value for s in found.signals} == {
        ("controller", "kp"): pytest.approx(6.0), ("controller", "kd"): pytest.approx(0.3)}  # fmt: skip
    motor = mujoco.MjModel.from_xml_string(NATIVE.replace("<motor", '<motor gear="3"'))
    signals = Signals(motor, [dict(vars(s)) for s in found.signals])
    ours, theirs = mujoco.MjData(motor), mujoco.MjData(variant.model)
    theirs.ctrl[1] = 0.5
    for _ in range(300):
        signals.step(ours, [0.0, 0.5])
        mujoco.mj_step(motor, ours)
        mujoco.mj_step(variant.model, theirs)
    np.testing.assert_allclose(ours.qpos, theirs.qpos, atol=2e-3)


def test_ranges_are_in_the_words_of_those_who_train(tmp_path: Path) -> None:
    """Functions and parameters as mjlab's and Isaac Lab's documentation has them."""
    mjlab = {
        "joint_damping": {"ranges", "operation", "distribution", "axes"},
        "joint_friction": {"ranges", "operation", "distribution", "axes"},
        "body_mass": {"ranges", "operation", "distribution", "axes"},
        "body_com_offset": {"ranges", "operation", "distribution", "axes"},
        "pd_gains": {"kp_range", "kd_range", "operation"},
        "effort_limits": {"effort_limit_range", "operation"},
    }
    isaaclab = {
        "randomize_joint_parameters": {"friction_distribution_params", "operation", "distribution"},
        "randomize_rigid_body_mass": {"mass_distribution_params", "operation", "distribution"},
        "randomize_rigid_body_com": {"com_range"},
        "randomize_actuator_gains": {"stiffness_distribution_params", "operation", "distribution"},
    }
    plant = _plant(NATIVE)
    variants = []
    for share in (1.0, 0.9, 1.2):
        variant = Variant.nominal(plant)
        variant.model.dof_damping[0] = 0.3 * share
        variant.model.dof_frictionloss[1] = 0.08 * share
        variant.model.body_mass[2] *= 1.0 + 0.5 * share
        variant.model.body_ipos[2, 0] += 0.01 * share
        variant.model.actuator_gainprm[0, 0] *= 0.5 * share
        variant.model.actuator_biasprm[0, 1:3] *= 0.5 * share
        variant.model.actuator_forcerange[0] = (-2.0 * share, 2.0 * share)
        variant.inputs.delay[0] = 0.02 * share
        variants.append(variant)
    found = correction(plant, variants[0], variants[1:])
    write_ranges(tmp_path / "ranges.yaml", found.changes, found.signals, "diagnosis.json")
    read = yaml.safe_load((tmp_path / "ranges.yaml").read_text())
    assert read == json.loads(json.dumps(ranges(found.changes, found.signals)))
    for events, known in ((read["mjlab"], mjlab), (read["isaaclab"], isaaclab)):
        assert {e["func"] for e in events} == set(known)
        for event in events:
            assert set(event["params"]) <= known[event["func"]]
            assert event["asset_cfg"]["name"] == "robot" and event["mode"] == "startup"
    friction = next(e for e in read["mjlab"] if e["func"] == "joint_friction")
    assert friction["asset_cfg"]["joint_names"] == ["elbow"]
    assert friction["params"]["ranges"] == pytest.approx([0.072, 0.096])
    com = next(e for e in read["mjlab"] if e["func"] == "body_com_offset")
    assert com["params"]["axes"] == [0]
    shift = next(e for e in read["isaaclab"] if e["func"] == "randomize_rigid_body_com")
    assert shift["params"]["com_range"]["x"] == pytest.approx([0.009, 0.012])
    (delay,) = read["signals"]
    assert (delay["low"], delay["high"]) == (pytest.approx(0.018), pytest.approx(0.024))
    model, rng = mujoco.MjModel.from_xml_string(NATIVE), np.random.default_rng(0)
    draws = []
    for _ in range(50):
        draw(model, read["fields"], rng)
        draws.append(float(model.dof_frictionloss[1]))
    assert 0.072 <= min(draws) < 0.076 and 0.092 < max(draws) <= 0.096


@pytest.mark.long
def test_the_corrected_model_leaves_nothing_to_find(tmp_path: Path) -> None:
    """From a table over a diagnosis to a corrected model, and back: friction at the elbow, and late servos."""

    def fault(model: mujoco.MjModel) -> None:
        model.dof_frictionloss[1] = 0.3

    def late(table: dict[str, Array]) -> dict[str, Array]:
        return {k: np.concatenate([np.full(4, v[0]), v[:-4]]) for k, v in table.items()}

    np.savez(tmp_path / "log.npz", **simulate("arm", 10.0, change=fault, signal=late))  # type: ignore[arg-type]
    (tmp_path / "arm.xml").write_text(MODELS["arm"])
    (tmp_path / "map.yaml").write_text(yaml.safe_dump(MAPS["arm"]))

    def run(*words: str) -> str:
        answer = CliRunner().invoke(app, list(words))
        assert answer.exit_code == 0, answer.output
        return answer.stdout

    only = [w for n in ("coulomb_friction", "link_latency", "servo_gain") for w in ("--only", n)]
    log, table = str(tmp_path / "log.npz"), ["--map", str(tmp_path / "map.yaml"), "--no-baselines", *only]
    first, second, new = tmp_path / "first", tmp_path / "second", tmp_path / "new.xml"
    shown = run("diagnose", log, "--model", str(tmp_path / "arm.xml"), *table, "--out", str(first))
    assert shown.splitlines()[-1] == str(first / "report.html")
    before = json.loads((first / "diagnosis.json").read_text())
    assert {e["name"] for e in before["effects"]} == {"coulomb_friction", "link_latency"}
    assert before["data"]["verdict"] == "usable" and [j["name"] for j in before["data"]["joints"]] == [
        "shoulder",
        "elbow",
    ]
    shown = run("apply", str(first), "--model", str(tmp_path / "arm.xml"), "--out", str(new),
                "--randomise", str(tmp_path / "ranges.yaml"))  # fmt: skip
    assert "frictionloss" in shown and shown.splitlines()[-1] == str(new)
    run("diagnose", log, "--model", str(new), *table, "--out", str(second))
    after = json.loads((second / "diagnosis.json").read_text())
    assert after["verdict"] == "no_gap"
    assert after["gap"]["before"] < 1.05 * before["gap"]["after"] < 0.01 * before["gap"]["before"]


def test_apply_refuses_in_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "arm.xml").write_text(MODELS["arm"])
    for content, message in (
        ("no json", "is not JSON"),
        ('{"schema": "other"}', "is no diagnosis.json"),
        ('{"schema": "nermo_gap/diagnosis/1"}', "correction: is missing.*again"),
    ):
        (tmp_path / "d.json").write_text(content)
        arguments = ["apply", str(tmp_path / "d.json"), "--model", str(tmp_path / "arm.xml")]
        answer = CliRunner().invoke(app, [*arguments, "--out", str(tmp_path / "new.xml")])
        assert answer.exit_code == 2 and len(answer.stderr.strip().splitlines()) == 1
        import re

        assert re.search(message, answer.stderr)
    answer = CliRunner().invoke(app, [*arguments, "--out", str(tmp_path / "arm.xml")])
    assert answer.exit_code == 2 and "the model itself" in answer.stderr


def test_a_signal_reads_like_a_sentence() -> None:
    assert Signal("command", "hip", "rate_limit", 1.5, "rad/s").sentence == "command hip: rate limit 1.5 rad/s"
