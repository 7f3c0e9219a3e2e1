"""Smooth moves: against their own derivatives by finite differences."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nermo_description.blend import BRAKING, PEAK_VELOCITY, Approach, Blend, coast, fastest_braked

speeds = st.floats(-8.0, 8.0)
positions = st.floats(-1.5, 1.5)


def path(move: Blend, seconds: float) -> tuple[np.ndarray, np.ndarray]:
    """Times [s] and positions [rad] of one servo."""
    times = np.arange(0, round(seconds * 1e9), 50_000)
    return times * 1e-9, np.array([move.at(int(t))[0] for t in times])


@given(speed=speeds)
def test_what_coasts_leaves_at_its_speed_and_comes_back_to_rest(speed: float) -> None:
    step = 1e-6
    assert coast(speed, 0.0) == 0.0
    assert coast(speed, step) / step == pytest.approx(speed, abs=1e-6)
    assert (coast(speed, 2 * step) - 2 * coast(speed, step)) / step == pytest.approx(0.0, abs=1e-2 * abs(speed))
    assert coast(speed, BRAKING - step) == pytest.approx(0.0, abs=1e-12 + 1e-12 * abs(speed))
    assert coast(speed, BRAKING) == coast(speed, 1.0) == 0.0
    aside = np.array([coast(speed, t) for t in np.linspace(0.0, BRAKING, 500)])
    assert np.all(aside * speed >= -1e-12)


@given(room=st.floats(0.0, 1.0), delay=st.floats(0.0, 0.02))
def test_a_servo_that_is_slow_enough_brakes_within_its_room(room: float, delay: float) -> None:
    speed = fastest_braked(room, delay)
    farthest = max(speed * delay + coast(speed, t) for t in np.linspace(0.0, BRAKING, 3001))
    assert farthest == pytest.approx(room, rel=1e-4, abs=1e-9)


@given(start=positions, end=positions, speed=speeds, velocity=st.floats(0.5, 8.0))
def test_a_move_begins_as_fast_as_the_servo_is_and_ends_at_rest_where_it_should(
    start: float, end: float, speed: float, velocity: float
) -> None:
    move = Blend([start], [speed], [end], velocity, 0)
    seconds = max(PEAK_VELOCITY * abs(end - start) / velocity, BRAKING if speed else 0.0)
    times, way = path(move, seconds + 0.01)
    rate = np.diff(way) / np.diff(times)
    assert way[0] == start or seconds == 0.0
    assert way[-1] == end
    assert move.done(round((seconds + 1e-6) * 1e9))
    assert np.abs(rate).max() <= velocity + abs(speed) + 1e-6
    if seconds >= BRAKING:
        # Neither the way nor its speed jumps, at either end; quintics have bounded accelerations.
        faster = np.diff(np.concatenate([[speed], rate, [0.0]]))
        steepest = 6.0 * PEAK_VELOCITY * velocity / seconds + 6.0 * abs(speed) / BRAKING
        assert np.abs(faster).max() <= steepest * 1e-4 + 1e-6


def test_what_does_not_move_begins_at_rest() -> None:
    times, way = path(Blend([0.2], [0.0], [0.8], 3.0, 0), 0.5)
    rate = np.diff(way) / np.diff(times)
    assert rate[0] == pytest.approx(0.0, abs=1e-3)
    assert rate.max() == pytest.approx(3.0, rel=1e-3)


def test_who_follows_starts_as_fast_as_it_is_and_then_does_what_it_is_told() -> None:
    approach = Approach([0.0], [2.0], 3.0, 0)
    first, second = approach.at(0, [0.5])[0], approach.at(1_000_000, [0.5])[0]
    assert (second - first) / 1e-3 == pytest.approx(2.0, rel=0.05)
    assert approach.at(round(0.5e9), [0.7]) == [0.7]
