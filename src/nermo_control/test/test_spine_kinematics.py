"""Spine kinematics and tendon against the thesis's numbers, an independent chain, finite differences and root
finding.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import brentq
from scipy.spatial.transform import RigidTransform, Rotation
from thesis_robot import HIP_POSITIONS, SPINE

from nermo_control.spine.kinematics import SpineKinematics
from nermo_control.spine.tendon import SpineTendon

KINEMATICS = SpineKinematics(SPINE)
TENDON = SpineTendon(SPINE)
HIPS = [KINEMATICS.in_hip_frame(position) for position in HIP_POSITIONS[2:]]

flexions = st.floats(-0.2, 0.2)
verticals = st.floats(-0.1, 0.1)
any_float = st.floats(allow_nan=True, allow_infinity=True)


def chain_end(theta_v: float, lumbar: float) -> RigidTransform:
    """{M} to {10} in N's frame, by multiplying out the elementary motions of the modified DH convention."""
    pose = RigidTransform.identity()
    for row, (alpha, a, theta, d) in enumerate(zip(SPINE.alpha, SPINE.a, SPINE.theta, SPINE.d, strict=True)):
        angle = theta + (theta_v if row in (2, 4, 6, 8) else lumbar if row in (1, 3, 5, 7) else 0.0)
        turn_x = RigidTransform.from_components([a, 0.0, 0.0], Rotation.from_euler("x", alpha))
        turn_z = RigidTransform.from_components([0.0, 0.0, d], Rotation.from_euler("z", angle))
        pose = pose * turn_x * turn_z
    return pose


def test_the_straight_spine_ends_where_the_thesis_says() -> None:
    """(0, 0.0517, -0.0154) in N's frame; table A.5 prints (0, 0.0516, -0.0158)."""
    assert KINEMATICS.rest[:3, 3] == pytest.approx([-0.0517, 0.0, -0.0154], abs=1e-4)
    assert KINEMATICS.rest[:3, :3] == pytest.approx(np.eye(3), abs=2e-3)


@given(flexions, verticals)
def test_the_chain_is_that_of_table_5_3(flexion: float, vertical: float) -> None:
    pose = KINEMATICS.transform(flexion, vertical)
    expected = chain_end(-flexion, -vertical)
    to_ros = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    assert pose[:3, :3] == pytest.approx(to_ros @ expected.rotation.as_matrix() @ to_ros.T, abs=1e-12)
    assert pose[:3, 3] == pytest.approx(to_ros @ expected.translation, abs=1e-12)
    assert np.linalg.det(pose[:3, :3]) == pytest.approx(1.0)


def test_a_tenth_radian_a_joint_yaws_and_rolls_the_hip_as_known() -> None:
    """21.9 deg of yaw (theta_turn = 4 theta_v would be 22.9) and about 6.5 deg of roll."""
    hip_axis = KINEMATICS.transform(0.1)[:3, :3] @ KINEMATICS.rest[:3, 1]
    # The hip axis yaws to the right of the shoulder axis when the body bends to the left.
    assert math.degrees(math.atan2(-hip_axis[0], hip_axis[1])) == pytest.approx(-21.9, abs=0.05)
    assert abs(math.degrees(math.asin(hip_axis[2]))) == pytest.approx(6.5, abs=0.05)


def test_positive_flexion_bends_to_the_left_and_positive_vertical_arches_the_back() -> None:
    assert KINEMATICS.transform(0.1)[1, 3] > 0.005
    assert KINEMATICS.transform(0.0, 0.1)[2, 3] < KINEMATICS.rest[2, 3] - 0.005


@given(st.lists(flexions, min_size=1, max_size=5), verticals)
def test_many_flexions_at_once(values: list[float], vertical: float) -> None:
    together = KINEMATICS.point(HIPS[0], values, vertical)
    assert together == pytest.approx(np.array([KINEMATICS.point(HIPS[0], value, vertical) for value in values]))


