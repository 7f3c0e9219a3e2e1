"""Two mice in one graph: each hears its own operator, and the frames have their own prefix."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest
from control_graph import NODES, PERIOD, ControlGraph, GraphRobot
from tf2_msgs.msg import TFMessage

from nermo_control.types import ControlCommand
from nermo_description.parameters import RobotParameters
from nermo_node import qos


@pytest.fixture
def graph() -> Iterator[ControlGraph]:
    graph = ControlGraph()
    yield graph
    graph.close()


def test_two_mice_side_by_side(graph: ControlGraph, robot: RobotParameters) -> None:
    mice = [GraphRobot(graph, namespace, robot, clock=namespace == "left") for namespace in ("left", "right")]
    for mouse in mice:
        for name in NODES:
            prefix = {"frame_prefix": f"{mouse.namespace}/"} if name == "state_publisher" else {}
            graph.start(mouse.namespace, name, **prefix)
    frames: set[tuple[str, str]] = set()
    graph.node.create_subscription(
        TFMessage,
        "/tf",
        lambda message: frames.update((tf.header.frame_id, tf.child_frame_id) for tf in message.transforms),
        qos.TRANSFORM,
    )
    walker, stander = mice
    walker.command = ControlCommand(0, forward_velocity=0.08)

    def until(condition: Callable[[], bool], what: str) -> None:
        """Both tick by the same clock."""

        def tick_the_other() -> bool:
            stander.stamp = walker.stamp - PERIOD
            stander.tick()
            return condition()

        walker.run_until(tick_the_other, what)

    until(lambda: walker.walking and len(stander.answers) > 50, "one walks")
    assert stander.moves(10.0) == 0.0
    assert not stander.walking

    walker.command, stander.command = None, ControlCommand(0, forward_velocity=0.05)
    until(lambda: stander.walking and not walker.walking and len(frames) == 4, "the other one walks")
    base = {("odom", "base_footprint"), ("base_footprint", "base_link")}
    assert frames == {
        (f"{mouse.namespace}/{parent}", f"{mouse.namespace}/{child}") for mouse in mice for parent, child in base
    }
