"""The robot stands where MuJoCo has it, and the way is the way that was walked."""

from __future__ import annotations

import math

import mujoco
import numpy as np
import pytest

from nermo_description.model import build_model
from nermo_description.parameters import LEGS
from nermo_description.robots import load_any_robot
from nermo_web.robot_shape import RobotShape
from nermo_web.trail import JUMP_M, MOST_POINTS, STEP_M, Speedometer, Trail

UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])


@pytest.mark.parametrize("name", ["nermo_lite", "nermo", "cheetah_cub"])
def test_bodies_are_where_mujoco_has_them(name: str) -> None:
    robot = load_any_robot(name)
    model = build_model(robot)
    data = mujoco.MjData(model)
    random = np.random.default_rng(1)
    hinges = [number for number in range(model.njnt) if model.jnt_type[number] == mujoco.mjtJoint.mjJNT_HINGE]
    mujoco.mj_resetDataKeyframe(model, data, model.key("stand").id)
    data.qpos[model.jnt_qposadr[hinges]] += random.uniform(-0.2, 0.2, len(hinges))
    data.qpos[:3] += (0.3, -0.2, 0.1)
    mujoco.mj_forward(model, data)
    base = model.site("base_link").id
    turn = np.zeros(4)
    mujoco.mju_mat2Quat(turn, data.site_xmat[base])
    angles = {model.joint(number).name: float(data.qpos[model.jnt_qposadr[number]]) for number in hinges}
    shape = RobotShape(robot)
    placed = shape.place(data.site_xpos[base], 2.0 * turn, angles)
    for body in shape.bodies:
        assert placed.position[body] == pytest.approx(data.body(body).xpos, abs=1e-6)
        assert abs(placed.turn[body] @ data.body(body).xquat) == pytest.approx(1.0, abs=1e-6)
    feet = [data.geom(f"{leg}_foot").xpos for leg in LEGS]
    assert placed.feet == pytest.approx(np.array(feet), abs=1e-6)
    lengths = np.linalg.norm(np.diff(placed.tendons, axis=1), axis=2).sum()
    assert lengths == pytest.approx(data.ten_length.sum(), rel=0.3), "arcs around pulleys are not drawn"


@pytest.mark.parametrize("name", ["nermo_lite", "nermo"])
def test_servos_lead_the_joints_as_in_the_model(name: str) -> None:
    """The model's own `stand`, `sit` and `crouch` are what servo positions say."""
    robot = load_any_robot(name)
    model = build_model(robot)
    shape = RobotShape(robot)
    for posture in ("stand", "sit", "crouch"):
        angles = shape.by_servos(robot.posture(posture))
        data = mujoco.MjData(model)
        mujoco.mj_resetDataKeyframe(model, data, model.key(posture).id)
        for leg in LEGS:
            for joint in (f"{leg}_hip_joint", f"{leg}_knee_joint"):
                # At rest under its weight, a leg gives way a little.
                assert angles[joint] == pytest.approx(float(data.joint(joint).qpos[0]), abs=0.15)
    straight = shape.by_servos(robot.posture("stand"))
    bent = shape.by_servos({"spine_lateral": robot.servos["spine_lateral"].neutral + 0.5})
    assert straight["spine_lateral_1_joint"] == pytest.approx(0.0, abs=1e-9)
    assert bent["spine_lateral_1_joint"] > 0.02
    assert shape.by_servos({"front_left_hip": math.nan}) == {}


def test_what_is_no_number_moves_nothing() -> None:
    shape = RobotShape(load_any_robot("nermo_lite"))
    before = shape.place(np.zeros(3), UPRIGHT, {})
    after = shape.place(np.zeros(3), UPRIGHT, {"front_left_hip_joint": math.nan, "no_such_joint": 1.0, "root": 3.0})
    assert all((before.position[body] == after.position[body]).all() for body in shape.bodies)


def test_parts_are_whole_meshes() -> None:
    shape = RobotShape(load_any_robot("nermo_lite"))
    assert {part.body for part in shape.parts} == set(shape.bodies)
    for part in shape.parts:
        assert part.faces.max() < len(part.vertices)
        assert np.isfinite(part.vertices).all() and np.abs(part.vertices).max() < 0.2
    with pytest.raises(ValueError, match="moon"):
        RobotShape(load_any_robot("nermo_lite"), "moon")


def test_the_way_keeps_its_ends_and_its_size() -> None:
    trail = Trail()
    assert trail.pieces(0.0).shape[1:] == (2, 3)
    for step in range(4 * MOST_POINTS):
        trail.add(1.01 * STEP_M * step, 0.0)
    pieces = trail.pieces(0.1)
    assert len(pieces) <= MOST_POINTS
    assert pieces[0, 0] == pytest.approx((0.0, 0.0, 0.1))
    assert pieces[-1, 1, 0] == pytest.approx(1.01 * STEP_M * 4 * MOST_POINTS, abs=10 * STEP_M)
    assert (pieces[1:, 0] == pieces[:-1, 1]).all()
    trail.news = False
    trail.add(pieces[-1, 1, 0] + 0.1 * STEP_M, 0.0)
    assert not trail.news
    trail.add(0.0, 2.0 * JUMP_M)
    assert trail.pieces(0.0).shape == (0, 2, 3)


def test_speed_is_along_the_heading() -> None:
    speed = Speedometer()
    for tick in range(40):
        speed.add(tick * 50_000_000, 0.0, -0.05 * 0.05 * tick, math.pi / 2.0)
    assert speed.forward == pytest.approx(-0.05)
    speed.add(0, 5.0, 5.0, 0.0)
    assert speed.forward == 0.0
