"""Maps guessed from names and values, and recordings looked at before they are diagnosed."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
import yaml
from numpy.typing import NDArray
from robots import MAPS, MODELS, plant_of, simulate
from typer.testing import CliRunner

import simgap
from simgap.cli import app
from simgap.data.errors import GapInputError
from simgap.data.mapping import Map, load_map, parse_map
from simgap.data.plant import build_plant
from simgap.data.recording import load_recording, recording_from_table
from simgap.examples.arm import FAULTS, make
from simgap.preparation.check import Check, check
from simgap.preparation.guess import guess_map

Array = NDArray[np.float64]
PENDULUM = Path(simgap.__file__).parent / "examples" / "double_pendulum"


def _guess(table: dict[str, Array], model: mujoco.MjModel, folder: Path, answer: str | None = None) -> tuple[Map, str]:
    np.savez(folder / "log.npz", **table)  # type: ignore[arg-type]
    guess = guess_map(folder / "log.npz", model, None if answer is None else lambda *_: answer)
    text = guess.text("log.npz")
    return parse_map(yaml.safe_load(text)), text


def test_a_real_log_gets_the_map_that_was_written_by_hand(tmp_path: Path) -> None:
    model = mujoco.MjModel.from_xml_path(str(PENDULUM / "model.xml"))
    guess = guess_map(PENDULUM / "excerpt.csv", model)
    assert guess.open == []
    (tmp_path / "map.yaml").write_text(guess.text("excerpt.csv"))
    found, wanted = load_map(tmp_path / "map.yaml"), load_map(PENDULUM / "map.yaml")
    assert found.model_dump() == wanted.model_dump()


@pytest.mark.parametrize(
    "names",
    [
        ("cmd_{}", "q_{}", "dq_{}"),
        ("goal_position_{}", "present_position_{}", "present_velocity_{}"),
        ("action[{}.pos]", "observation.state[{}.pos]", "observation.state[{}.vel]"),
        ("target/{}_joint", "measured/{}_joint/position", "measured/{}_joint/velocity"),
        ("u{n}", "q{n}", "qd{n}"),
    ],
)
def test_names_of_many_worlds(names: tuple[str, str, str], tmp_path: Path) -> None:
    """Each joint finds its command, its position and its rate, and the map fits what it was guessed from."""
    log = simulate("arm", 6.0)
    table = {"timestamp": log["t"]}
    for n, joint in enumerate(("shoulder", "elbow")):
        said = [name.format(joint, n=n) for name in names]
        table |= {said[0]: log[f"u{n}"], said[1]: log[f"q{n}"], said[2]: np.gradient(log[f"q{n}"], log["t"])}
    found, _ = _guess(table, mujoco.MjModel.from_xml_string(MODELS["arm"]), tmp_path)
    assert [(row.actuator, row.kind) for row in found.inputs] == [
        ("shoulder_servo", "position"),
        ("elbow_servo", "position"),
    ]
    assert [(row.joint, row.quantity) for row in found.outputs] == [
        (j, q) for q in ("position", "velocity") for j in ("shoulder", "elbow")
    ]
    plant = build_plant(mujoco.MjSpec.from_string(MODELS["arm"]), found)
    assert check([load_recording(tmp_path / "log.npz", plant)], plant).errors == []


def test_units_of_time_and_angle_are_seen(tmp_path: Path) -> None:
    log = simulate("arm", 6.0)
    xml = MODELS["arm"].replace('axis="0 1 0"', 'axis="0 1 0" limited="true" range="-120 120"')
    table = {"time": 1000 * log["t"], **{n: np.degrees(v) * 3 for n, v in log.items() if n != "t"}}
    found, _ = _guess(table, mujoco.MjModel.from_xml_string(xml), tmp_path)
    assert found.time.unit == "ms"
    assert {row.unit for row in (*found.inputs, *found.outputs)} == {"deg"}


def _arm_with_motors() -> str:
    xml = MODELS["arm"]
    for old in ('<position name="shoulder_servo"', '<position name="elbow_servo"'):
        xml = xml.replace(old, old.replace("position", "motor", 1))
    for gains in (' kp="30" kv="1"', ' kp="15" kv="0.5"'):
        xml = xml.replace(gains, "")
    return xml


def test_a_motor_that_is_told_positions_needs_gains(tmp_path: Path) -> None:
    log, xml = simulate("arm", 6.0), _arm_with_motors()
    model = mujoco.MjModel.from_xml_string(xml)
    left, text = _guess(log, model, tmp_path)
    assert left.gains == {} and "# gains" in text
    with pytest.raises(GapInputError, match="no position servo; add it to gains"):
        build_plant(mujoco.MjSpec.from_string(xml), left)
    (line,) = [line for line in text.splitlines() if line.startswith("# gains: ")]
    filled = text.replace(line, "gains: {all: {kp: 20, kd: 1.5}, elbow_servo: {kp: 5}}")
    by_hand = parse_map(yaml.safe_load(filled)).gains
    assert {name: (g.kp, g.kd) for name, g in by_hand.items()} == {"shoulder_servo": (20, 1.5), "elbow_servo": (5, 0)}
    told, _ = _guess(log, model, tmp_path, answer="20 1.5")
    assert {name: (g.kp, g.kd) for name, g in told.gains.items()} == {
        "shoulder_servo": (20.0, 1.5),
        "elbow_servo": (20.0, 1.5),
    }
    build_plant(mujoco.MjSpec.from_string(xml), told)


def test_numbers_of_parts_are_no_numbers_of_joints(tmp_path: Path) -> None:
    """Beside the joints' own columns, parts of a tail are counted too."""
    log = simulate("arm", 6.0)
    named = {"t": log["t"], "cmd_shoulder": log["u0"], "cmd_elbow": log["u1"], "pos_shoulder": log["q0"]}
    parts = {f"pos_{part}_{n}": log["q1"] for part in ("tail", "spine") for n in (1, 2)}
    found, text = _guess({**parts, **named}, mujoco.MjModel.from_xml_string(MODELS["arm"]), tmp_path)
    assert [(row.column, row.joint) for row in found.outputs] == [("pos_shoulder", "shoulder")]
    assert "# not used: pos_tail_2 (names no joint or actuator)" in text


