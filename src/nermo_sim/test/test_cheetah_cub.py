"""Cheetah-Cub on its twin: its kinematics against the model's closed loops, and its trot."""

from __future__ import annotations

import math

import mujoco
import numpy as np
import pytest

from nermo_control.legs.aslp import AslpPose, UnreachableError
from nermo_control.pantograph_controller import PantographController, PantographGait, aslp_leg
from nermo_control.types import ControlCommand, Posture
from nermo_description.model import build_robot
from nermo_description.pantograph import PantographParameters
from nermo_description.pantograph_model import set_leg
from nermo_description.robots import load_any_robot
from nermo_sim.disturbance import NO_DISTURBANCE
from nermo_sim.experiments import footstep, transition
from nermo_sim.experiments.footfalls import name_gait, touch_downs
from nermo_sim.experiments.runs import Job, Settings
from nermo_sim.loop import Loop, constant
from nermo_sim.twin import Twin

LEG = "rear_left"


@pytest.fixture(scope="module")
def robot() -> PantographParameters:
    found = load_any_robot("cheetah_cub")
    assert isinstance(found, PantographParameters)
    return found


def test_ten_thousand_feet_come_back_and_those_out_of_reach_are_named(robot):
    leg = aslp_leg(robot.leg)
    random = np.random.default_rng(0)
    worst = 0.0
    for length, angle in zip(
        random.uniform(1.001 * leg.shortest, leg.longest, 10_000), random.uniform(-1.2, 1.2, 10_000), strict=True
    ):
        x, z = length * math.sin(angle), -length * math.cos(angle)
        found = leg.forward(leg.inverse(x, z))
        worst = max(worst, math.hypot(found[0] - x, found[1] - z))
    assert worst < 1e-9
    with pytest.raises(UnreachableError, match=r"foot at \(0.0, -0.16\) m: 0.16 m away, the leg reaches 0.1454 m"):
        leg.inverse(0.0, -0.16)


def test_model_closes_its_loops_where_the_kinematics_say(robot):
    """Random configurations, open and closed: every joint of appendix A, and the loops of MuJoCo, to rounding."""
    model = build_robot(robot).compile()
    data, leg, random = mujoco.MjData(model), aslp_leg(robot.leg), np.random.default_rng(1)
    for _ in range(200):
        knee = random.uniform(leg.knee_reference, 2.4)
        pose = AslpPose(random.uniform(-1.0, 1.0), knee, random.uniform(0.0, leg.widest(knee)))
        set_leg(data, LEG, robot.leg, *pose)
        mujoco.mj_fwdPosition(model, data)
        hip, points = data.body(f"{LEG}_upper").xpos, leg.points(pose)
        for body, point in (
            ("middle", points.knee),
            ("lower", points.ankle),
            ("toe", points.foot),
            ("diagonal_tube", points.upper),
        ):
            np.testing.assert_allclose((data.body(f"{LEG}_{body}").xpos - hip)[[0, 2]], point, atol=1e-9)
        for loop in ("diagonal", "parallel"):
            apart = data.site(f"{LEG}_{loop}_tip").xpos - data.site(f"{LEG}_{loop}_end").xpos
            assert np.abs(apart).max() < 1e-9
        assert data.joint(f"{LEG}_diagonal_slider").qpos[0] == pytest.approx(leg.diagonal(knee))
        assert data.joint(f"{LEG}_parallel_slider").qpos[0] == pytest.approx(leg.parallel(pose))


def test_trots_straight_ahead_and_its_loops_hold(robot):
    twin = Twin(robot)
    gait = PantographGait()
    loop = Loop(twin, PantographController(robot, gait, twin.period_ns))
    loop.run(constant(ControlCommand(0, posture=Posture.STAND)), 0.3, record=False)
    trot = ControlCommand(0, forward_velocity=0.086 * 2.86 / gait.duty_factor, gait="trot", gait_frequency=2.86)
    recording = loop.run(constant(trot), 4.0)
    steady = recording.part(1.5, 4.0)
    assert twin.tilt() < 0.3
    assert steady.position[-1, 0] - steady.position[0, 0] > 0.3 * 2.5
    assert abs(steady.position[-1, 1]) < 0.2
    assert np.degrees(steady.roll_pitch_yaw[:, :2]).std(axis=0).max() < 6.0
    assert name_gait(touch_downs(steady.foot_forces, steady.time, 0.5)) == "trot"
    rows = twin.data.efc_type[: twin.data.nefc] == mujoco.mjtConstraint.mjCNSTR_EQUALITY
    assert np.abs(twin.data.efc_pos[: twin.data.nefc][rows]).max() < 1e-3


