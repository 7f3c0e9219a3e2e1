"""Leg kinematics against the thesis: its numbers, independent formulas, finite differences, its integrated inverse."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import brentq
from thesis_robot import LEG_PARAMETERS, NEUTRAL_FEET

from nermo_control.legs.kinematics import LegKinematics, inverse_by_integration, leg_kinematics
from nermo_control.legs.tendon import Pair, PulleyRouting, UpperLegRouting
from nermo_description.parameters import LegParameters, TendonType

PAIRS: tuple[Pair, ...] = ("front", "rear")
TYPES: tuple[TendonType, ...] = ("type_1", "type_2", "type_3", "type_3_adjusted")


def parameters(pair: Pair, tendon_type: TendonType) -> LegParameters:
    update: dict[str, object] = {"tendon_type": tendon_type}
    if tendon_type == "type_3_adjusted":
        # Half way down the upper leg, with the tendon shortened by as much: still a valid triangle at q2 = 0.
        half = 0.5 * LEG_PARAMETERS[pair].upper_length
        update |= {"routing_distance": half, "tendon_length": LEG_PARAMETERS[pair].tendon_length - half}
    return LEG_PARAMETERS[pair].model_copy(update=update)


LEGS = {(pair, kind): leg_kinematics(parameters(pair, kind), pair) for pair in PAIRS for kind in TYPES}
every_leg = st.sampled_from(sorted(LEGS))
# Hip angles of N's experiments are within +-0.7 rad of neutral (+-0.9 rad); a good half turn more is tried here.
hip_angles = st.floats(-1.6, 1.6)
shares = st.floats(0.02, 0.98)
distances = st.floats(0.0, 0.12)
any_float = st.floats(allow_nan=True, allow_infinity=True)


def thesis_forward(leg: LegParameters, pair: Pair, q1: float, theta1: float) -> tuple[float, float]:
    """(5.1) and (5.20) as printed, with l3 the whole lower leg; (y, z) of N turned into (x, z)."""
    l1, l3, l4, t3 = leg.upper_length, leg.lower_length, leg.foot_length, leg.ankle_angle
    if pair == "front":
        y = l1 * math.sin(q1) - l3 * math.sin(theta1 - q1) - l4 * math.sin(t3 + theta1 - q1)
        z = -l1 * math.cos(q1) - l3 * math.cos(theta1 - q1) - l4 * math.cos(t3 + theta1 - q1)
    else:
        y = l1 * math.sin(q1) + l3 * math.sin(theta1 + q1) - l4 * math.sin(t3 - theta1 - q1)
        z = -l1 * math.cos(q1) - l3 * math.cos(theta1 + q1) - l4 * math.cos(t3 - theta1 - q1)
    return -y, z


def pulley_angle_at(leg: LegKinematics, q1: float, share: float) -> float:
    """q2 for a knee angle that lies at `share` of the way through the knee's range."""
    low, high = leg.knee_range(q1)
    return leg.pulley_angle(low + share * (high - low), q1)


@pytest.mark.parametrize(
    ("pair", "q1_deg", "theta1_deg", "q2", "theta1_at_zero_deg", "q2_range"),
    [("front", 46.8, 84.7, 0.13, 89.4, (-2.25, 1.37)), ("rear", -55.6, 123.1, -0.66, 107.5, (-2.53, 2.46))],
)
def test_neutral_stance_and_ranges_of_type_3_are_those_of_the_thesis(
    pair: Pair,
    q1_deg: float,
    theta1_deg: float,
    q2: float,
    theta1_at_zero_deg: float,
    q2_range: tuple[float, float],
) -> None:
    leg = LEGS[pair, "type_3"]
    hip, knee, clamped = leg.inverse(*NEUTRAL_FEET[pair])
    assert not clamped
    assert math.degrees(hip) == pytest.approx(q1_deg, abs=0.06)
    assert knee == pytest.approx(q2, abs=0.006)
    assert math.degrees(leg.knee_angle(knee)) == pytest.approx(theta1_deg, abs=0.06)
    assert math.degrees(leg.knee_angle(0.0)) == pytest.approx(theta1_at_zero_deg, abs=0.06)
    assert isinstance(leg.tendon, UpperLegRouting)
    assert leg.tendon.pulley_range == pytest.approx(q2_range, abs=0.01)


@given(every_leg, hip_angles, shares)
def test_forward_is_the_printed_open_chain(key: tuple[Pair, TendonType], q1: float, share: float) -> None:
    leg = LEGS[key]
    q2 = pulley_angle_at(leg, q1, share)
    expected = thesis_forward(parameters(*key), key[0], q1, leg.knee_angle(q2, q1))
    assert leg.forward(q1, q2) == pytest.approx(expected, abs=1e-12)


@given(every_leg, hip_angles, shares)
def test_inverse_of_forward_is_the_servo_angles(key: tuple[Pair, TendonType], q1: float, share: float) -> None:
    leg = LEGS[key]
    q2 = pulley_angle_at(leg, q1, share)
    hip, knee, clamped = leg.inverse(*leg.forward(q1, q2))
    assert not clamped
    assert (hip, knee) == pytest.approx((q1, q2), abs=1e-7)


