"""Vertical flexion of the spine: tendon, foot offsets and the two uses."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nermo_control.gait.gaits import GaitDefinition
from nermo_control.gait.knowledge_base import GaitParameters
from nermo_control.gait.phase import legs_at
from nermo_control.spine.controller import SpineController
from nermo_control.spine.kinematics import SpineKinematics
from nermo_control.spine.offset import OffsetCompensation
from nermo_control.spine.stride import lumbar_share
from nermo_control.spine.tendon import LumbarTendon
from nermo_control.types import MotionCommand, Posture, SpineModes
from nermo_description.robots import load_robot

PERIOD_NS = 5_000_000
ROBOT = load_robot("nermo")
SPINE = SpineKinematics(ROBOT.spine)
OFFSET = 0.008
TENDON = LumbarTendon(ROBOT.spine, OFFSET)
BOUND = GaitDefinition(duty_factor=0.5, phase_offsets=(0.5, 0.5, 0.0, 0.0))
X, Z = (0.005, 0.005, 0.0, 0.0), (-0.045, -0.045, -0.05, -0.05)
WALK = MotionCommand(0, 0.09, 0.0, Posture.WALK, "trot", 0.8, spine_modes=SpineModes(offset_compensation=True))
arches = st.floats(0.0, 0.2)


@given(arches)
def test_the_servo_winds_up_what_the_tendon_shortens(vertical: float) -> None:
    """Lengths between eyelets by points in the plane, joint by joint."""

    def length(row: int, angle: float) -> float:
        half = 0.5 * ROBOT.spine.vertebra_length
        bend = angle - ROBOT.spine.theta[row]
        before, after = np.array([half, -OFFSET]), np.array([-half, -OFFSET])
        turn = np.array([[math.cos(bend), -math.sin(bend)], [math.sin(bend), math.cos(bend)]])
        return float(np.linalg.norm(before - turn @ after))

    rows = ROBOT.spine.vertical_joints
    pulled = sum(length(row, 0.0) - length(row, vertical) for row in rows)
    assert TENDON.servo_position(vertical) * ROBOT.spine.pulley_radius == pytest.approx(pulled, abs=1e-12)


@given(arches)
def test_the_tendon_has_an_inverse(vertical: float) -> None:
    assert TENDON.flexion(TENDON.servo_position(vertical)) == pytest.approx(vertical, abs=1e-9)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_bad_angles_count_as_straight(bad: float) -> None:
    assert TENDON.servo_position(bad) == pytest.approx(0.0, abs=1e-12)
    assert TENDON.flexion(bad) == pytest.approx(0.0, abs=1e-9)


@given(arches, st.floats(-0.03, 0.03), st.floats(-0.055, -0.03))
def test_an_arching_back_leaves_the_rear_feet_at_their_height(vertical: float, x: float, z: float) -> None:
    lower = OffsetCompensation(SPINE, ROBOT.hip_positions).arch_offset(vertical, x, z)
    hip = np.array(ROBOT.hip_positions[2])
    foot = SPINE.point(SPINE.in_hip_frame(hip + np.array([x, 0.0, z + lower])), 0.0, vertical)
    assert foot[2] == pytest.approx(hip[2] + z, abs=1e-9)


def test_the_back_arches_as_told_and_the_robot_without_lumbar_servo_does_not() -> None:
    controller = SpineController(ROBOT, GaitParameters(), PERIOD_NS)
    targets = [controller.step(WALK, None, X, Z, arch=0.1) for _ in range(800)]
    assert targets[-1].vertical == pytest.approx(0.1, abs=1e-6)
    assert targets[-1].vertical_servo_position == pytest.approx(TENDON.servo_position(0.1), abs=1e-5)
    assert targets[-1].foot_offsets[2] == targets[-1].foot_offsets[3] > 0.001
    lite = SpineController(load_robot("nermo_lite"), GaitParameters(), PERIOD_NS)
    target = [lite.step(WALK, None, X, Z, arch=0.1) for _ in range(800)][-1]
    assert (target.vertical, target.vertical_servo_position) == (0.0, None)
    assert target.foot_offsets == pytest.approx((0.0,) * 4, abs=1e-12)


@given(st.floats(0.0, 1.0, exclude_max=True))
def test_only_rear_legs_that_move_together_ask_for_an_arch(cycle: float) -> None:
    for gait in ("trot", "walking_trot"):
        share = lumbar_share(legs_at(cycle, GaitParameters().gaits[gait], 0.8))
        assert 0.0 <= share < (1e-9 if gait == "trot" else 0.02)
    assert 0.0 <= lumbar_share(legs_at(cycle, BOUND, 0.8)) <= 1.0


def test_in_a_bound_the_back_is_arched_at_touch_down_and_straight_at_lift_off() -> None:
    assert lumbar_share(legs_at(0.0, BOUND, 0.8)) == pytest.approx(1.0)
    assert lumbar_share(legs_at(0.4999, BOUND, 0.8)) == 0.0
    parameters = GaitParameters(gaits={**GaitParameters().gaits, "bound": BOUND})
    controller = SpineController(ROBOT, parameters, PERIOD_NS)
    command = replace(WALK, gait="bound", spine_modes=SpineModes(stride_extension=True))
    legs = [legs_at(tick * 0.8 * PERIOD_NS * 1e-9, BOUND, 0.8) for tick in range(1000)]
    arch = np.array([controller.step(command, leg, X, Z).vertical for leg in legs])
    assert arch[500:].max() == pytest.approx(0.1, abs=1e-3)
    assert arch[500:].min() == pytest.approx(0.0, abs=1e-3)
    assert np.abs(np.diff(arch)).max() < 0.005
