"""Tendons pull, never push, and move what they should as far as the thesis says."""

from __future__ import annotations

import math

import mujoco
import numpy as np
import pytest
from mouse import leg_of, pair_of, weightless

from nermo_description.parameters import LEGS
from nermo_description.robots import load_robot


def test_a_pulley_takes_up_its_radius_times_its_angle(robot, model):
    data = mujoco.MjData(model)
    for leg in LEGS:
        servo, radius = robot.servos[f"{leg}_knee"], leg_of(robot, leg).pulley_radius
        angles = np.linspace(servo.lower, servo.upper, 40)
        lengths = []
        for q2 in angles:
            data.joint(f"{leg}_knee_pulley_joint").qpos = q2
            mujoco.mj_fwdPosition(model, data)
            lengths.append(data.tendon(f"{leg}_knee_tendon").length[0])
        np.testing.assert_allclose(np.diff(lengths), -radius * np.diff(angles), rtol=1e-6)


@pytest.mark.parametrize("tendon", ["spine_left", "spine_right", "tail_left", "tail_right"])
def test_antagonists_are_taken_up_and_paid_out(robot, model, tendon):
    part, side = tendon.split("_")
    servo, radius = (
        ("spine_lateral", robot.spine.pulley_radius) if part == "spine" else ("tail", robot.tail.pulley_radius)
    )
    data = mujoco.MjData(model)
    lengths = []
    angles = np.linspace(robot.servos[servo].lower, robot.servos[servo].upper, 20)
    for angle in angles:
        data.joint(f"{servo}_pulley_joint").qpos = angle
        mujoco.mj_fwdPosition(model, data)
        lengths.append(data.tendon(tendon).length[0])
    sign = 1.0 if side == "left" else -1.0  # positive pulls on the left
    np.testing.assert_allclose(np.diff(lengths), sign * radius * np.diff(angles), rtol=1e-6)


@pytest.mark.parametrize("leg", LEGS)
def test_knee_follows_its_pulley_as_in_5_18(robot, model, data, leg):
    """Pulled slowly through the working range, hung up in the air; 1 deg is what servo and tendon yield.

    (5.18) is for a tendon under tension (N 5.1.2); it does not push, so the knee stretches no further than its spring.
    """
    p, servo = leg_of(robot, leg), f"{leg}_knee"
    rest = (robot.front_leg_dynamics if pair_of(leg) == "front" else robot.rear_leg_dynamics).knee.rest
    free = weightless(model)
    data.joint("root").qpos[2] = 1.0
    low, high = (-1.2, 0.6) if pair_of(leg) == "front" else (-2.0, 0.3)
    actuator = model.actuator(servo).id
    for target in np.linspace(robot.servos[servo].neutral, high, 200).tolist() + np.linspace(high, low, 800).tolist():
        data.ctrl[actuator] = target
        mujoco.mj_step(free, data, 2)
        q2 = data.sensor(f"{servo}_position").data[0]
        l_t = p.tendon_length + q2 * p.pulley_radius
        cosine = (p.upper_length**2 + p.tendon_attachment**2 - l_t**2) / (2 * p.upper_length * p.tendon_attachment)
        expected = max(math.pi - math.acos(cosine), rest)
        assert data.sensor(f"{leg}_knee_encoder").data[0] == pytest.approx(expected, abs=0.0175)


@pytest.mark.parametrize("leg", LEGS)
def test_a_knee_tendon_does_not_push(robot, model, data, leg):
    """Paid out further than the spring rests, the knee stays at its rest angle and the tendon hangs."""
    dynamics = robot.front_leg_dynamics if pair_of(leg) == "front" else robot.rear_leg_dynamics
    free = weightless(model)
    data.joint("root").qpos[2] = 1.0
    data.ctrl[model.actuator(f"{leg}_knee").id] = robot.servos[f"{leg}_knee"].upper
    mujoco.mj_step(free, data, 1500)
    limit = model.tendon_range[model.tendon(f"{leg}_knee_tendon").id, 1]
    slack = limit - data.tendon(f"{leg}_knee_tendon").length[0]
    knee = data.sensor(f"{leg}_knee_encoder").data[0]
    if slack > 1e-5:
        assert knee == pytest.approx(dynamics.knee.rest, abs=0.01)
    else:
        assert knee > dynamics.knee.rest


