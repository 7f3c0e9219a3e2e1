"""Offset compensation, stride extension and balance compensation against the thesis's numbers and plain geometry."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from thesis_robot import FRONT_COM, FRONT_MASS, HIP_POSITIONS, NEUTRAL_FEET, REAR_COM, REAR_MASS, SPINE

from nermo_control.gait.gaits import GaitDefinition
from nermo_control.gait.knowledge_base import GaitParameters
from nermo_control.gait.phase import legs_at
from nermo_control.spine.balance import BalanceCompensation, CentreOfMass, stability_distance
from nermo_control.spine.kinematics import SpineKinematics
from nermo_control.spine.offset import OffsetCompensation
from nermo_control.spine.stride import StrideExtension

KINEMATICS = SpineKinematics(SPINE)
OFFSET = OffsetCompensation(KINEMATICS, HIP_POSITIONS)
STRIDE = StrideExtension(KINEMATICS, HIP_POSITIONS, SPINE.max_flexion)
COM = CentreOfMass(KINEMATICS, FRONT_MASS, FRONT_COM, REAR_MASS, REAR_COM)
BALANCE = BalanceCompensation(KINEMATICS, COM, HIP_POSITIONS, SPINE.max_flexion)
FOOT_X = tuple(NEUTRAL_FEET[pair][0] for pair in ("front", "front", "rear", "rear"))
FOOT_Z = tuple(NEUTRAL_FEET[pair][1] for pair in ("front", "front", "rear", "rear"))
GAITS = GaitParameters().gaits
PACE = GaitDefinition(duty_factor=0.5, phase_offsets=(0.5, 0.0, 0.5, 0.0))

flexions = st.floats(-0.1, 0.1)
coordinates = st.floats(-0.1, 0.1)


# Offset compensation


def test_offsets_are_those_of_the_thesis() -> None:
    """z_off -5.2 / +4.6 mm for 0.1 rad a joint; bent the other way, the sides change places."""
    assert OFFSET.offsets(0.1) == pytest.approx((-0.0052, 0.0046), abs=5e-5)
    assert OFFSET.offsets(-0.1) == pytest.approx((0.0046, -0.0052), abs=5e-5)
    assert OFFSET.offsets(0.0) == pytest.approx((0.0, 0.0), abs=1e-15)


@given(flexions, st.sampled_from([0.0, -0.05, 0.05]))
def test_offsets_are_the_fall_of_the_hip_axes(flexion: float, vertical: float) -> None:
    rest = np.array(HIP_POSITIONS[2:])
    moved = KINEMATICS.point(KINEMATICS.in_hip_frame(rest), flexion, vertical)
    assert OFFSET.offsets(flexion, vertical) == pytest.approx(rest[:, 2] - moved[:, 2], abs=1e-8)


def test_offsets_of_nan_are_those_of_a_straight_spine() -> None:
    assert OFFSET.offsets(math.nan) == OFFSET.offsets(0.0)
    assert OFFSET.offsets(math.nan, math.nan) == pytest.approx(OFFSET.offsets(0.0), abs=1e-12)


@given(st.floats(0.03, 0.1), st.sampled_from([-1.0, 1.0]))
def test_offsets_keep_the_rear_feet_on_the_ground(size: float, side: float) -> None:
    flexion = side * size
    for leg, offset in zip((2, 3), OFFSET.offsets(flexion), strict=True):
        axis = np.array(HIP_POSITIONS[leg])
        foot = np.array([FOOT_X[leg], 0.0, FOOT_Z[leg]])
        ground = (axis + foot)[2]
        plain = KINEMATICS.point(KINEMATICS.in_hip_frame(axis + foot), flexion)[2]
        compensated = KINEMATICS.point(KINEMATICS.in_hip_frame(axis + foot + (0.0, 0.0, offset)), flexion)[2]
        assert abs(compensated - ground) < 0.2 * abs(plain - ground)


# Stride extension


def test_diagonals_stretch_as_in_the_thesis() -> None:
    """0.1519 and 0.1362 m; the 0.015 m of stride extension is their difference, not extension against neutral."""
    for diagonal, side in ((0, 1.0), (1, -1.0)):
        longest, shortest = STRIDE.distance(diagonal, [side * 0.1, -side * 0.1])
        assert (longest, shortest) == pytest.approx((0.1519, 0.1362), abs=5e-5)
        assert longest - shortest == pytest.approx(0.015, abs=1e-3)
        assert longest - STRIDE.distance(diagonal, 0.0) == pytest.approx(0.006, abs=2e-4)


def test_the_optimum_is_a_maximum_at_twice_the_range_and_is_held_to_it() -> None:
    best = STRIDE.optimum(0, longest=True)
    assert best == pytest.approx(0.20, abs=0.005)
    around = STRIDE.distance(0, np.linspace(-0.3, 0.3, 601))
    assert STRIDE.distance(0, best) >= around.max()
    assert STRIDE.extension == (0.1, -0.1)
    assert STRIDE.compression == (-0.1, 0.1)
    wide = StrideExtension(KINEMATICS, HIP_POSITIONS, 0.5)
    assert wide.extension == pytest.approx((best, -best))


def test_a_standing_diagonal_goes_from_compressed_to_extended() -> None:
    """Front left and rear right stand: N's theta_v from +0.1 to -0.1, which is flexion from -0.1 to +0.1."""
    trot = GAITS["trot"]
    # Offset 0.5: their stance begins half a cycle on.
    values = [STRIDE.flexion(legs_at(cycle, trot, 0.8)) for cycle in (0.5, 0.625, 0.75, 0.875, 1.0 - 1e-9)]
    assert values[0] == pytest.approx(-0.1)
    assert values[2] == pytest.approx(0.0, abs=1e-12)
    assert values[-1] == pytest.approx(0.1)
    assert values == sorted(values)
    distances = STRIDE.distance(0, values)
    assert list(distances) == sorted(distances)


