"""The foot locus of C 3.2.1 in the trajectory generator, and the phase that runs along it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nermo_control.gait.foot_locus import Point, locus_curves
from nermo_control.gait.knowledge_base import GaitParameters, LegStride
from nermo_control.gait.trajectory import TrajectoryGenerator, foot_position
from nermo_control.oscillators.phase import TWO_PI, locus_phase, wrap
from nermo_control.types import FootTrajectory, LegStates, Phase

H, STEP, L, X0, C = 0.045, 0.01, 0.06, 0.005, 0.6
"""Of table 3.1: hip height, step height, step length, mid-stance offset [m], and compression."""
TD, TO = math.pi / 2 + 0.3, math.pi / 2 - 0.2


def parameters(**changes: float) -> GaitParameters:
    stride = LegStride(
        swing_amplitude=STEP,
        stance_amplitude=(1.0 - C) * STEP,
        max_stride_length=L,
        neutral_stance_height=-H,
        neutral_stride_position=X0,
        touch_down_angle=TD,
        take_off_angle=TO,
    )
    return GaitParameters(foot_path="locus", front=stride, rear=stride)


def request(phase: Phase, x: float, duration: float = 0.625) -> LegStates:
    frequency, duty = 0.8, 0.5
    return LegStates(
        stamp=0,
        phases=(phase,) * 4,
        phase_fractions=(0.0,) * 4,
        velocities=(L * frequency / duty,) * 4,
        requested=(True,) * 4,
        next_phases=(phase,) * 4,
        start_time=5_000_000,
        durations=(duration,) * 4,
        remaining_fractions=(1.0,) * 4,
        start_x=(x,) * 4,
        start_z=(-H,) * 4,
        gait_frequency=frequency,
        duty_factor=duty,
    )


def path(phase: Phase, x: float) -> FootTrajectory:
    return TrajectoryGenerator(parameters()).step(request(phase, x))[0]


def at(trajectory: FootTrajectory, share: float) -> tuple[float, float]:
    return foot_position(trajectory, trajectory.start_time + round(share * trajectory.duration * 1e9))


def test_swing_goes_through_the_key_points_of_table_3_2() -> None:
    swing = path(Phase.SWING, X0 - L / 2)
    assert at(swing, 0.0) == pytest.approx((X0 - L / 2, -H))
    assert at(swing, 0.5) == pytest.approx((X0, STEP - H))
    assert at(swing, 1.0) == pytest.approx((X0 + L / 2, -H))


def test_stance_goes_through_the_key_points_of_table_3_2() -> None:
    stance = path(Phase.STANCE, X0 + L / 2)
    assert at(stance, 0.0) == pytest.approx((X0 + L / 2, -H))
    assert at(stance, 0.5) == pytest.approx((X0, -H - (1.0 - C) * STEP))
    assert at(stance, 1.0) == pytest.approx((X0 - L / 2, -H))


@pytest.mark.parametrize(
    ("phase", "start_x", "controls"),
    [
        (
            Phase.SWING,
            X0 - L / 2,
            [
                (X0 - L / 2 + STEP * math.tan(TO - math.pi / 2), STEP - H),
                (X0 + L / 2 + STEP * math.tan(TD - math.pi / 2), STEP - H),
            ],
        ),
        (
            Phase.STANCE,
            X0 + L / 2,
            [
                (X0 + L / 2 - (1 - C) * STEP * math.tan(TD - math.pi / 2), -H - (1 - C) * STEP),
                (X0 - L / 2 - (1 - C) * STEP * math.tan(TO - math.pi / 2), -H - (1 - C) * STEP),
            ],
        ),
    ],
)
def test_control_points_are_those_of_table_3_2(
    phase: Phase, start_x: float, controls: list[tuple[float, float]]
) -> None:
    """A quadratic Bezier curve at its middle is (start + 2 control + end) / 4."""
    curve = path(phase, start_x)
    for number, control in enumerate(controls):
        begin, middle, end = (np.array(at(curve, 0.5 * number + share)) for share in (0.0, 0.25, 0.5))
        np.testing.assert_allclose((4.0 * middle - begin - end) / 2.0, control, atol=1e-9)


def test_angles_are_the_incidence_at_both_ends() -> None:
    swing = path(Phase.SWING, X0 - L / 2)
    for share, angle, direction in ((0.0, TO, 1.0), (1.0, TD, -1.0)):
        near = at(swing, share + direction * 1e-4)
        end = at(swing, share)
        slope = (near[0] - end[0]) / (near[1] - end[1])
        assert slope == pytest.approx(math.tan(angle - math.pi / 2), abs=2e-3)


def test_an_angle_above_the_vertical_retracts_the_leg_before_touch_down() -> None:
    swing = path(Phase.SWING, X0 - L / 2)
    before, end = at(swing, 0.98), at(swing, 1.0)
    assert before[0] > end[0]


def test_foot_never_jumps_from_phase_to_phase() -> None:
    generator = TrajectoryGenerator(parameters())
    x, z = X0, -H
    for number in range(6):
        phase = Phase.SWING if number % 2 == 0 else Phase.STANCE
        states = replace(request(phase, x), start_z=(z,) * 4)
        trajectory = generator.step(states)[0]
        assert at(trajectory, 0.0) == pytest.approx((x, z), abs=1e-12)
        x, z = at(trajectory, 1.0)
    assert (x, z) == pytest.approx((X0 - L / 2, -H))


@given(st.floats(0.1, 0.9))
def test_phase_is_continuous_at_the_switch_and_at_the_wrap(duty: float) -> None:
    switch = TWO_PI * (1.0 - duty)
    assert locus_phase(switch - 1e-9, duty) == pytest.approx(math.pi, abs=1e-7)
    assert locus_phase(switch + 1e-9, duty) == pytest.approx(math.pi, abs=1e-7)
    assert abs(wrap(locus_phase(TWO_PI - 1e-9, duty) - locus_phase(0.0, duty))) < 1e-7


@given(st.floats(0.1, 0.9))
def test_stance_lasts_for_the_duty_factor(duty: float) -> None:
    thetas = np.linspace(0.0, TWO_PI, 2000, endpoint=False)
    places = np.array([locus_phase(theta, duty) for theta in thetas])
    assert np.mean(places >= math.pi) == pytest.approx(duty, abs=1e-3)
    assert np.all(np.diff(places) > 0.0)


def test_printed_phase_never_stands_for_less_than_half_a_cycle() -> None:
    """(3.1) as printed: why it cannot be meant."""
    thetas = np.linspace(0.0, TWO_PI, 4000, endpoint=False)
    for duty in (0.2, 0.35):
        printed = np.where(
            thetas < math.pi * (1.0 - duty), thetas / (1.0 - duty), (thetas + TWO_PI * duty) / (1.0 + duty)
        )
        assert np.mean(printed >= math.pi) == pytest.approx((1.0 + duty) / 2.0, abs=1e-3)


def test_curves_are_linear_in_time_along_the_curve() -> None:
    curves = locus_curves(Point(0.0, 0.0), Point(1.0, 1.0), Point(2.0, 0.0), math.pi / 2, math.pi / 2, 2.0)
    assert all(curve[0] == 0.0 for curve in curves)
