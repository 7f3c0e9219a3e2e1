"""Ticks come at their time, and delays are counted as they were."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nermo_sim.pacing import FIRST_RESPITE, LARGEST_DEBT, Latency, Pacer, Patience

PERIOD = 5_000_000


@pytest.mark.parametrize("factor", [0.5, 1.0, 2.0])
def test_simulated_time_keeps_the_factor(factor: float) -> None:
    pacer = Pacer(PERIOD, factor)
    pacer.restart(0)
    ticks = sum(pacer.due(wall) for wall in range(0, 1_000_000_001, 100_000))
    assert ticks * PERIOD == pytest.approx(factor * 1e9, rel=0.01)
    assert pacer.dropped == 0


def test_short_delay_is_caught_up_and_a_long_one_is_not() -> None:
    pacer = Pacer(PERIOD, 1.0)
    pacer.restart(0)
    assert [pacer.due(3 * PERIOD) for _ in range(4)] == [True, True, True, False]
    late = 1000 * PERIOD
    assert pacer.due(late)
    assert pacer.dropped > 900
    assert sum(pacer.due(late) for _ in range(100)) <= LARGEST_DEBT


def test_as_fast_as_possible_is_always_due() -> None:
    pacer = Pacer(PERIOD, 0.0)
    pacer.restart(7)
    assert all(pacer.due(7) for _ in range(100))


def test_who_answers_every_tick_is_waited_for() -> None:
    patience = Patience(0.1)
    for _ in range(1000):
        assert patience.waits(99_000_000)
        patience.tick(answered=True)


def in_vain(patience: Patience, ticks: int, answered: Callable[[int], bool]) -> int:
    """How many of the ticks waited to the end for a command that did not come."""
    waits = 0
    for tick in range(ticks):
        if not answered(tick) and patience.waits(0):
            assert not patience.waits(100_000_000)
            waits += 1
        patience.tick(answered(tick))
    return waits


def test_the_dead_and_the_slow_hold_up_next_to_nothing() -> None:
    assert in_vain(Patience(0.1), 40, lambda tick: False) == 1
    assert in_vain(Patience(0.1), 10_000, lambda tick: tick % 4 == 0) < 10
    assert in_vain(Patience(0.0), 100, lambda tick: False) == 0


def test_after_a_pause_it_waits_again() -> None:
    patience = Patience(0.1)
    assert in_vain(patience, 1000, lambda tick: False) > 1
    assert in_vain(patience, 10_000, lambda tick: True) == 0
    assert in_vain(patience, FIRST_RESPITE + 1, lambda tick: False) == 2


@given(st.lists(st.floats(min_value=0.0, max_value=500.0), min_size=1, max_size=200))
def test_percentiles_agree_with_numpy(delays_ms: list[float]) -> None:
    latency = Latency()
    for delay in delays_ms:
        latency.add(delay * 1e6)
    for percent in (50.0, 99.0, 100.0):
        exact = np.percentile(delays_ms, percent, method="inverted_cdf")
        assert latency.percentile_ms(percent) == pytest.approx(exact, abs=0.011)
    assert latency.maximum_ms == pytest.approx(max(delays_ms))


def test_no_delay_has_no_percentile() -> None:
    assert np.isnan(Latency().percentile_ms(50.0))
