"""Where feet, hips and spine are, against the thesis's formulas and tables."""

from __future__ import annotations

import math

import mujoco
import numpy as np
import pytest
from mouse import leg_of, pair_of

from nermo_description.parameters import LEGS


def foot_in_leg_plane(model, data, leg: str) -> tuple[float, float]:
    hip = data.joint(f"{leg}_hip_joint").xanchor
    foot = data.site(f"{leg}_foot").xpos
    return foot[0] - hip[0], foot[2] - hip[2]


@pytest.mark.parametrize("leg", LEGS)
def test_feet_are_where_the_thesis_puts_them(robot, model, leg):
    """(5.1) and (5.20), with l3 from knee to ankle; N's y is backward."""
    p = leg_of(robot, leg)
    data = mujoco.MjData(model)
    random = np.random.default_rng(1)
    for _ in range(20):
        q1, theta1, theta3 = random.uniform((-1.0, 0.4, 0.3), (1.0, 2.5, 1.3))
        for part, angle in (("hip", q1), ("knee", theta1), ("ankle", theta3)):
            data.joint(f"{leg}_{part}_joint").qpos = angle
        mujoco.mj_kinematics(model, data)
        if pair_of(leg) == "front":
            lower, foot = -(theta1 - q1), -(theta3 + theta1 - q1)
        else:
            lower, foot = theta1 + q1, -(theta3 - theta1 - q1)
        lengths = np.array([p.upper_length, p.lower_length, p.foot_length])
        angles = np.array([q1, lower, foot])
        x, z = foot_in_leg_plane(model, data, leg)
        assert x == pytest.approx(-lengths @ np.sin(angles), abs=1e-9)
        assert z == pytest.approx(-lengths @ np.cos(angles), abs=1e-9)


def test_hips_are_where_the_parameters_put_them(robot, model):
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    for leg, hip in zip(LEGS, robot.hip_positions, strict=True):
        np.testing.assert_allclose(data.joint(f"{leg}_hip_joint").xanchor, hip, atol=1e-9)
        np.testing.assert_allclose(data.joint(f"{leg}_hip_joint").xaxis, (0, 1, 0), atol=1e-9)


def dh_chain(robot, lateral: float, vertical: float) -> np.ndarray:
    """(5.23)-(5.24) with +cos(alpha) in row 3, column 3, turned into REP-103 axes."""
    spine = robot.spine
    to_rep = np.array([[0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]])
    pose = to_rep.copy()
    for row in range(11):
        theta = spine.theta[row] - lateral * (row in spine.lateral_joints) - vertical * (row in spine.vertical_joints)
        c, s, ca, sa = math.cos(theta), math.sin(theta), math.cos(spine.alpha[row]), math.sin(spine.alpha[row])
        pose = pose @ np.array(
            [
                [c, -s, 0, spine.a[row]],
                [s * ca, c * ca, -sa, -spine.d[row] * sa],
                [s * sa, c * sa, ca, spine.d[row] * ca],
                [0, 0, 0, 1],
            ]
        )
    return pose @ to_rep.T


@pytest.mark.parametrize("lateral", [0.0, 0.1, -0.07])
@pytest.mark.parametrize("vertical", [0.0, 0.1])
def test_spine_is_the_chain_of_table_5_3(robot, model, lateral, vertical):
    if vertical and robot.spine_dynamics.vertical is None:
        assert "spine_vertical_1_joint" not in {model.joint(j).name for j in range(model.njnt)}
        return
    data = mujoco.MjData(model)
    for number in range(1, 5):
        data.joint(f"spine_lateral_{number}_joint").qpos = lateral
        if vertical:
            data.joint(f"spine_vertical_{number}_joint").qpos = vertical
    mujoco.mj_kinematics(model, data)
    expected = dh_chain(robot, lateral, vertical)
    np.testing.assert_allclose(data.body("rear_torso").xpos, expected[:3, 3], atol=1e-9)
    np.testing.assert_allclose(data.body("rear_torso").xmat.reshape(3, 3), expected[:3, :3], atol=1e-9)


def test_spine_ends_where_table_a5_says(model):
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    np.testing.assert_allclose(data.body("rear_torso").xpos, (-0.0516, 0.0, -0.0158), atol=5e-4)


def test_length_of_the_mouse(model, data):
    """N table 4.1: 405 mm from nose to tail."""
    mujoco.mj_forward(model, data)
    skull = model.geom("head_skull")
    nose = data.geom("head_skull").xpos[0] + skull.size[0]
    tip = data.body("tail_18").xpos[0] + model.body_pos[model.body("tail_18").id][0]
    assert nose - tip == pytest.approx(0.405, abs=0.01)
