"""Cheetah-Cub: its file, its model, its posture."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
import yaml

from nermo_description.model import build_model
from nermo_description.pantograph import PantographParameters
from nermo_description.parameter_files import ParameterError, read_yaml
from nermo_description.parameters import LEGS
from nermo_description.robots import family_of, load_any_robot, load_robot, robot_names

FILE = Path(__file__).parents[1] / "nermo_description" / "robots" / "cheetah_cub.yaml"


@pytest.fixture(scope="module")
def cheetah() -> PantographParameters:
    robot = load_any_robot("cheetah_cub")
    assert isinstance(robot, PantographParameters)
    return robot


@pytest.fixture(scope="module")
def cheetah_model(cheetah: PantographParameters) -> mujoco.MjModel:
    return build_model(cheetah)


def standing(model: mujoco.MjModel) -> mujoco.MjData:
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("stand").id)
    mujoco.mj_forward(model, data)
    return data


def test_is_found_by_name_and_told_from_a_mouse():
    assert robot_names(("pantograph",)) == ("cheetah_cub",)
    assert (family_of("cheetah_cub"), family_of("nermo")) == ("pantograph", "mouse")
    assert load_any_robot("nermo_lite") == load_robot("nermo_lite")
    with pytest.raises(ParameterError, match="'cheetah_cub' is of the family pantograph; needed here is mouse: nermo"):
        load_robot("cheetah_cub")
    with pytest.raises(ParameterError, match="known are cheetah_cub, nermo, nermo_lite"):
        load_any_robot("cheetah")


def test_a_file_says_its_family(tmp_path: Path):
    file = tmp_path / "cub.yaml"
    file.write_text("base: cheetah_cub\nname: heavier\nmass: 1.3\n")
    assert load_any_robot(file).mass == 1.3
    with pytest.raises(ParameterError, match=r"cub.yaml' is of the family pantograph; needed here is mouse"):
        load_robot(file)
    file.write_text("family: dog\n")
    with pytest.raises(ParameterError, match="family: is 'dog'; it must be one of mouse, pantograph"):
        load_any_robot(file)


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("spacing", 0.06, "leg: spacing 0.06 must be below upper_length and lower_length"),
        ("cable_max", 0.2, "leg: cable_max 0.2 must lie between"),
        ("parallel_travel", 0.02, "leg: parallel_travel 0.02 must be below spacing"),
        ("toe_rest", 2.0, "leg: toe_rest 2.0 must lie in toe_range"),
        ("upper_mass", 0.5, "mass: the legs leave nothing of 1.1 kg for the trunk"),
        ("diagonal_stiffness", -1.0, "leg.diagonal_stiffness: is -1.0"),
    ],
)
def test_impossible_legs_are_refused_in_words(tmp_path: Path, field: str, value: Any, message: str):
    data = read_yaml(FILE)
    data["leg"][field] = value
    file = tmp_path / "cub.yaml"
    file.write_text(yaml.safe_dump(data))
    with pytest.raises(ParameterError) as error:
        load_any_robot(file)
    assert message in str(error.value)


def test_masses_and_sizes_are_those_of_the_thesis(cheetah: PantographParameters, cheetah_model: mujoco.MjModel):
    assert cheetah_model.body_mass.sum() == pytest.approx(1.1)  # C 1.1.3
    assert cheetah.leg.mass == pytest.approx(0.05)  # C 2.1.2
    assert cheetah.trunk_size[0] == 0.201
    assert cheetah_model.nu == 8
    for leg in LEGS:
        subtree = cheetah_model.body(f"{leg}_upper").id
        assert cheetah_model.body_subtreemass[subtree] == pytest.approx(0.05)


def test_stands_on_four_feet_as_tall_as_it_should(cheetah: PantographParameters, cheetah_model: mujoco.MjModel):
    data = standing(cheetah_model)
    height = float(data.site("base_link").xpos[2])
    assert height == pytest.approx(0.158, abs=0.005)  # C 1.1.3
    loads = [float(data.sensor(f"{leg}_foot_force").data[0]) for leg in LEGS]
    assert min(loads) > 1.5
    assert sum(loads) == pytest.approx(1.1 * 9.81, rel=0.01)
    for leg in LEGS:  # the springs bear it, closed and with slack cables
        assert float(data.joint(f"{leg}_knee_joint").qpos[0]) > cheetah.leg.knee_reference + 0.05
        tendon = cheetah_model.tendon(f"{leg}_knee_tendon").id
        assert data.ten_length[tendon] < cheetah_model.tendon_range[tendon, 1] - 1e-3


def test_cable_pulls_and_never_pushes(cheetah: PantographParameters, cheetah_model: mujoco.MjModel):
    """Pulled, the hanging leg takes the fold that the cable leaves it; paid out, it stays stretched."""
    data = mujoco.MjData(cheetah_model)
    for servo, fold in ((-0.8, cheetah.leg.knee_of_cable(cheetah.leg.cable_max - 0.8 * 0.03)), (0.25, None)):
        mujoco.mj_resetDataKeyframe(cheetah_model, data, cheetah_model.key("stand").id)
        data.qpos[2] = 1.0
        for leg in LEGS:
            data.actuator(f"{leg}_knee").ctrl = servo
        for _ in range(400):  # in the air, held there
            mujoco.mj_step(cheetah_model, data)
            data.qpos[2], data.qvel[:6] = 1.0, 0.0
        knee = float(data.joint("front_left_knee_joint").qpos[0])
        assert knee == pytest.approx(fold or cheetah.leg.knee_reference, abs=0.025)


def test_loops_stay_closed_under_load(cheetah_model: mujoco.MjModel):
    """Standing to a few micrometres; dropped from 5 cm, to less than a millimetre."""
    data = standing(cheetah_model)
    at_rest = data.efc_type[: data.nefc] == mujoco.mjtConstraint.mjCNSTR_EQUALITY
    assert np.abs(data.efc_pos[: data.nefc][at_rest]).max() < 2e-5
    data.qpos[2] += 0.05
    worst = 0.0
    for _ in range(400):
        mujoco.mj_step(cheetah_model, data)
        rows = data.efc_type[: data.nefc] == mujoco.mjtConstraint.mjCNSTR_EQUALITY
        worst = max(worst, float(np.abs(data.efc_pos[: data.nefc][rows]).max()))
    assert worst < 1e-3
