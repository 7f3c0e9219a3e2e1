"""Ticks come at their time, and delays are counted as they were."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nermo_sim.battery import Battery, BatteryModel
from nermo_sim.pacing import LARGEST_DEBT, Latency, Pacer

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


def test_battery_runs_down_by_what_is_drawn() -> None:
    battery = Battery(BatteryModel(idle_power=0.0, efficiency=1.0, resistance=0.0, full=7.4, empty=7.4))
    battery.draw(7.4, 1800.0)
    assert battery.current == pytest.approx(1.0)
    assert battery.charge == 0.0
    fresh = Battery()
    fresh.draw(0.0, 60.0)
    assert 0.0 < fresh.charge < 1.0
    assert fresh.model.empty < fresh.voltage < fresh.model.full