def test_what_stands_beside_the_joints_is_sorted_out(tmp_path: Path) -> None:
    log = simulate("arm", 6.0)
    n = len(log["t"])
    beside = {
        "run": np.repeat([0.0, 1.0], n // 2),
        "torque_enable": (np.arange(n) > 20).astype(float),
        "input_volts": 12.0 + 0.1 * np.sin(np.arange(n)),
        "load_elbow": np.abs(np.sin(np.arange(n))),
        **{name: np.linspace(20.0, 30.0, n) for name in ("elbow_temp", "temp_board")},
    }
    found, text = _guess({**log, **beside}, mujoco.MjModel.from_xml_string(MODELS["arm"]), tmp_path)
    assert found.segments is not None and found.segments.column == "run"
    assert found.enabled is not None and found.enabled.column == "torque_enable"
    # Whose motor's temperature it is, a name says or leaves open.
    assert {(a.column, a.unit, a.actuator) for a in found.auxiliary} == {
        ("input_volts", "V", None),
        ("elbow_temp", "degC", "elbow_servo"),
        ("temp_board", "degC", None),
    }
    assert "# not used: load_elbow" in text


def test_a_log_of_another_thing_gives_no_map(tmp_path: Path) -> None:
    model = mujoco.MjModel.from_xml_string(MODELS["arm"])
    with pytest.raises(GapInputError, match="nothing looks like an input"):
        _guess({"t": np.arange(100) * 0.01, "price": np.arange(100.0)}, model, tmp_path)
    with pytest.raises(GapInputError, match="no column looks like a time"):
        _guess({"q0": np.arange(100.0), "u0": np.arange(100.0)}, model, tmp_path)


def test_map_never_asks_with_yes(tmp_path: Path) -> None:
    np.savez(tmp_path / "log.npz", **simulate("arm", 6.0))  # type: ignore[arg-type]
    (tmp_path / "arm.xml").write_text(MODELS["arm"])
    words = ["map", str(tmp_path / "log.npz"), "--model", str(tmp_path / "arm.xml"), "--yes"]
    answer = CliRunner().invoke(app, [*words, "--out", str(tmp_path / "map.yaml")])
    assert answer.exit_code == 0, answer.output
    assert answer.stdout.splitlines()[-1] == str(tmp_path / "map.yaml")
    load_map(tmp_path / "map.yaml")


def test_where_nobody_can_answer_what_is_asked_stays_open(tmp_path: Path) -> None:
    np.savez(tmp_path / "log.npz", **simulate("arm", 6.0))  # type: ignore[arg-type]
    (tmp_path / "arm.xml").write_text(_arm_with_motors())
    words = ["map", str(tmp_path / "log.npz"), "--model", str(tmp_path / "arm.xml")]
    answer = CliRunner().invoke(app, [*words, "--out", str(tmp_path / "map.yaml")], input="")
    assert answer.exit_code == 0, answer.output
    assert "look at: gains of shoulder_servo, elbow_servo" in answer.stdout
    assert load_map(tmp_path / "map.yaml").gains == {}


def test_a_model_that_lacks_its_meshes_is_named(tmp_path: Path) -> None:
    mesh = '<asset><mesh name="m" file="gone.stl"/></asset><worldbody><geom type="mesh" mesh="m"/></worldbody>'
    (tmp_path / "arm.xml").write_text(f"<mujoco>{mesh}</mujoco>")
    answer = CliRunner().invoke(app, ["map", "log.npz", "--model", str(tmp_path / "arm.xml")])
    assert answer.exit_code == 2 and "arm.xml: MuJoCo cannot compile" in answer.stderr and "gone.stl" in answer.stderr


# --- check


def _check(table: dict[str, Array]) -> Check:
    plant = plant_of("arm")
    return check([recording_from_table(table, plant)], plant)


def test_a_good_recording_is_usable() -> None:
    found = _check(simulate("arm", 25.0))
    assert found.verdict == "usable" and found.errors == [] and found.advice == []
    assert [j.name for j in found.joints] == ["shoulder", "elbow"]
    for joint in found.joints:
        assert joint.reversals > 10 and joint.confounded == ()
        assert joint.noise == pytest.approx(2e-4, rel=0.4)


def test_a_log_without_noise_is_said_until_its_sensors_are() -> None:
    def resolved(data: dict[str, Any]) -> None:
        for row in data["outputs"]:
            row["resolution"] = 1e-3

    table = simulate("arm", 6.0, noise=0.0)
    for edit, said in ((None, True), (resolved, False)):
        plant = plant_of("arm", edit)
        warnings = check([recording_from_table(table, plant)], plant).warnings
        assert any("show no noise, as those of a simulation" in w and "`resolution`" in w for w in warnings) is said
    noisy = plant_of("arm")
    usual = check([recording_from_table(simulate("arm", 6.0), noisy)], noisy).warnings
    assert not any("show no noise" in w for w in usual)


def test_a_joint_that_stands_still_tells_nothing() -> None:
    table = simulate("arm", 10.0)
    rng = np.random.default_rng(0)
    still = 0.3 + 2e-4 * rng.standard_normal(len(table["t"]))
    found = _check({**table, "q1": still, "u1": np.full_like(still, 0.3)})
    assert [j.still for j in found.joints] == [False, True]
    assert any("elbow: stands still" in line for line in found.advice)
    both = _check({**table, "q0": still, "q1": still.copy(), "u0": 0 * still, "u1": 0 * still})
    assert both.verdict == "poor"


def test_one_stroke_tells_no_friction() -> None:
    table = simulate("arm", 10.0)
    slow = 0.05 * table["t"] + 2e-4 * np.random.default_rng(0).standard_normal(len(table["t"]))
    found = _check({**table, "q0": slow, "u0": slow})
    shoulder = found.joints[0]
    assert shoulder.reversals == 0 and "dry friction" in shoulder.confounded
    assert any("shoulder (0 times): turn round seldom" in line for line in found.advice)


def test_runs_that_go_one_way_each_tell_friction_as_one_that_turns_round_does() -> None:
    table = simulate("arm", 10.0)
    noise = 2e-4 * np.random.default_rng(0).standard_normal(len(table["t"]))
    plant = plant_of("arm")
    up, down = (
        recording_from_table({**table, "q0": way * 0.05 * table["t"] + noise, "u0": way * 0.05 * table["t"]}, plant)
        for way in (1.0, -1.0)
    )
    for runs, reversals in (([up], 0), ([up, up], 0), ([up, down, up], 2), ([up, down] * 4, 7)):
        found = check(runs, plant)
        assert found.joints[0].reversals == reversals
        assert any("shoulder" in line and "to and fro" in line for line in found.advice) == (reversals < 6)


def test_a_wrong_map_is_an_error_and_an_uneven_clock_a_warning() -> None:
    table = simulate("arm", 8.0)
    found = _check({**table, "q0": table["q1"], "q1": table["q0"]})
    assert found.verdict == "unusable" and "swapped" in found.errors[0]
    uneven = table["t"] + np.random.default_rng(0).uniform(0.0, 0.003, len(table["t"]))
    assert any("clock is uneven" in w for w in _check({**table, "t": uneven}).warnings)


def test_check_says_why_a_recording_is_refused(tmp_path: Path) -> None:
    (tmp_path / "arm.xml").write_text(MODELS["arm"])
    (tmp_path / "map.yaml").write_text(yaml.safe_dump(MAPS["arm"]))
    table = simulate("arm", 10.0)
    words = [
        "check",
        str(tmp_path / "log.npz"),
        "--model",
        str(tmp_path / "arm.xml"),
        "--map",
        str(tmp_path / "map.yaml"),
    ]
    np.savez(tmp_path / "log.npz", **table)  # type: ignore[arg-type]
    answer = CliRunner().invoke(app, [*words, "--json", str(tmp_path / "check.json")])
    assert answer.exit_code == 0 and answer.stdout.splitlines()[-1] == "usable"
    assert json.loads((tmp_path / "check.json").read_text())["verdict"] == "usable"
    np.savez(tmp_path / "log.npz", **{**table, "q0": -table["q0"]})  # type: ignore[arg-type]
    answer = CliRunner().invoke(app, words)
    assert answer.exit_code == 2 and "opposite sign" in answer.stderr.splitlines()[-1]


# --- example


@pytest.mark.parametrize("seed", range(len(FAULTS)))
def test_the_example_is_usable_and_its_fault_shows(seed: int, tmp_path: Path) -> None:
    make(tmp_path, seed)
    plant = build_plant(mujoco.MjSpec.from_file(str(tmp_path / "model.xml")), load_map(tmp_path / "map.yaml"))
    recording = load_recording(tmp_path / "log.csv", plant)
    found = check([recording], plant)
    assert found.verdict == "usable"
    # The healthy arm, told the same, does otherwise.
    data, apart = mujoco.MjData(plant.model), []
    for k in range(len(recording.time)):
        data.ctrl[:] = recording.inputs[k]
        mujoco.mj_forward(plant.model, data)
        apart.append(recording.outputs[k] - plant.read(data.sensordata))
        mujoco.mj_step(plant.model, data, 2)
    assert np.sqrt(np.mean(np.square(apart))) > 10 * 3e-4