def test_neutral_stance_is_held_by_pulling(robot, model, data):
    """Every knee spring is pretensioned: in the neutral stance its tendon is taut and the servo pulls."""
    mujoco.mj_step(model, data, 200)
    for leg in LEGS:
        limit = model.tendon_range[model.tendon(f"{leg}_knee_tendon").id, 1]
        assert data.tendon(f"{leg}_knee_tendon").length[0] > limit - 1e-5
        assert data.sensor(f"{leg}_knee_torque").data[0] < -0.01


def test_tendons_have_no_stiffness_of_their_own(model):
    assert not model.tendon_stiffness.any()
    assert model.tendon_limited.all()
    assert not model.tendon_range[:, 0].any()


@pytest.mark.parametrize("servo", ["spine_lateral", "tail"])
def test_positive_bends_to_the_left(model, data, servo):
    data.ctrl[model.actuator(servo).id] = 0.6
    mujoco.mj_step(model, data, 600)
    joints = [f"spine_lateral_{n}_joint" for n in range(1, 5)] if servo == "spine_lateral" else ["tail_1_joint"]
    angles = [data.joint(name).qpos[0] for name in joints]
    assert min(angles) > 0.01
    tip = data.body("tail_18").xpos - data.site("base_link").xpos
    assert data.site("base_link").xmat.reshape(3, 3)[:, 1] @ tip > 0.01


def test_spine_servo_bends_the_joints_alike_and_as_far_as_5_26_says(robot, model, data):
    spine = robot.spine
    data.joint("root").qpos[2] = 1.0
    free = weightless(model)
    data.ctrl[model.actuator("spine_lateral").id] = 0.5
    mujoco.mj_step(free, data, 2000)
    angles = np.array([data.joint(f"spine_lateral_{n}_joint").qpos[0] for n in range(1, 5)])
    assert np.ptp(angles) < 0.02 * angles.mean()
    # (5.26)-(5.29) for the side that shortens.
    q = data.sensor("spine_lateral_position").data[0]
    chord = spine.vertebra_length - spine.pulley_radius * q / 4.0
    alpha = math.atan(spine.tendon_offset / (spine.vertebra_length / 2.0))
    square = (spine.vertebra_length / 2.0) ** 2 + spine.tendon_offset**2
    theta = 2.0 * alpha - math.pi + math.acos(1.0 - chord**2 / (2.0 * square))
    assert angles.mean() == pytest.approx(-theta, rel=0.03)


def test_lumbar_flexion_goes_one_way(models):
    robot, model = load_robot("nermo"), models["nermo"]
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("stand").id)
    data.joint("root").qpos[2] = 1.0
    free = weightless(model)

    def bend(command: float) -> float:
        data.ctrl[model.actuator("spine_vertical").id] = command
        mujoco.mj_step(free, data, 1500)
        return float(np.mean([data.joint(f"spine_vertical_{n}_joint").qpos[0] for n in range(1, 5)]))

    rest = bend(0.0)
    arched = bend(0.5)
    expected = robot.spine.pulley_radius * 0.5 / (4 * robot.spine_dynamics.lumbar_tendon_offset)
    assert arched - rest == pytest.approx(expected, rel=0.15)
    assert bend(0.0) == pytest.approx(rest, abs=2e-3)  # the joints spring back
    # The form stop: nothing but the stop holds a back that is pushed down.
    data.joint("spine_vertical_1_joint").qpos = -0.1
    mujoco.mj_step(free, data, 500)
    assert data.joint("spine_vertical_1_joint").qpos[0] > robot.spine_dynamics.vertical.lower - 0.005