@pytest.mark.parametrize("gait", [*GAITS.values(), PACE])
def test_the_wave_is_smooth_and_within_the_range(gait: GaitDefinition) -> None:
    cycles = np.linspace(0.0, 2.0, 4001)
    wave = np.array([STRIDE.flexion(legs_at(cycle, gait, 0.8)) for cycle in cycles])
    assert np.abs(wave).max() <= 0.1 + 1e-12
    shortest_phase = min(gait.duty_factor, 1.0 - gait.duty_factor)
    steepest = 0.1 * math.pi / shortest_phase
    rates = np.gradient(wave, cycles)
    assert np.abs(rates).max() <= steepest
    assert np.abs(np.diff(rates)).max() < 0.01 * steepest, "the rate of flexion jumps"


@pytest.mark.parametrize(("name", "smallest", "largest"), [("trot", 0.0999, 0.1), ("walking_trot", 0.09, 0.1)])
def test_trots_use_the_range(name: str, smallest: float, largest: float) -> None:
    amplitude = max(STRIDE.flexion(legs_at(cycle, GAITS[name], 0.8)) for cycle in np.linspace(0.0, 1.0, 400))
    assert smallest <= amplitude <= largest + 1e-12


def test_a_gait_without_diagonal_pairs_does_not_bend_the_spine() -> None:
    assert all(abs(STRIDE.flexion(legs_at(cycle, PACE, 0.8))) < 1e-12 for cycle in np.linspace(0.0, 1.0, 50))


# Centre of mass and balance


def test_com_is_the_weighted_mean_and_moves_with_the_hip() -> None:
    rear_at_rest = KINEMATICS.point(REAR_COM, 0.0)
    expected = (FRONT_MASS * np.array(FRONT_COM) + REAR_MASS * rear_at_rest) / (FRONT_MASS + REAR_MASS)
    assert COM.position(0.0) == pytest.approx(expected)
    moved = KINEMATICS.point(REAR_COM, 0.1) - rear_at_rest
    shift = COM.position(0.1) - COM.position(0.0)
    assert shift == pytest.approx(REAR_MASS / (FRONT_MASS + REAR_MASS) * moved)
    assert shift[1] > 0.0, "bending to the left moves the COM to the left"


@given(coordinates, coordinates, coordinates, coordinates, coordinates, coordinates)
def test_stability_distance_is_the_printed_one_with_its_sign(
    cx: float, cy: float, fx: float, fy: float, rx: float, ry: float
) -> None:
    """(5.35) without the absolute value, in N's axes (x left, y backward)."""
    if math.hypot(fx - rx, fy - ry) < 1e-3:
        return
    com, front, rear = (cy, -cx), (fy, -fx), (ry, -rx)
    a, b = front[1] - rear[1], rear[0] - front[0]
    c = front[0] * rear[1] - front[1] * rear[0]
    printed = (a * com[0] + b * com[1] + c) / math.hypot(a, b)
    assert stability_distance((cx, cy), (fx, fy), (rx, ry)) == pytest.approx(printed, abs=1e-12)


