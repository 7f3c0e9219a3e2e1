"""Turning against the thesis's radii, and the map between turn rate and alpha_tr."""

from __future__ import annotations

import math
from typing import get_args

import pytest
from hypothesis import given
from hypothesis import strategies as st
from thesis_robot import HIP_POSITIONS, NEUTRAL_FOOT_X, SPINE, STRIDE

from nermo_control.spine.kinematics import SpineKinematics
from nermo_control.turning import TurningModel, leg_modulation, leg_radius, response, spine_radius
from nermo_control.types import TurningStrategy

MODEL = TurningModel(SpineKinematics(SPINE), SPINE.max_flexion, HIP_POSITIONS, NEUTRAL_FOOT_X)
STRATEGIES: tuple[TurningStrategy, ...] = get_args(TurningStrategy)
strategies = st.sampled_from(STRATEGIES)
alphas = st.floats(-1.0, 1.0)
exponents = st.floats(0.2, 4.0)
any_float = st.floats(allow_nan=True, allow_infinity=True)


@pytest.mark.parametrize(
    ("alpha", "exponent", "expected"),
    [
        (0.0, 1.0, (1.0, 1.0)),
        (0.4, 1.0, (0.6, 1.0)),
        (-0.4, 1.0, (1.0, 0.6)),
        (1.0, 2.0, (0.0, 1.0)),
        (-0.5, 2.0, (1.0, 0.75)),
        (-0.5, 3.0, (1.0, 0.875)),
        (0.25, 0.5, (0.5, 1.0)),
        (0.7, 0.0, (1.0, 1.0)),
        (7.0, 1.0, (0.0, 1.0)),
        (math.nan, 1.0, (1.0, 1.0)),
    ],
)
def test_leg_modulation(alpha: float, exponent: float, expected: tuple[float, float]) -> None:
    assert leg_modulation(alpha, exponent) == pytest.approx(expected)


@given(alphas, exponents)
def test_left_and_right_are_mirror_images(alpha: float, exponent: float) -> None:
    left, right = leg_modulation(alpha, exponent)
    assert leg_modulation(-alpha, exponent) == (right, left)
    assert response(-alpha, exponent) == -response(alpha, exponent)


def test_leg_radius_at_full_lock_is_that_of_the_thesis() -> None:
    assert MODEL.foot_diagonal == pytest.approx(0.1499, abs=1.5e-4)
    assert MODEL.radius(1.0, "leg", STRIDE) == pytest.approx(0.151, abs=5e-4)
    # (5.40) as printed
    rotation = STRIDE / MODEL.foot_diagonal
    printed = STRIDE * math.sin(0.5 * (math.pi - rotation)) / math.sin(rotation)
    assert leg_radius(STRIDE, 1.0, MODEL.foot_diagonal) == pytest.approx(printed)


def test_mix_radius_at_full_lock_is_near_that_of_the_thesis() -> None:
    """0.134 m would need a diagonal of 0.1329 m; d_ext(0.1 rad) = 0.1362 m gives 0.137 m."""
    assert leg_radius(STRIDE, 1.0, 0.1329) == pytest.approx(0.134, abs=5e-4)
    assert MODEL.hip_diagonal(1.0) == pytest.approx(0.1362, abs=1e-4)
    assert MODEL.hip_diagonal(0.0) == pytest.approx(0.1458, abs=1e-4)
    assert MODEL.radius(1.0, "mix", STRIDE) == pytest.approx(0.137, abs=5e-4)


def test_spine_radius_is_where_the_extended_axes_meet() -> None:
    """Two axes at an angle, joined by a rigid piece and a circular arc: derived from the arc's centre."""
    angle, rigid, bent = 0.4, 0.07, 0.05
    arc = bent / angle
    front, rear = spine_radius(-angle, rigid, bent)
    assert front == pytest.approx(arc + rigid / math.tan(angle))
    assert rear - arc == pytest.approx(math.hypot(front - arc, rigid))
    assert spine_radius(0.0, rigid, bent) == (math.inf, math.inf)


