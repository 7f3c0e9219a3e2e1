"""The compiled model against the robot's parameters, and what others rely on."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from mouse import compliant_joints, servo_joint, weightless

from nermo_description.model import build_model, build_spec, set_posture
from nermo_description.parameters import LEGS


def test_compliant_joints(robot, model):
    for name, expected in compliant_joints(robot).items():
        joint = model.joint(name)
        assert joint.stiffness[0] == pytest.approx(expected.stiffness * robot.stiffness_scale), name
        assert joint.damping[0] == pytest.approx(expected.damping), name
        assert joint.armature[0] == pytest.approx(expected.armature), name
        assert model.qpos_spring[joint.qposadr[0]] == pytest.approx(expected.rest), name
        np.testing.assert_allclose(joint.range, (expected.lower, expected.upper))
        assert model.jnt_solref[joint.id, 0] == robot.contact.solref_limit


def test_no_joint_is_neither_compliant_nor_driven(robot, model):
    known = {"root", *compliant_joints(robot), *(servo_joint(servo) for servo in robot.servos)}
    assert {model.joint(j).name for j in range(model.njnt)} == known


def test_servos(robot, model):
    assert {model.actuator(a).name for a in range(model.nu)} == set(robot.servos)
    for name, servo in robot.servos.items():
        actuator, joint = model.actuator(name), model.joint(servo_joint(name))
        assert actuator.trnid[0] == joint.id
        np.testing.assert_allclose(actuator.ctrlrange.ravel(), (servo.lower, servo.upper))
        np.testing.assert_allclose(actuator.forcerange, (-servo.max_torque, servo.max_torque))
        np.testing.assert_allclose(joint.range, (servo.lower, servo.upper))
        assert joint.armature[0] == pytest.approx(servo.armature)
        assert joint.damping[0] * servo.max_velocity == pytest.approx(servo.max_torque)


def test_servo_answers_an_error_with_its_gain(robot, model, data):
    servo = robot.servos["head_pan"]
    data.ctrl[model.actuator("head_pan").id] += 0.01
    mujoco.mj_forward(model, data)
    assert data.actuator("head_pan").force[0] == pytest.approx(0.01 * servo.proportional_gain, rel=1e-3)


def test_servo_reaches_its_no_load_speed_and_no_more(robot, model, data):
    servo = robot.servos["head_pan"]
    data.ctrl[model.actuator("head_pan").id] = servo.upper
    speeds = []
    for _ in range(60):
        mujoco.mj_step(model, data)
        speeds.append(data.sensor("head_pan_velocity").data[0])
    assert 0.97 * servo.max_velocity < max(speeds) < 1.01 * servo.max_velocity


def test_masses(robot, model, data):
    masses = robot.masses
    assert model.body_subtreemass[model.body("torso").id] == pytest.approx(masses.total)
    assert model.body_subtreemass[model.body("rear_torso").id] == pytest.approx(masses.rear)
    for leg, grams in zip(LEGS, (2, 2, 3, 3), strict=True):  # N 4.2
        assert model.body_subtreemass[model.body(f"{leg}_upper").id] == pytest.approx(grams * 1e-3)
    assert model.body_subtreemass[model.body("tail_1").id] == pytest.approx(0.010)  # N 4.2


def test_centre_of_mass(robot, model):
    data = mujoco.MjData(model)
    set_posture(model, data, robot, "stand")
    mujoco.mj_forward(model, data)
    rear, torso = model.body("rear_torso").id, model.body("torso").id
    hip = data.body("rear_torso")
    rear_com = hip.xmat.reshape(3, 3).T @ (data.subtree_com[rear] - hip.xpos)
    np.testing.assert_allclose(rear_com, robot.masses.rear_com, atol=1e-9)
    vertebrae = [model.body(f"spine_{n}").id for n in range(1, 9)]
    moment = robot.masses.total * data.subtree_com[torso] - robot.masses.rear * data.subtree_com[rear]
    moment -= model.body_mass[vertebrae] @ data.xipos[vertebrae]
    np.testing.assert_allclose(moment / robot.front_mass, robot.masses.front_com, atol=1e-9)
    # Ahead of base_link as the balance tests need (N table 6.5), 57 mm above the ground (N A.4.2).
    assert 0.0011 < data.subtree_com[torso][0] < 0.0046


def test_centre_of_mass_stands_57_mm_high(robot, model, data):
    mujoco.mj_forward(model, data)
    assert data.subtree_com[model.body("torso").id][2] == pytest.approx(0.057, abs=1e-3)


def test_contact(robot, model):
    assert model.opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC
    assert model.opt.integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    assert model.opt.timestep == 0.001
    for leg in LEGS:
        foot = model.geom(f"{leg}_foot")
        assert foot.solref[0] == robot.contact.solref_contact
        assert foot.friction[0] == robot.contact.friction
    np.testing.assert_array_equal(model.tendon_solref_lim[:, 0], robot.contact.solref_limit)


def test_a_standing_foot_has_the_friction_and_softness_that_are_said(robot, model, data):
    mujoco.mj_step(model, data, 10)
    assert data.ncon == 4
    for contact in data.contact:
        assert contact.friction[0] == pytest.approx(robot.contact.friction)
        assert contact.solref[0] == pytest.approx(robot.contact.solref_contact)


def test_names(robot, model):
    def names(kind: str, count: int) -> set[str]:
        return {getattr(model, kind)(index).name for index in range(count)}

    sensors = names("sensor", model.nsensor)
    assert {f"{servo}_{what}" for servo in robot.servos for what in ("position", "velocity", "torque")} <= sensors
    assert {f"{leg}_{what}" for leg in LEGS for what in ("foot_force", "knee_encoder")} <= sensors
    assert {"imu_orientation", "imu_gyro", "imu_accelerometer"} <= sensors
    assert {"head_left", "head_right", "side", "overview"} <= names("camera", model.ncam)
    assert {"base_link", "imu", *(f"{leg}_foot" for leg in LEGS)} <= names("site", model.nsite)
    assert {f"{leg}_foot" for leg in LEGS} <= names("geom", model.ngeom)
    assert names("key", model.nkey) == {"stand", "sit", "crouch"}
    assert model.body(model.joint("root").bodyid[0]).name == "torso"


def test_sensors_read_what_they_are_named_for(robot, model, data):
    mujoco.mj_step(model, data, 300)
    for servo in robot.servos:
        joint = data.joint(servo_joint(servo))
        assert data.sensor(f"{servo}_position").data[0] == pytest.approx(joint.qpos[0], abs=1e-4)
        assert data.sensor(f"{servo}_velocity").data[0] == pytest.approx(joint.qvel[0], abs=1e-3)
        assert data.sensor(f"{servo}_torque").data[0] == pytest.approx(data.actuator(servo).force[0], abs=1e-4)
    feet = sum(data.sensor(f"{leg}_foot_force").data[0] for leg in LEGS)
    assert feet == pytest.approx(robot.masses.total * 9.81, rel=0.02)
    np.testing.assert_allclose(data.sensor("imu_accelerometer").data[2], 9.81, rtol=0.02)


@pytest.mark.parametrize("posture", ["stand", "sit", "crouch"])
def test_a_keyframe_is_at_rest(model, posture):
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key(posture).id)
    start = data.qpos.copy()
    mujoco.mj_step(model, data, 2000)
    np.testing.assert_allclose(data.qpos, start, atol=1e-3)
    assert not any(warning.number for warning in data.warning)


def test_visual_meshes_neither_weigh_nor_touch(model):
    meshes = [geom for geom in range(model.ngeom) if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_MESH]
    assert len(meshes) >= 20
    for geom in meshes:
        assert model.geom_group[geom] == 2
        assert not model.geom_contype[geom]
        assert not model.geom_conaffinity[geom]


def test_every_servo_can_go_through_its_range(robot, model, data):
    free = weightless(model)
    data.joint("root").qpos[2] = 1.0
    for goal in ("upper", "lower", "neutral"):
        for name, servo in robot.servos.items():
            data.ctrl[model.actuator(name).id] = getattr(servo, goal)
        mujoco.mj_step(free, data, 500)
        assert np.isfinite(data.qpos).all()
    assert not any(warning.number for warning in data.warning)


def test_material_scales_every_compliant_joint(robot, model):
    softer = build_model(robot.model_copy(update={"stiffness_scale": 0.9}))
    np.testing.assert_allclose(softer.jnt_stiffness, 0.9 * model.jnt_stiffness)


def test_what_the_model_cannot_build_is_said(robot):
    leg = robot.front_leg.model_copy(update={"tendon_type": "type_1"})
    with pytest.raises(ValueError, match=r"front_leg.tendon_type.*type_3"):
        build_spec(robot.model_copy(update={"front_leg": leg}))
    with pytest.raises(ValueError, match="flat"):
        build_spec(robot, "swamp")


def test_a_scene_from_a_file(robot, tmp_path):
    scene = tmp_path / "step.xml"
    scene.write_text(
        '<mujoco><worldbody><geom name="ground" type="plane" size="0 0 1"/>'
        '<geom name="step" type="box" size=".1 .1 .01" pos="1 0 0"/></worldbody></mujoco>'
    )
    assert build_model(robot, scene).geom("scene_step").type[0] == mujoco.mjtGeom.mjGEOM_BOX
