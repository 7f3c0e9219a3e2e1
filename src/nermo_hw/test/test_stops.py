"""Emergency stops at twin, cable and link: no order of events gives power while somebody says stop."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule
from stop_places import EVENTS, GIVEN_UP, SOURCES, Cable, Expected, Link, Place, Twin, do

PLACES: dict[str, Callable[[], Place]] = {"twin": Twin, "cable": Cable, "link": Link}


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("length", [1, 2, 3])
def test_every_order_of_events(place: str, length: int) -> None:
    for events in itertools.product(EVENTS, repeat=length):
        here, expected = PLACES[place](), Expected()
        for event in events:
            assert do(here, event) == expected.event(event), events
            assert here.limp() == expected.stopped, events


@pytest.mark.parametrize("place", PLACES)
def test_a_second_stop_is_obeyed_whatever_became_of_the_first(place: str) -> None:
    here = PLACES[place]()
    here.say("pad", True)
    assert here.release() == "emergency_stop (pad still says stop: end it there first)"
    assert here.limp()
    here.say("pad", False)
    assert here.limp()
    here.say("pad", True)
    assert here.limp()


@pytest.mark.parametrize("place", PLACES)
def test_the_end_of_one_stop_ends_no_other(place: str) -> None:
    here = PLACES[place]()
    here.signal()
    here.say("pad", True)
    here.say("pad", False)
    assert here.limp()
    assert here.release() == ""
    assert not here.limp()


class Machine(RuleBasedStateMachine):
    """Long stories, which the table does not reach."""

    make: Callable[[], Place]

    def __init__(self) -> None:
        super().__init__()
        self.place, self.expected = type(self).make(), Expected()

    @rule(event=st.sampled_from(EVENTS))
    def happens(self, event: str) -> None:
        assert do(self.place, event) == self.expected.event(event)

    @invariant()
    def limp_as_expected(self) -> None:
        assert self.place.limp() == self.expected.stopped


class AtTwin(Machine):
    make = Twin


class AtCable(Machine):
    make = Cable


TestAtTwin, TestAtCable = AtTwin.TestCase, AtCable.TestCase


class AtLink(RuleBasedStateMachine):
    """With a wire that is cut, ends that start anew or die, and a second workstation that may release too."""

    def __init__(self) -> None:
        super().__init__()
        self.link = Link()
        self.saying: set[str] = set()
        """What is true of the publishers at the workstation."""
        self.believed: set[str] = set()
        """What the robot's end knows of it from the workstation's present end."""
        self.last_words: set[str] = set()
        """What an end has said that is no more: it stands until that end is given up."""
        self.untold = False
        """Whether the workstation's end has seen a stop of which the robot does not know yet."""
        self.alive = True
        self.stopped = False

    def contact(self) -> None:
        """The robot is told, if it can be."""
        if self.alive and not self.link.wire.cut:
            self.stopped = self.stopped or bool(self.saying) or self.untold
            self.believed, self.untold = set(self.saying), False

    @rule(source=st.sampled_from(SOURCES))
    def press(self, source: str) -> None:
        self.link.say(source, True)
        self.untold = self.untold or (self.alive and source not in self.saying)
        self.saying.add(source)
        self.contact()

    @rule(source=st.sampled_from(SOURCES), leaves=st.booleans())
    def end(self, source: str, leaves: bool) -> None:
        if leaves:
            self.link.leave(source)
        else:
            self.link.say(source, False)
        self.saying.discard(source)
        self.contact()

    @rule()
    def signal(self) -> None:
        self.link.signal()
        self.stopped = True

    @rule(other=st.booleans())
    def release(self, other: bool) -> None:
        answer = self.link.other_release() if other else self.link.release()
        if self.link.wire.cut or not (self.alive or other):
            assert answer is None
            return
        standing = self.believed | self.last_words
        granted = not standing
        assert (answer == "") == granted, answer
        assert all(source in str(answer) for source in standing)
        if granted:
            self.stopped = False

    @rule(cut=st.booleans())
    def wire(self, cut: bool) -> None:
        self.link.wire.cut = cut
        self.link.pass_time(0.1)
        self.contact()

    @rule()
    def long_time(self) -> None:
        self.link.pass_time(GIVEN_UP)
        self.last_words = set()
        if self.link.wire.cut or not self.alive:
            self.believed = set()

    @rule()
    def robot_end_starts_anew(self) -> None:
        self.link.start_robot()
        self.stopped, self.believed, self.last_words = True, set(), set()
        self.contact()

    @rule()
    def workstation_starts_anew(self) -> None:
        self.link.start_workstation()
        self.last_words, self.believed = self.last_words | self.believed, set()
        self.alive, self.untold = True, bool(self.saying)
        self.contact()

    @precondition(lambda self: self.alive)
    @rule()
    def workstation_dies(self) -> None:
        self.link.kill_workstation()
        self.last_words, self.believed = self.last_words | self.believed, set()
        self.alive = self.untold = False

    @invariant()
    def limp_as_expected(self) -> None:
        assert self.link.limp() == self.stopped


TestAtLink = AtLink.TestCase
TestAtLink.settings = settings(max_examples=40, stateful_step_count=30, deadline=None)

LINK_EVENTS: dict[str, Callable[[AtLink], None]] = {
    "press": lambda link: link.press("pad"),
    "cut": lambda link: link.wire(True),
    "end": lambda link: link.end("pad", False),
    "mend": lambda link: link.wire(False),
    "release": lambda link: link.release(False),
    "workstation anew": lambda link: link.workstation_starts_anew(),
    "robot anew": lambda link: link.robot_end_starts_anew(),
    "long time": lambda link: link.long_time(),
}


@pytest.mark.parametrize(("count", "length"), [(6, 4), (8, 3)])
@pytest.mark.parametrize("first", ["press", "cut"])
def test_every_order_of_events_at_the_link(first: str, count: int, length: int) -> None:
    """The first `count` events in every order; what begins otherwise is a shorter story."""
    for others in itertools.product(list(LINK_EVENTS)[:count], repeat=length - 1):
        story = AtLink()
        for event in (first, *others):
            LINK_EVENTS[event](story)
            assert story.link.limp() == story.stopped, (first, *others)