@given(flexions, verticals, st.sampled_from([0, 1]))
def test_jacobian_is_the_derivative(flexion: float, vertical: float, side: int) -> None:
    step = 1e-6
    columns = [
        (
            KINEMATICS.point(HIPS[side], flexion + a, vertical + b)
            - KINEMATICS.point(HIPS[side], flexion - a, vertical - b)
        )
        / (2.0 * step)
        for a, b in ((step, 0.0), (0.0, step))
    ]
    assert KINEMATICS.jacobian(HIPS[side], flexion, vertical) == pytest.approx(np.column_stack(columns), abs=1e-8)


@given(st.floats(-0.1, 0.1))
def test_inverse_of_the_deflection_is_the_flexion(flexion: float) -> None:
    found, clamped = KINEMATICS.inverse(float(KINEMATICS.transform(flexion)[1, 3]))
    assert not clamped
    assert found == pytest.approx(flexion, abs=1e-9)


def test_inverse_agrees_with_the_velocity_integrated_one_of_the_thesis() -> None:
    goal, flexion, steps = 0.008, 0.0, 400
    for _ in range(steps):
        middle = flexion + 0.5 * goal / steps / KINEMATICS.jacobian((0.0, 0.0, 0.0), flexion)[1, 0]
        flexion += goal / steps / KINEMATICS.jacobian((0.0, 0.0, 0.0), middle)[1, 0]
    assert KINEMATICS.inverse(goal)[0] == pytest.approx(flexion, abs=1e-6)


@pytest.mark.parametrize(("deflection", "expected"), [(0.05, 0.1), (-math.inf, -0.1), (math.nan, 0.0)])
def test_a_deflection_out_of_reach_is_clamped_and_reported(deflection: float, expected: float) -> None:
    assert KINEMATICS.inverse(deflection) == (expected, True)


@given(any_float, any_float)
def test_no_input_gives_nan(first: float, second: float) -> None:
    assert np.isfinite(KINEMATICS.transform(first, second)).all()
    assert np.isfinite(KINEMATICS.jacobian(HIPS[0], first, second)).all()
    assert math.isfinite(TENDON.servo_position(first))
    assert math.isfinite(TENDON.flexion(first))


@given(st.floats(1e-4, 0.3))
def test_tendon_is_the_numeric_inverse_of_the_printed_equation(bend: float) -> None:
    """(5.26)-(5.29), whose theta_v is negative where the tendon shortens, and the corrected (5.30)."""
    length, offset, radius = SPINE.vertebra_length, SPINE.tendon_offset, SPINE.pulley_radius
    alpha_v = math.atan(offset / (0.5 * length))

    def theta_v(q_sp: float) -> float:
        tendon = length + radius * q_sp / 4.0
        cosine = 1.0 - tendon**2 / (2.0 * ((0.5 * length) ** 2 + offset**2))
        return 2.0 * alpha_v - math.pi + math.acos(cosine)

    q_sp = brentq(lambda q: theta_v(q) + bend, -4.0 * length / radius, 0.0, xtol=1e-13)
    corrected = 4.0 * (math.sqrt(length**2 + 4.0 * offset**2) * math.cos(alpha_v + 0.5 * bend) - length) / radius
    assert q_sp == pytest.approx(corrected, abs=1e-8)
    assert TENDON.servo_position(bend) == pytest.approx(-q_sp, abs=1e-8)
    assert TENDON.servo_position(-bend) == pytest.approx(q_sp, abs=1e-8)


@given(st.floats(-0.3, 0.3), st.floats(-1.0, 1.0))
def test_flexion_of_the_servo_position_is_the_flexion(flexion: float, neutral: float) -> None:
    tendon = SpineTendon(SPINE, neutral)
    assert tendon.flexion(tendon.servo_position(flexion)) == pytest.approx(flexion, abs=1e-7)
    assert tendon.servo_position(0.0) == neutral
