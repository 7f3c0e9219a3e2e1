"""The fixed-step cycle, in a time of its own."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from nermo_hw.serial.schedule import FixedStepSchedule


class Time:
    """Sleeping takes as long as it was asked for, and `late` more."""

    def __init__(self) -> None:
        self.now = 1_000_000
        self.late = 0.0

    def sleep(self, seconds: float) -> None:
        self.now += math.ceil((seconds + self.late) * 1e9)

    def work(self, seconds: float) -> None:
        self.now += round(seconds * 1e9)


@pytest.fixture
def time() -> Time:
    return Time()


def schedule(time: Time, period: float = 0.002) -> FixedStepSchedule:
    return FixedStepSchedule(period, clock=lambda: time.now, sleep=time.sleep)


def test_cycles_begin_on_the_grid(time):
    cycle = schedule(time)
    ticks = []
    for _ in range(5):
        ticks.append(cycle.wait())
        time.work(0.0005)
    assert [tick.number for tick in ticks] == [0, 1, 2, 3, 4]
    assert [tick.elapsed for tick in ticks] == pytest.approx([0.0, *[0.002] * 4])
    assert cycle.overruns == cycle.missed == 0


def test_an_overrun_is_told_with_the_time_that_really_passed_and_the_grid_stays(time):
    cycle = schedule(time)
    cycle.wait()
    time.work(0.0071)
    tick = cycle.wait()
    assert (tick.number, tick.missed) == (3, 2)
    assert tick.lateness == pytest.approx(0.0011)
    assert tick.elapsed == pytest.approx(0.0071)
    tick = cycle.wait()
    assert (tick.number, tick.missed) == (4, 0)
    assert tick.lateness < 1e-8
    assert (cycle.overruns, cycle.missed, cycle.cycles) == (1, 2, 3)


def test_lateness_of_the_machine_is_jitter(time):
    cycle = schedule(time)
    cycle.wait()
    time.late = 3e-4
    for _ in range(50):
        assert cycle.wait().lateness == pytest.approx(3e-4, abs=2e-9)
    assert cycle.jitter()["p99"] == pytest.approx(3e-4, abs=1e-6)
    assert cycle.overruns == 0


@given(st.lists(st.floats(0.0, 0.02), max_size=40))
def test_steps_taken_and_missed_add_up_whatever_the_work_takes(works):
    time = Time()
    cycle = schedule(time)
    begun = time.now
    last = cycle.wait()
    for work in works:
        time.work(work)
        tick = cycle.wait()
        assert tick.number == last.number + 1 + tick.missed
        assert tick.number * 0.002 == pytest.approx((time.now - begun) * 1e-9 - tick.lateness, abs=1e-8)
        last = tick
    assert cycle.cycles + cycle.missed == last.number + 1


def test_a_period_that_makes_no_sense_is_refused(time):
    with pytest.raises(ValueError, match="period"):
        schedule(time, period=0.0)
