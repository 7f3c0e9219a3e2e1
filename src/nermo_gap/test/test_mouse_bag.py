"""A recording of the mouse read as any robot's: by `simgap`, with the model in one file and a guessed map."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
from mouse_mcap import write_mcap
from typer.testing import CliRunner

from nermo_description.robots import load_robot
from nermo_gap.cli import gap_app
from nermo_gap.robots.channels import RESOLUTION, TRACKER, command, said, uncertainty
from nermo_gap.robots.diagnosis import options_for, robot_plant
from nermo_gap.robots.mcap_table import mcap_table
from nermo_gap.robots.simulated import simulate
from simgap.cli import app
from simgap.data.mapping import load_map
from simgap.data.plant import build_plant, load_spec
from simgap.data.recording import load_recording


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording, the model and the map that is guessed of both."""
    made = tmp_path_factory.mktemp("bag")
    lite = load_robot("nermo_lite")
    columns = simulate(lite, 6.0, seed=2)
    write_mcap(made / "walk.mcap", columns, list(lite.servos), tracker="truth/odom")
    np.savez(made / "walk.npz", **columns)  # type: ignore[arg-type]
    answer = CliRunner().invoke(gap_app, ["model", "nermo_lite", "--out", str(made / "mouse.xml")])
    assert answer.exit_code == 0, answer.output
    words = ["map", str(made / "walk.mcap"), "--model", str(made / "mouse.xml"), "--yes"]
    answer = CliRunner().invoke(app, [*words, "--out", str(made / "map.yaml")])
    assert answer.exit_code == 0, answer.output
    return made


def test_every_servo_and_the_body_find_their_channels(folder: Path) -> None:
    mapping, lite = load_map(folder / "map.yaml"), load_robot("nermo_lite")
    assert {row.actuator: row.named for row in mapping.inputs} == {servo: servo for servo in lite.servos}
    pose = [row for row in mapping.outputs if row.site == "base_link"]
    assert len(pose) == len(TRACKER) and {row.topic for row in pose} == {"/nermo/truth/odom"}
    joints = {row.joint for row in mapping.outputs if row.topic == "/nermo/joint_states"}
    assert "front_left_knee_joint" in joints
    plant = build_plant(load_spec(folder / "mouse.xml"), mapping)
    read, told = load_recording(folder / "walk.mcap", plant), np.load(folder / "walk.npz")
    names = [c.column for c in plant.outputs]
    for column in TRACKER:
        kind = "position" if column in TRACKER[:3] else "orientation"
        mine = read.outputs[:, names.index(f"/nermo/truth/odom.pose.pose.{kind}.{column[-1]}[{column[-1]}]")]
        np.testing.assert_allclose(mine[np.isfinite(mine)], told[column], atol=1e-9)
    for i, servo in enumerate(c.name for c in plant.inputs):
        mine = read.inputs[:, i]
        np.testing.assert_allclose(mine[np.isfinite(mine)], told[f"{servo}_command"], atol=1e-9)


def test_the_model_is_one_file_and_stands(folder: Path) -> None:
    text = (folder / "mouse.xml").read_text()
    assert ".stl" not in text
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    height = float(data.body("torso").xpos[2])
    for _ in range(500):
        mujoco.mj_step(model, data)
    assert data.body("torso").xpos[2] == pytest.approx(height, abs=0.003)


def test_what_a_tracker_says_of_itself_is_the_least_that_counts_as_noise() -> None:
    lite = load_robot("nermo_lite")
    columns = [*TRACKER, *(command(servo) for servo in lite.servos)]
    tables = [
        {said("base_x"): np.array([np.nan, 1e-3, 3e-3, 2e-3]), said("base_y"): np.full(4, 1e-5)},
        {said("base_x"): np.array([np.nan, 1e-3, 1e-3, 1e-3])},
    ]
    known = uncertainty(tables)
    assert known == {"base_x": 2e-3, "base_y": 1e-5}
    least = options_for(robot_plant(lite, columns, None), lite, columns, said=known).resolution
    assert least["base_x"] == 2e-3 and least["base_y"] == least["base_z"] == RESOLUTION["place"]


def test_what_a_tracker_does_not_say_is_left_open(tmp_path: Path) -> None:
    lite = load_robot("nermo_lite")
    columns = {name: values[:40] for name, values in simulate(lite, 1.0, seed=2).items()}
    spread = (4e-6, np.inf, -1.0, 9e-6, 9e-6, 9e-6)
    write_mcap(tmp_path / "a.mcap", columns, list(lite.servos), tracker="tracker/odom", variance=spread)
    known = uncertainty([mcap_table(tmp_path / "a.mcap", lite)])
    assert known == pytest.approx({"base_x": 2e-3} | dict.fromkeys(TRACKER[3:], 1.5e-3))
    write_mcap(tmp_path / "b.mcap", columns, list(lite.servos), tracker="tracker/odom")
    assert uncertainty([mcap_table(tmp_path / "b.mcap", lite)]) == {}
