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


def test_what_is_told_as_a_state_may_be_told_as_often_as_one_likes() -> None:
    here, there = EmergencyStops(), EmergencyStops()
    here.say(b"\x01", True, "pad")
    for _ in range(3):
        there.take("desk", here.told())
    assert str(there) == "pad says stop"
    here.say(b"\x01", False)
    there.take("desk", here.told())
    assert str(there) == "pad has said stop and waits for a release"
    assert there.release() == ""
    there.take("desk", here.told())
    assert not there.active, "a stop that was released is not another one for being told again"
    here.press("SIGUSR1")
    here.say(b"\x01", True, "pad")
    here.say(b"\x01", False)
    there.take("desk", here.told())
    assert str(there) == "SIGUSR1 and pad have said stop and wait for a release"


def test_a_far_end_that_is_gone_or_another_one_changes_nothing_for_the_rest() -> None:
    desk, lap, robot = EmergencyStops(), EmergencyStops(), EmergencyStops()
    desk.say("pad", True)
    lap.say("pad", True)
    robot.take("desk", desk.told())
    robot.take("lap", lap.told())
    robot.take("desk", ())
    assert robot.release() != ""
    robot.forget("lap")
    assert robot.active
    assert robot.release() == ""
    robot.take("lap", lap.told())
    assert robot.active, "who comes back and says stop stops"


def test_a_signal_in_the_midst_of_a_release_is_not_swept_away() -> None:
    class Sneaky(dict):  # type: ignore[type-arg]
        def values(self):  # type: ignore[no-untyped-def]
            values = list(super().values())
            stops.press("SIGUSR1")
            return values

    stops = EmergencyStops()
    stops.say("pad", True)
    stops.say("pad", False)
    stops._saying = Sneaky()
    assert stops.release() == "emergency_stop (SIGUSR1 and pad have said stop and wait for a release)"
    assert stops.active


def test_a_name_may_be_learnt_after_the_stop() -> None:
    stops = EmergencyStops()
    stops.say("a", True, "somebody")
    stops.rename({"a": "/pad", "b": "/nobody"})
    assert str(stops) == "/pad says stop"
    stops.say("a", False)
    assert str(stops) == "/pad has said stop and waits for a release"
    assert stops.release() == ""
    stops.rename({"a": "/pad"})
    assert not stops.active
