"""The rigid tail: the same mass in the same place, and nothing that moves but its servo."""

from __future__ import annotations

import mujoco
import numpy as np

from nermo_description.model import build_model, set_posture
from nermo_description.parameters import Deviation, RobotParameters


def standing(robot: RobotParameters, model: mujoco.MjModel) -> mujoco.MjData:
    """With the tail straight."""
    data = mujoco.MjData(model)
    set_posture(model, data, robot, "stand")
    mujoco.mj_forward(model, data)
    return data


def inertia(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """Of the whole mouse as its free joint feels it, shape (6, 6)."""
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    return full[:6, :6]


def test_a_rigid_tail_weighs_what_the_straight_chain_weighs(robot, model):
    rigid = build_model(robot.with_tail("rigid"))
    chain_data, rigid_data = standing(robot, model), standing(robot, rigid)
    np.testing.assert_allclose(inertia(rigid, rigid_data), inertia(model, chain_data), rtol=1e-6, atol=1e-12)


def test_a_rigid_tail_keeps_servos_and_sensors_and_has_no_joint_but_the_pulley(robot, model):
    rigid = build_model(robot.with_tail("rigid"))
    assert rigid.nv == model.nv - 18
    assert [rigid.actuator(n).name for n in range(rigid.nu)] == [model.actuator(n).name for n in range(model.nu)]
    assert {rigid.sensor(n).name for n in range(rigid.nsensor)} == {model.sensor(n).name for n in range(model.nsensor)}
    assert not [rigid.tendon(n).name for n in range(rigid.ntendon) if rigid.tendon(n).name.startswith("tail")]


def test_a_mouse_that_deviates_in_its_tail_keeps_the_chain(robot):
    stiff = Deviation.at("joint_stiffness", "tail_3_joint", factor=2.0)
    deviating = robot.model_copy(update={"deviations": (stiff,)})
    assert deviating.with_tail("rigid").tail.model == "chain"
