"""The leg state machine: order of the feet, duty factor, flags one tick ahead, changes at the start of a cycle."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from nermo_control.gait.gaits import GaitDefinition
from nermo_control.gait.knowledge_base import GaitParameters
from nermo_control.gait.phase import LegStateMachine, legs_at
from nermo_control.types import Phase
from nermo_description.parameters import LEGS

PERIOD = 5_000_000
GAITS = GaitParameters().gaits


def touch_downs(gait: GaitDefinition, samples: int = 10_000) -> dict[str, float]:
    """Share of the cycle at which each foot comes down, found by watching."""
    found = {}
    for number, leg in enumerate(LEGS):
        phases = [legs_at(k / samples, gait, 1.0).phases[number] for k in range(samples)]
        [down] = [k for k in range(samples) if phases[k] is Phase.STANCE and phases[k - 1] is Phase.SWING]
        found[leg] = down / samples
    return found


def test_the_lateral_walk_is_a_lateral_sequence() -> None:
    down = touch_downs(GAITS["lateral_walk"])
    assert sorted(down, key=down.__getitem__) == ["rear_left", "front_left", "rear_right", "front_right"]


@pytest.mark.parametrize("gait", ["trot", "walking_trot"])
def test_a_trot_moves_diagonal_pairs_half_a_cycle_apart(gait: str) -> None:
    down = touch_downs(GAITS[gait])
    assert down["front_left"] == down["rear_right"]
    assert down["front_right"] == down["rear_left"]
    assert abs(down["front_left"] - down["front_right"]) == pytest.approx(0.5)


@pytest.mark.parametrize("gait", GAITS)
def test_the_duty_factor_is_the_share_of_stance(gait: str) -> None:
    samples = 1000
    stance = sum(legs_at(k / samples, GAITS[gait], 1.0).phases[0] is Phase.STANCE for k in range(samples))
    assert stance / samples == pytest.approx(GAITS[gait].duty_factor, abs=2 / samples)


@given(
    st.floats(0.0, 3.0),
    st.floats(0.2, 0.95),
    st.tuples(*[st.floats(0.0, 1.0, exclude_max=True)] * 4),
    st.floats(0.1, 3.0),
)
def test_fraction_and_remaining_time_make_a_whole_phase(
    cycle: float, duty: float, offsets: tuple[float, float, float, float], frequency: float
) -> None:
    legs = legs_at(cycle, GaitDefinition(duty_factor=duty, phase_offsets=offsets), frequency)
    for phase, fraction, remaining in zip(legs.phases, legs.fractions, legs.remaining, strict=True):
        length = (duty if phase is Phase.STANCE else 1.0 - duty) / frequency
        assert 0.0 <= fraction < 1.0
        assert remaining > 0.0
        assert fraction * length + remaining == pytest.approx(length)


def run(
    machine: LegStateMachine, first: int, last: int, gait: str, frequency: float
) -> list[tuple[int, LegStateMachine]]:
    """Steps the ticks first...last; returns a list of (tick, requested, now, next) for ticks with a request."""
    events = []
    for tick in range(first, last):
        machine.step(tick * PERIOD, GAITS[gait], frequency)
        if any(machine.requested):
            events.append((tick, machine.requested, machine.now, machine.next))
    return events


def test_the_first_tick_asks_for_all_legs_and_each_change_is_flagged_one_tick_ahead() -> None:
    machine = LegStateMachine(PERIOD)
    machine.start(0, GAITS["trot"], 0.8)
    events = run(machine, 0, 500, "trot", 0.8)
    assert [event[0] for event in events] == [0, 125, 250, 375]
    assert events[0][1] == (True,) * 4
    for tick, requested, now, following in events[1:]:
        assert requested == (True,) * 4
        assert all(a is not b for a, b in zip(now.phases, following.phases, strict=True))
        expected = legs_at((tick * PERIOD) / 1.25e9, GAITS["trot"], 0.8)
        assert following.phases == expected.phases


def test_only_the_leg_that_changes_is_asked_for() -> None:
    machine = LegStateMachine(PERIOD)
    machine.start(0, GAITS["lateral_walk"], 0.8)
    events = run(machine, 0, 1000, "lateral_walk", 0.8)
    assert all(sum(event[1]) == 1 for event in events[1:])
    assert len(events) - 1 == pytest.approx(8 * 1000 * PERIOD * 0.8e-9, abs=2)


@pytest.mark.parametrize(("gait", "frequency"), [("walking_trot", 0.8), ("trot", 0.5)])
def test_a_new_gait_or_frequency_waits_for_the_next_cycle(gait: str, frequency: float) -> None:
    machine = LegStateMachine(PERIOD)
    machine.start(0, GAITS["trot"], 0.8)
    run(machine, 0, 100, "trot", 0.8)
    events = run(machine, 100, 600, gait, frequency)
    assert events[0][0] == 125, "the old gait goes on"
    tick, requested, _, following = events[1]
    assert (tick, requested) == (250, (True,) * 4), "the new one begins with all legs at the start of the next cycle"
    assert following == legs_at(0.0, GAITS[gait], frequency)


def test_a_cycle_that_is_no_multiple_of_the_tick_does_not_drift() -> None:
    machine = LegStateMachine(PERIOD)
    machine.start(0, GAITS["trot"], 0.67)
    ticks = 20_000
    changes = len(run(machine, 0, ticks, "trot", 0.67)) - 1
    assert changes == pytest.approx(2 * 0.67 * ticks * PERIOD * 1e-9, abs=1.01)