@given(every_leg, st.floats(-math.pi, math.pi), distances)
def test_forward_of_inverse_is_the_foot_or_says_clamped(
    key: tuple[Pair, TendonType], direction: float, distance: float
) -> None:
    leg = LEGS[key]
    target = (distance * math.sin(direction), -distance * math.cos(direction))
    q1, q2, clamped = leg.inverse(*target)
    error = math.dist(leg.forward(q1, q2), target)
    assert clamped or error < 1e-7


@given(st.sampled_from(PAIRS), st.floats(-math.pi, math.pi), distances)
def test_a_clamped_foot_is_the_nearest_point_of_the_workspace(pair: Pair, direction: float, distance: float) -> None:
    leg = LEGS[pair, "type_3"]
    target = (distance * math.sin(direction), -distance * math.cos(direction))
    q1, q2, clamped = leg.inverse(*target)
    low, high = leg.knee_range()
    far, near = (math.hypot(*leg.forward(0.0, leg.pulley_angle(knee))) for knee in (low, high))
    assert clamped == (not near - 1e-9 <= distance <= far + 1e-9)
    assert math.dist(leg.forward(q1, q2), target) == pytest.approx(max(0.0, near - distance, distance - far), abs=1e-7)


@given(every_leg, any_float, any_float)
def test_no_input_gives_nan(key: tuple[Pair, TendonType], first: float, second: float) -> None:
    leg = LEGS[key]
    q1, q2, clamped = leg.inverse(first, second)
    assert math.isfinite(q1) and math.isfinite(q2)
    assert clamped or (math.isfinite(first) and math.isfinite(second))
    assert all(math.isfinite(value) for value in leg.forward(first, second))
    assert all(math.isfinite(value) for row in leg.jacobian(first, second) for value in row)
    assert math.isfinite(leg.pulley_angle(first, second))


@pytest.mark.parametrize("pair", PAIRS)
def test_the_direction_of_an_infinite_target_is_kept(pair: Pair) -> None:
    leg = LEGS[pair, "type_3"]
    q1, q2, clamped = leg.inverse(math.inf, -0.03)
    x, z = leg.forward(q1, q2)
    assert clamped and x > 0.05 and abs(z) < 1e-9


@given(every_leg, hip_angles, shares)
def test_jacobian_is_the_derivative_of_forward(key: tuple[Pair, TendonType], q1: float, share: float) -> None:
    leg = LEGS[key]
    q2 = pulley_angle_at(leg, q1, 0.1 + 0.8 * share)
    step = 1e-5
    columns = [
        (np.array(leg.forward(q1 + a, q2 + b)) - np.array(leg.forward(q1 - a, q2 - b))) / (2.0 * step)
        for a, b in ((step, 0.0), (0.0, step))
    ]
    assert np.array(leg.jacobian(q1, q2)) == pytest.approx(np.column_stack(columns), abs=1e-6)


@pytest.mark.parametrize("key", sorted(LEGS))
def test_the_integrated_inverse_of_the_thesis_agrees(key: tuple[Pair, TendonType]) -> None:
    leg = LEGS[key]
    x, z = NEUTRAL_FEET[key[0]]
    start = leg.inverse(x - 0.015, z + 0.004)
    assert not start[2]
    for target in ((x + 0.02, z + 0.008), (x - 0.02, z), (x, z + 0.012)):
        q1, q2, clamped = leg.inverse(*target)
        assert not clamped
        assert inverse_by_integration(leg, start[0], start[1], *target) == pytest.approx((q1, q2), abs=1e-7)


@pytest.mark.parametrize("key", sorted(LEGS))
def test_pulling_the_tendon_bends_the_knee(key: tuple[Pair, TendonType]) -> None:
    leg = LEGS[key]
    q1, q2, _ = leg.inverse(*NEUTRAL_FEET[key[0]])
    assert leg.knee_angle(q2 - 0.1, q1) > leg.knee_angle(q2, q1) > leg.knee_angle(q2 + 0.1, q1)