def test_stands_while_nobody_has_spoken_and_trots_from_there(robot):
    twin = Twin(robot)
    loop = Loop(twin, PantographController(robot, PantographGait(), twin.period_ns))
    loop.run(lambda stamp: None, 2.0, record=False)
    assert np.linalg.norm(twin.base_state().position[:2]) < 0.02
    trot = ControlCommand(0, forward_velocity=0.4, gait="trot", gait_frequency=2.86)
    loop.run(constant(trot), 2.0, record=False)
    assert twin.base_state().position[0] > 0.25
    assert twin.tilt() < 0.3


def test_says_what_it_cannot_do(robot):
    controller = PantographController(robot, PantographGait(), 5_000_000)
    start = list(robot.posture("stand").values())
    with pytest.raises(ValueError, match="gait 'hop' is unknown: choose one of trot, lateral_sequence"):
        controller.step(0, ControlCommand(0, forward_velocity=0.1, gait="hop", gait_frequency=1.0), None, start)
    controller = PantographController(robot, PantographGait(), 5_000_000)
    said: list[str] = []
    for tick in range(200):
        command = ControlCommand(tick * 5_000_000, forward_velocity=0.8, gait="trot", gait_frequency=1.0)
        said += controller.step(tick * 5_000_000, command, None, start).warnings
    assert any("out of reach, clamped" in warning for warning in said)


def test_footsteps_follow_a_shorter_step(monkeypatch):
    """C 3.2.5 on Cheetah-Cub: 4 cm less of 12.6 are seen from the first step on, and more with each step."""
    monkeypatch.setattr(footstep, "STEPS", 3)
    job = Job(footstep.Case("tegotae", 0), 0, Settings("cheetah_cub"))
    base, moved = (footstep.footsteps(job, 1.5, change) for change in (0.0, 0.04))
    assert base.shape == moved.shape == (4, 3)
    displacement = (moved - base).mean(axis=0)
    assert displacement[0] < -0.005
    assert displacement[2] < displacement[0]
    assert (np.diff(base, axis=1) > 0.0).all()


def test_sweep_begins_with_standing(monkeypatch):
    monkeypatch.setattr(transition, "QUICK_HOLD", 1.0)
    monkeypatch.setattr(transition, "THESIS_LEVELS", 4)
    settings = Settings("cheetah_cub", quick=True, disturbance=NO_DISTURBANCE)
    found = transition.run(Job(transition.Case(False), 0, settings))
    assert found["levels"][0]["gait"] == "standing"
    assert found["levels"][0]["speed_m_s"] < 0.02
    assert [round(level["omega_rad_s"] / np.pi) for level in found["levels"]] == [0, 2]
    phases = np.array(found["series"])
    assert phases.shape[1] == 5
    assert (np.diff(phases[:, 0]) > 0.0).all()
    resting, walking = phases[:, 0] < 0.95, phases[:, 0] > 1.1
    assert np.ptp(phases[resting, 1:], axis=0).max() < 0.1  # they rest
    assert np.abs(phases[walking, 1:] - phases[0, 1:]).max(axis=0).min() > 0.1  # they leave it


def test_sweep_with_a_running_start_runs(monkeypatch):
    monkeypatch.setattr(transition, "QUICK_HOLD", 1.5)
    monkeypatch.setattr(transition, "THESIS_LEVELS", transition.RUNNING_LEVEL)
    case = transition.Case(False, running=True)
    settings = Settings("cheetah_cub", quick=True, disturbance=NO_DISTURBANCE)
    found = transition.run(Job(case, 0, settings))
    (row,) = transition.table([case], settings, None, [[found]])
    assert not found["fell"] and row["running_start"]
    assert row["excitation_hz"] == 2.25 and row["speed_m_s"] > 0.1