def test_spine_lengths_add_up_to_shoulder_to_hip() -> None:
    assert MODEL.rigid_length == pytest.approx(0.0615 + 0.0085, abs=1e-4)
    assert MODEL.rigid_length + MODEL.bent_length == pytest.approx(0.1219, abs=1e-6)


def test_the_order_of_the_radii_at_full_lock_is_that_of_the_thesis() -> None:
    assert MODEL.radius(1.0, "mix", STRIDE) < MODEL.radius(-1.0, "leg", STRIDE) < MODEL.radius(1.0, "spine", STRIDE)


@pytest.mark.parametrize("strategy", STRATEGIES)
def test_straight_on_is_an_infinite_radius_and_no_turn_rate(strategy: TurningStrategy) -> None:
    assert MODEL.radius(0.0, strategy, STRIDE) == math.inf
    assert MODEL.turn_rate(0.0, 0.1, strategy) == 0.0
    assert MODEL.turn_rate_to_normalized(0.0, 0.1, strategy) == (0.0, False)
    assert MODEL.turn_rate_to_normalized(0.0, 0.0, strategy) == (0.0, False)


def test_leg_turn_rate_is_the_path_speed_over_the_radius() -> None:
    """(5.40)-(5.41) for short strides; the body goes at the mean speed of its left and right legs."""
    speed, alpha, exponent = 0.096, 0.6, 2.0
    left, right = leg_modulation(alpha, exponent)
    radius = MODEL.foot_diagonal / (right - left)
    assert MODEL.turn_rate(alpha, speed, "leg", exponent) == pytest.approx(
        0.5 * (left + right) * speed / radius, rel=1e-4
    )


@given(alphas, st.floats(-0.2, 0.2).filter(lambda v: abs(v) > 1e-3), strategies, exponents)
def test_normalized_of_turn_rate_is_alpha(
    alpha: float, speed: float, strategy: TurningStrategy, exponent: float
) -> None:
    rate = MODEL.turn_rate(alpha, speed, strategy, exponent)
    found, clamped = MODEL.turn_rate_to_normalized(rate, speed, strategy, exponent)
    assert not clamped
    # With t > 1 a small alpha turns so little that only the turn rate comes back exactly.
    assert MODEL.turn_rate(found, speed, strategy, exponent) == pytest.approx(rate, abs=1e-9)
    if abs(alpha) > 0.1:
        assert found == pytest.approx(alpha, abs=1e-6)


def test_walking_backwards_swaps_the_sides() -> None:
    assert MODEL.turn_rate(0.5, -0.1) == -MODEL.turn_rate(0.5, 0.1) < 0.0
    assert MODEL.turn_rate_to_normalized(0.2, -0.1)[0] < 0.0


@pytest.mark.parametrize(
    ("rate", "speed", "expected"),
    [(5.0, 0.1, 1.0), (-5.0, 0.1, -1.0), (0.1, 0.0, 1.0), (math.nan, 0.1, 0.0), (0.1, math.inf, 0.0)],
)
@pytest.mark.parametrize("strategy", STRATEGIES)
def test_an_impossible_turn_is_clamped_and_reported(
    rate: float, speed: float, expected: float, strategy: TurningStrategy
) -> None:
    assert MODEL.turn_rate_to_normalized(rate, speed, strategy) == (expected, True)


def test_legs_switched_off_cannot_turn() -> None:
    assert MODEL.turn_rate_to_normalized(0.1, 0.1, "leg", 0.0) == (1.0, True)


@given(any_float, any_float, strategies)
def test_no_input_gives_nan(first: float, second: float, strategy: TurningStrategy) -> None:
    alpha, _ = MODEL.turn_rate_to_normalized(first, second, strategy)
    assert -1.0 <= alpha <= 1.0
    assert not math.isnan(MODEL.radius(first, strategy, STRIDE))
    assert all(0.0 <= factor <= 1.0 for factor in leg_modulation(first, 1.0))
