"""Emergency stops at the twin's node, over real DDS: each publisher is a source, and only a release ends a stop."""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar

import pytest
from graph import Graph
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, rule
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from nermo_node import qos


@pytest.fixture
def graph() -> Iterator[Graph]:
    graph = Graph()
    yield graph
    graph.close()


class Stopped:
    """The twin's node, and people who stop it."""

    def __init__(self, graph: Graph) -> None:
        self.graph = graph
        self._publishers = [graph.node.create_publisher(Bool, "emergency_stop", qos.LATCHED) for _ in range(2)]

    def say(self, source: int, stop: bool) -> None:
        publisher = self._publishers[source]
        self.graph.until(lambda: publisher.get_subscription_count() > 0, "it is heard")
        publisher.publish(Bool(data=stop))

    def leave(self, source: int) -> None:
        self.graph.node.destroy_publisher(self._publishers[source])
        self._publishers[source] = self.graph.node.create_publisher(Bool, "emergency_stop", qos.LATCHED)

    def release(self) -> str:
        return str(self.graph.call(Trigger, "mujoco_sim/release", Trigger.Request()).message)

    def limp(self) -> bool:
        return self.graph.status().get("servos") == "nothing: no power"


def test_the_twin_goes_limp_says_so_and_waits_for_a_release_that_nobody_stands_against(graph: Graph) -> None:
    graph.start("-r", "__node:=mujoco_sim", real_time_factor=0.2)
    stopped = Stopped(graph)
    stopped.say(0, True)
    graph.until(stopped.limp, "it is limp")
    says = "limp: emergency_stop (/tester says stop)"
    graph.until(lambda: graph.status()["message"] == says, "it says who, which ROS may know a little later")
    assert stopped.release() == "emergency_stop (/tester still says stop: end it there first)"
    stopped.say(1, True)
    stopped.say(0, False)
    graph.until(lambda: stopped.release() != "", "the second one stands against it")
    stopped.leave(1)
    graph.until(lambda: stopped.release() == "", "who is gone stands against nothing")
    graph.until(lambda: not stopped.limp(), "it has power")


class TwinStops(RuleBasedStateMachine):
    """Any order of presses, ends, departures and releases; the answer of each release says what the twin thinks."""

    stopped: ClassVar[Stopped]

    def __init__(self) -> None:
        super().__init__()
        self.saying: set[int] = set()
        for source in (0, 1):
            self.stopped.say(source, False)
        self.stopped.graph.until(lambda: self.stopped.release() == "", "a new story begins")

    @rule(source=st.sampled_from((0, 1)), stop=st.booleans())
    def says(self, source: int, stop: bool) -> None:
        self.stopped.say(source, stop)
        self.saying = self.saying | {source} if stop else self.saying - {source}

    @rule(source=st.sampled_from((0, 1)))
    def leaves(self, source: int) -> None:
        self.stopped.leave(source)
        self.saying -= {source}

    @rule()
    def released(self) -> None:
        granted = not self.saying
        self.stopped.graph.until(lambda: (self.stopped.release() == "") == granted, f"granted is {granted}")


def test_any_order_of_events_at_the_twin(graph: Graph) -> None:
    graph.start("-r", "__node:=mujoco_sim", real_time_factor=0.2)
    TwinStops.stopped = Stopped(graph)
    machine = TwinStops.TestCase
    machine.settings = settings(
        max_examples=6, stateful_step_count=8, deadline=None, suppress_health_check=list(HealthCheck)
    )
    machine().runTest()