@given(st.sampled_from(PAIRS), st.floats(-1.0, 1.0), shares)
def test_type_1_solves_the_spiral_equation_with_its_larger_root(pair: Pair, forward_swing: float, share: float) -> None:
    """(5.9) and (5.11), as printed, in the angle that N's front leg calls q1."""
    leg = LEGS[pair, "type_1"]
    sweep = 0.7 + 0.6 * forward_swing
    q1 = sweep if pair == "front" else -sweep
    p = LEG_PARAMETERS[pair]
    q2 = pulley_angle_at(leg, q1, 0.1 + 0.8 * share)
    theta1 = leg.knee_angle(q2, q1)
    assert isinstance(leg.tendon, PulleyRouting)
    theta2 = leg.tendon.wrapping_angle(theta1, sweep)

    def spiral(theta: float) -> tuple[float, float]:
        length = p.tendon_length + p.pulley_radius * (q2 + theta)
        return math.hypot(length, p.pulley_radius), theta - math.atan(length / p.pulley_radius)

    def residual(theta: float) -> float:
        s1, s2 = spiral(theta)
        y = s1 * math.cos(s2) + p.upper_length * math.sin(sweep)
        z = p.pulley_distance + s1 * math.sin(s2) + p.upper_length * math.cos(sweep)
        return y * y + z * z - p.tendon_attachment**2

    assert residual(theta2) == pytest.approx(0.0, abs=1e-9)
    radius, negative_angle = spiral(theta2)
    cosine = (radius * math.sin(-negative_angle) - p.pulley_distance - p.upper_length * math.cos(sweep)) / (
        p.tendon_attachment
    )
    assert math.cos(theta1 - sweep) == pytest.approx(cosine, abs=1e-9)
    grid = np.linspace(theta2 + 1e-3, theta2 + 1.5, 300)
    assert all(residual(theta) * residual(grid[0]) > 0 for theta in grid), "a larger root exists"
    lower = np.linspace(theta2 - 1e-3, theta2 - 1.5, 300)
    assert residual(lower[0]) * residual(grid[0]) < 0
    assert any(residual(theta) * residual(grid[0]) > 0 for theta in lower), "there is no second root to choose from"


def test_the_type_3_tendon_length_does_not_fit_type_1() -> None:
    """Printed l_t0 = 33 mm leaves type 1 a knee of 130.6 deg. Type 3's 89.4 deg needs BD = 44.1 mm, which is l_t0 =
    42.9 mm, because (5.2) adds r_p theta2 and theta2 is not 0 there."""
    leg = LEGS["front", "type_1"]
    assert math.degrees(leg.knee_angle(0.0)) == pytest.approx(130.6, abs=0.05)
    p, wanted = LEG_PARAMETERS["front"], LEGS["front", "type_3"].knee_angle(0.0)
    tendon_length = p.tendon_length + p.pulley_radius * leg.pulley_angle(wanted)
    assert isinstance(leg.tendon, PulleyRouting)
    assert tendon_length == pytest.approx(0.0429, abs=1e-4)
    assert tendon_length + p.pulley_radius * leg.tendon.wrapping_angle(wanted, 0.0) == pytest.approx(0.0441, abs=1e-4)
    longer = p.model_copy(update={"tendon_type": "type_1", "tendon_length": tendon_length})
    assert leg_kinematics(longer, "front").knee_angle(0.0) == pytest.approx(wanted, abs=1e-9)


@pytest.mark.parametrize("pair", PAIRS)
def test_type_2_solves_the_triangle_at_its_routing_point(pair: Pair) -> None:
    """Independent derivation: the distance from B to C, by root finding in N's coordinates."""
    leg, p = LEGS[pair, "type_2"], LEG_PARAMETERS[pair]
    side = 1.0 if pair == "front" else -1.0
    q1, q2, _ = leg.inverse(*NEUTRAL_FEET[pair])
    sweep = side * q1

    def stretch(theta1: float) -> float:
        y = p.upper_length * math.sin(sweep) - p.tendon_attachment * math.sin(theta1 - sweep)
        z = -p.upper_length * math.cos(sweep) - p.tendon_attachment * math.cos(theta1 - sweep)
        return math.hypot(y + p.pulley_radius, z) - (p.tendon_length + p.pulley_radius * q2)

    assert leg.knee_angle(q2, q1) == pytest.approx(brentq(stretch, 0.3, 3.0), abs=1e-9)


@pytest.mark.parametrize("pair", PAIRS)
def test_adjusted_type_3_reduces_the_lever_arm(pair: Pair) -> None:
    """N 5.1.4: at the same knee angle a routing point nearer to the knee turns the knee further for each q2."""
    plain, adjusted = LEGS[pair, "type_3"], LEGS[pair, "type_3_adjusted"]
    for knee in (1.2, 1.8, 2.3):
        rates = [abs(leg.tendon.gradient(knee, 0.0)[1]) for leg in (plain, adjusted)]
        assert rates[1] > rates[0]


def test_adjusted_type_3_at_the_hip_is_type_3() -> None:
    leg = LEG_PARAMETERS["rear"].model_copy(update={"tendon_type": "type_3_adjusted", "routing_distance": 1e-12})
    assert leg_kinematics(leg, "rear").inverse(0.01, -0.045) == pytest.approx(
        LEGS["rear", "type_3"].inverse(0.01, -0.045)
    )


@pytest.mark.parametrize("distance", [None, 0.0295, 0.04])
def test_adjusted_type_3_names_a_bad_routing_distance(distance: float | None) -> None:
    leg = LEG_PARAMETERS["front"].model_copy(update={"tendon_type": "type_3_adjusted", "routing_distance": distance})
    with pytest.raises(ValueError, match=r"routing_distance is .* upper_length = 0.0295 m"):
        leg_kinematics(leg, "front")
