"""Foot trajectories: boundary conditions against an independent solve, control points, partial phases, bad requests."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import CubicSpline

from nermo_control.gait.knowledge_base import GaitParameters
from nermo_control.gait.trajectory import TrajectoryGenerator, foot_position, horizontal_spline, vertical_spline
from nermo_control.types import FootTrajectory, LegStates, Phase

points = st.floats(-0.1, 0.1)
durations = st.floats(0.02, 5.0)


def row(t: float, derivative: int, half: int) -> list[float]:
    """One row of the linear system of (5.48) for a, b, c, d of a half."""
    powers = [
        [t**3, t**2, t, 1.0],
        [3 * t**2, 2 * t, 1.0, 0.0],
        [6 * t, 2.0, 0.0, 0.0],
    ][derivative]
    return powers + [0.0] * 4 if half == 0 else [0.0] * 4 + powers


def solve_table_5_6(start: float, middle: float, end: float, duration: float, resting: int) -> np.ndarray:
    """The eight conditions of table 5.6 as a linear system; `resting` is the derivative that vanishes at both ends."""
    h = duration / 2
    matrix = [row(0, 0, 0), row(h, 0, 0), row(0, 0, 1), row(h, 0, 1), row(0, resting, 0), row(h, resting, 1)]
    values = [start, middle, middle, end, 0.0, 0.0, 0.0, 0.0]
    for derivative in (1, 2):
        matrix.append([a - b for a, b in zip(row(h, derivative, 0), row(0, derivative, 1), strict=True)])
    return np.linalg.solve(np.array(matrix), np.array(values))


@given(points, points, points, durations)
def test_the_horizontal_spline_meets_table_5_6(start: float, middle: float, end: float, duration: float) -> None:
    first, second = horizontal_spline(start, middle, end, duration)
    scale = np.array([duration**3, duration**2, duration, 1.0] * 2)
    expected = solve_table_5_6(start, middle, end, duration, resting=1)
    np.testing.assert_allclose(np.array(first + second) * scale, expected * scale, atol=1e-9)


@given(points, points, points, durations)
def test_the_vertical_spline_meets_table_5_6(start: float, middle: float, end: float, duration: float) -> None:
    first, second = vertical_spline(start, middle, end, duration)
    scale = np.array([duration**3, duration**2, duration, 1.0] * 2)
    expected = solve_table_5_6(start, middle, end, duration, resting=2)
    np.testing.assert_allclose(np.array(first + second) * scale, expected * scale, atol=1e-9)


PARAMETERS = GaitParameters()
NEUTRAL = [(0.005, -0.045), (0.005, -0.045), (0.0, -0.05), (0.0, -0.05)]


def request(phase: Phase, velocity: float = 0.096, share: float = 1.0, **changes: object) -> LegStates:
    """A request of all four legs for a phase of an 0.8 Hz trot, each foot where the phase before ends."""
    ahead = (-0.5 if phase is Phase.SWING else 0.5) * velocity * 0.5 / 0.8
    states = LegStates(
        stamp=0,
        phases=(Phase.STANCE,) * 4,
        phase_fractions=(0.0,) * 4,
        velocities=(velocity,) * 4,
        requested=(True,) * 4,
        next_phases=(phase,) * 4,
        start_time=5_000_000,
        durations=(share * 0.5 / 0.8,) * 4,
        remaining_fractions=(share,) * 4,
        start_x=tuple(x + ahead for x, _ in NEUTRAL),  # type: ignore[arg-type]
        start_z=tuple(z for _, z in NEUTRAL),  # type: ignore[arg-type]
        gait_frequency=0.8,
        duty_factor=0.5,
    )
    return replace(states, **changes)  # type: ignore[arg-type]


def at(trajectory: FootTrajectory, share: float) -> tuple[float, float]:
    return foot_position(trajectory, trajectory.start_time + round(share * trajectory.duration * 1e9))


def test_nothing_asked_nothing_answered() -> None:
    assert TrajectoryGenerator(PARAMETERS).step(request(Phase.SWING, requested=(False,) * 4)) == ()


def test_only_the_legs_that_ask_are_answered() -> None:
    answers = TrajectoryGenerator(PARAMETERS).step(request(Phase.SWING, requested=(False, True, False, True)))
    assert [answer.leg for answer in answers] == [1, 3]


@pytest.mark.parametrize(("phase", "end", "height"), [(Phase.SWING, 0.03, 0.01), (Phase.STANCE, -0.03, -0.005)])
def test_a_full_phase_passes_the_control_points_of_figure_5_19(phase: Phase, end: float, height: float) -> None:
    for answer, (x, z) in zip(TrajectoryGenerator(PARAMETERS).step(request(phase)), NEUTRAL, strict=True):
        assert at(answer, 0.0) == pytest.approx((x - end, z))
        assert at(answer, 0.5) == pytest.approx((x, z + height))
        assert at(answer, 1.0) == pytest.approx((x + end, z))
        assert at(answer, 2.0) == at(answer, 1.0)
        assert at(answer, -1.0) == at(answer, 0.0)


def test_a_foot_path_is_the_cubic_spline_of_a_library() -> None:
    answer = TrajectoryGenerator(PARAMETERS).step(request(Phase.SWING))[0]
    knots = np.array([0.0, 0.5, 1.0]) * answer.duration
    x = CubicSpline(knots, [at(answer, s)[0] for s in (0.0, 0.5, 1.0)], bc_type="clamped")
    z = CubicSpline(knots, [at(answer, s)[1] for s in (0.0, 0.5, 1.0)], bc_type="natural")
    for share in np.linspace(0.0, 1.0, 23):
        t = share * answer.duration
        assert at(answer, share) == pytest.approx((float(x(t)), float(z(t))), abs=1e-9)


def test_a_stance_leg_in_a_part_of_its_phase_keeps_the_nominal_velocity() -> None:
    answer = TrajectoryGenerator(PARAMETERS).step(request(Phase.STANCE, share=0.3))[0]
    assert (at(answer, 0.0)[0] - at(answer, 1.0)[0]) / answer.duration == pytest.approx(0.096)


def test_a_swing_leg_in_a_part_of_its_phase_comes_down_where_it_should() -> None:
    answer = TrajectoryGenerator(PARAMETERS).step(request(Phase.SWING, share=0.5, start_z=(-0.035,) * 4))[0]
    assert at(answer, 1.0) == pytest.approx((0.005 + 0.03, -0.045))


@given(st.floats(-1.0, 1.0), st.floats(0.01, 1.0), st.sampled_from(Phase), points)
def test_feet_stay_within_the_longest_stride(velocity: float, share: float, phase: Phase, start: float) -> None:
    start_x = tuple(min(max(start, x - 0.03), x + 0.03) for x, _ in NEUTRAL)
    for answer, (x, z) in zip(
        TrajectoryGenerator(PARAMETERS).step(request(phase, velocity, share, start_x=start_x)), NEUTRAL, strict=True
    ):
        path = [at(answer, s) for s in np.linspace(0.0, 1.0, 21)]
        assert max(abs(px - x) for px, _ in path) <= 0.03 + 1e-9
        assert path[-1][1] == pytest.approx(z)


def test_new_parameters_shape_the_next_trajectory() -> None:
    generator = TrajectoryGenerator(PARAMETERS)
    generator.set_parameters(
        PARAMETERS.model_copy(update={"front": PARAMETERS.front.model_copy(update={"swing_amplitude": 0.02})})
    )
    assert at(generator.step(request(Phase.SWING))[0], 0.5)[1] == pytest.approx(-0.025)


@pytest.mark.parametrize(
    "change",
    [
        {"start_x": (float("nan"),) * 4},
        {"velocities": (float("inf"),) * 4},
        {"durations": (0.0,) * 4},
        {"durations": (float("nan"),) * 4},
        {"remaining_fractions": (0.0,) * 4},
        {"gait_frequency": 0.0},
        {"duty_factor": float("nan")},
    ],
)
def test_a_request_that_makes_no_sense_is_refused(change: dict[str, object]) -> None:
    with pytest.raises(ValueError, match="unusable"):
        TrajectoryGenerator(PARAMETERS).step(request(Phase.SWING, **change))
