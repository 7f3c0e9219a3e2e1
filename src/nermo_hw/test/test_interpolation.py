"""C 5.3.3: what a board makes of trajectory points that come early, late, or not at all."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nermo_hw.device.interpolation import CAPACITY, GIVE_UP_AFTER, TrajectoryInterpolator


def run(interpolator: TrajectoryInterpolator, loops: int) -> list[float]:
    return [interpolator.step() for _ in range(loops)]


def streaming(period: int, heuristics: bool = True) -> TrajectoryInterpolator:
    """One that has just gone from 0 to its first point, 1."""
    interpolator = TrajectoryInterpolator(0.0, period, heuristics)
    interpolator.add(1.0)
    run(interpolator, period + heuristics)
    assert interpolator.position == 1.0
    return interpolator


@given(st.integers(2, 20), st.lists(st.floats(-3.0, 3.0), min_size=1, max_size=10), st.booleans())
def test_points_in_time_are_reached_in_time_on_straight_lines(period, points, heuristics):
    interpolator = TrajectoryInterpolator(0.0, period, heuristics)
    before = 0.0
    for point in points:
        interpolator.add(point)
        if heuristics and not interpolator.streaming:
            assert interpolator.step() == 0.0  # the first one waits for a loop
        way = run(interpolator, period)
        assert way[-1] == point
        np.testing.assert_allclose(way, np.linspace(before, point, period + 1)[1:], atol=1e-12)
        before = point
    assert (interpolator.missed_points, interpolator.filled_buffer_steps, interpolator.dropped_points) == (0, 0, 0)


def test_an_underflow_goes_on_at_half_the_speed_and_the_next_point_is_gone_to_at_once():
    interpolator = streaming(4)
    assert interpolator.step() == pytest.approx(1.0 + 0.125)
    assert interpolator.missed_points == 1
    interpolator.add(2.0)
    assert run(interpolator, 4) == pytest.approx([1.125 + 0.21875 * k for k in (1, 2, 3, 4)])
    assert interpolator.position == 2.0


def test_silence_brings_the_set_point_to_rest_and_is_then_no_longer_counted():
    interpolator = streaming(2)
    run(interpolator, 200)
    assert interpolator.position == pytest.approx(2.0, abs=1e-2)  # 1 + 1/2 + 1/4 + ...
    assert interpolator.speed == 0.0
    assert interpolator.missed_points == GIVE_UP_AFTER
    assert not interpolator.streaming


def test_an_overflow_shortens_the_period_until_the_buffer_is_empty():
    interpolator = streaming(4)
    for point in (2.0, 3.0):
        interpolator.add(point)
    assert run(interpolator, 3)[-1] == 2.0
    assert run(interpolator, 4)[-1] == 3.0
    assert interpolator.filled_buffer_steps == 1
    assert interpolator.dropped_points == 0


def test_a_full_buffer_drops_the_oldest_point():
    interpolator = streaming(4)
    for point in range(CAPACITY + 2):
        interpolator.add(float(point))
    assert interpolator.waiting == CAPACITY
    assert interpolator.dropped_points == 2


def test_without_heuristics_a_board_stands_still_and_skips():
    interpolator = streaming(4, heuristics=False)
    assert run(interpolator, 4) == [1.0] * 4
    interpolator.add(2.0)
    interpolator.add(3.0)
    assert run(interpolator, 4)[-1] == 3.0
    assert (interpolator.missed_points, interpolator.dropped_points) == (1, 1)


@given(st.floats(-2000.0, 2000.0), st.integers(2, 10), st.integers(0, 999))
def test_clocks_that_differ_are_followed_with_one_correction_a_loop_of_drift(ppm, period, phase):
    """Nothing piles up, nothing is lost, and each event makes up for one loop of drift."""
    interpolator = TrajectoryInterpolator(0.0, period)
    loops, points = 0, 4000
    for point in range(points):
        due = (phase * 1e-3 + point * period) * (1.0 + ppm * 1e-6)
        while loops + 1 <= due:
            interpolator.step()
            loops += 1
        interpolator.add(point * 1e-3)
        assert interpolator.waiting <= 2
    drift = points * period * ppm * 1e-6
    assert interpolator.dropped_points == 0
    assert interpolator.missed_points <= max(drift, 0.0)
    assert interpolator.filled_buffer_steps <= max(-drift, 0.0) + 1


def test_it_interpolates_arrays_as_well():
    interpolator = TrajectoryInterpolator(np.zeros(4), 2)
    interpolator.add(np.array([1.0, 2.0, 3.0, 4.0]))
    interpolator.step()
    np.testing.assert_allclose(interpolator.step(), [0.5, 1.0, 1.5, 2.0])