def test_a_com_to_the_right_of_the_diagonal_is_positive() -> None:
    assert stability_distance((0.0, -0.01), (0.1, 0.0), (-0.1, 0.0)) == pytest.approx(0.01)
    assert stability_distance((0.0, 0.01), (0.1, 0.0), (-0.1, 0.0)) == pytest.approx(-0.01)


def inside(lifted: int, flexion: float) -> float:
    """How far the COM lies inside the triangle of the three other feet, from its edges: plain geometry [m]."""
    feet = []
    for leg in range(4):
        place = np.add(HIP_POSITIONS[leg], (FOOT_X[leg], 0.0, FOOT_Z[leg]))
        feet.append(place if leg < 2 else KINEMATICS.point(KINEMATICS.in_hip_frame(place), flexion))
    corners = [feet[leg][:2] for leg in (0, 1, 3, 2) if leg != lifted]
    com = COM.position(flexion)[:2]
    distances = []
    for index in range(3):
        start, end = corners[index], corners[(index + 1) % 3]
        edge, arm = end - start, com - start
        distances.append(-(edge[0] * arm[1] - edge[1] * arm[0]) / np.hypot(*edge))
    return min(distances)


@pytest.mark.parametrize("leg", range(4))
def test_balance_decides_the_lifts_of_table_6_5(leg: int) -> None:
    """Front lifts stand without the spine, rear lifts fall; with it all four stand."""
    assert (inside(leg, 0.0) > 0.0) == (leg < 2)
    flexion, met = BALANCE.static(leg, FOOT_X, FOOT_Z)
    assert met
    assert inside(leg, flexion) > 0.003
    assert inside(leg, flexion) >= max(inside(leg, other) for other in np.linspace(-0.1, 0.1, 41)) - 1e-6


@pytest.mark.parametrize("leg", range(4))
@pytest.mark.parametrize("lift_distance", [0.003, 0.004])
def test_static_balance_reaches_the_lift_distance(leg: int, lift_distance: float) -> None:
    flexion, met = BALANCE.static(leg, FOOT_X, FOOT_Z, lift_distance)
    assert met
    assert inside(leg, flexion) == pytest.approx(lift_distance, abs=1e-6)


def test_a_com_that_lies_deep_enough_needs_no_flexion() -> None:
    assert BALANCE.static(0, FOOT_X, FOOT_Z, 0.001) == (0.0, True)


def test_a_lift_distance_out_of_reach_is_approached_and_reported() -> None:
    assert BALANCE.static(2, FOOT_X, FOOT_Z, 0.05) == (BALANCE.static(2, FOOT_X, FOOT_Z)[0], False)


@pytest.mark.parametrize("diagonal", [0, 1])
def test_dynamic_balance_puts_the_com_on_the_diagonal(diagonal: int) -> None:
    flexion, met = BALANCE.dynamic(diagonal, FOOT_X, FOOT_Z)
    assert met and flexion != 0.0
    # The two feet of the other diagonal up: the COM is on the common edge of both triangles.
    assert inside(1 - diagonal, flexion) == pytest.approx(0.0, abs=1e-6)


def test_a_diagonal_out_of_reach_is_approached_and_reported() -> None:
    far = tuple(x - 0.04 for x in FOOT_X)
    flexion, met = BALANCE.dynamic(0, far, FOOT_Z)
    assert not met
    assert abs(flexion) == pytest.approx(0.1)


def test_left_and_right_balance_are_mirror_images() -> None:
    for left, right in ((0, 1), (2, 3)):
        assert BALANCE.static(left, FOOT_X, FOOT_Z)[0] == pytest.approx(-BALANCE.static(right, FOOT_X, FOOT_Z)[0])


def test_a_locked_spine_cannot_balance() -> None:
    locked = BalanceCompensation(KINEMATICS, COM, HIP_POSITIONS, 0.0)
    assert locked.static(2, FOOT_X, FOOT_Z, 0.003) == (0.0, False)
    assert locked.dynamic(0, FOOT_X, FOOT_Z) == (0.0, False)
