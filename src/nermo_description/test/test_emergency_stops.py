"""Emergency stops by source: no order of presses, ends and releases gives power while somebody says stop."""

from __future__ import annotations

import itertools

import pytest
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from nermo_description.emergency_stops import EmergencyStops

SOURCES = ("pad", "keyboard", "topic")
EVENTS = ("press pad", "end pad", "press topic", "end topic", "signal", "topic is gone", "release")


class Expected:
    """What the sentences of the documentation say, written down a second time and as plainly as possible."""

    def __init__(self) -> None:
        self.saying: set[str] = set()
        self.stopped = False

    def event(self, event: str) -> bool | None:
        """Takes an event; of a release, whether it is granted."""
        match event.split():
            case ["press", source]:
                self.saying.add(source)
                self.stopped = True
            case ["end", source] | [source, "is", "gone"]:
                self.saying.discard(source)
            case ["signal"]:
                self.stopped = True
            case ["release"]:
                self.stopped = self.stopped and bool(self.saying)
                return not self.saying
        return None


def do(stops: EmergencyStops, event: str) -> bool | None:
    match event.split():
        case ["press", source]:
            stops.say(source, True)
        case ["end", source]:
            stops.say(source, False)
        case [gone, "is", "gone"]:
            stops.keep([source for source in SOURCES if source != gone])
        case ["signal"]:
            stops.press("SIGUSR1")
        case ["release"]:
            return stops.release() == ""
    return None


@pytest.mark.parametrize("length", [1, 2, 3, 4, 5])
def test_every_order_of_events(length: int) -> None:
    for events in itertools.product(EVENTS, repeat=length):
        stops, expected = EmergencyStops(), Expected()
        for event in events:
            assert do(stops, event) == expected.event(event), events
            assert stops.active == expected.stopped, events


class StopsMachine(RuleBasedStateMachine):
    """Long stories, which the table does not reach."""

    def __init__(self) -> None:
        super().__init__()
        self.stops, self.expected = EmergencyStops(), Expected()

    @rule(event=st.sampled_from(EVENTS))
    def happens(self, event: str) -> None:
        assert do(self.stops, event) == self.expected.event(event)

    @invariant()
    def stopped_as_expected(self) -> None:
        assert self.stops.active == self.expected.stopped
        assert bool(str(self.stops)) == self.expected.stopped


TestStops = StopsMachine.TestCase


def test_a_release_that_is_refused_says_by_whom() -> None:
    stops = EmergencyStops()
    stops.say(b"\x01", True, "/nermo/teleop")
    stops.press("SIGUSR1")
    assert stops.release() == "emergency_stop (/nermo/teleop still says stop: end it there first)"
    assert str(stops) == "/nermo/teleop says stop, SIGUSR1 has said stop and waits for a release"


def test_two_publishers_of_one_name_are_two_sources() -> None:
    stops = EmergencyStops()
    stops.say(b"\x01", True, "/nermo/teleop")
    stops.say(b"\x02", True, "/nermo/teleop")
    stops.say(b"\x01", False, "/nermo/teleop")
    assert stops.release() != ""
    stops.keep([b"\x01"])
    assert stops.active
    assert stops.release() == ""
    assert not stops.active
