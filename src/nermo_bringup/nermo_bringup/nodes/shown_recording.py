"""A recording in the page of the browser: its topics come again in their own time, and nothing drives."""

from __future__ import annotations

import importlib
import os
import re
from collections.abc import Iterator, Mapping

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile

from nermo_node.recording_reader import RawMessage, Recording
from nermo_node.run import run
from nermo_web.nodes.cameras import KINDS
from nermo_web.nodes.web import Web

NAMESPACE = "/replay"
"""Another than a robot's own, so that no node of one hears an old command as a new one."""
PERIOD_S = 0.01
PAUSE_S = 2.0
"""Between the end of a recording and its beginning anew."""
HEARD = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""What suits every subscription."""


class Reel:
    """Publishes what a recording holds of a page's topics, again and again.

    Args:
        node: The page, in `NAMESPACE`.
        recording: Holds the topics of one robot.

    Raises:
        RecordingError: It says nowhere where the robot was.
    """

    def __init__(self, node: Node, recording: Recording) -> None:
        self._node, self._recording = node, recording
        place = recording.topic_ending("odom")
        namespace = re.sub("(/truth|/tracker)?/odom$", "", place)
        wanted = {subscription.topic_name for subscription in node.subscriptions}
        self._publishers: Mapping[str, Publisher] = {
            topic.name: node.create_publisher(_kind(topic.type), shown, HEARD)
            for topic in recording.topics.values()
            if (shown := _shown("odom" if topic.name == place else topic.name, namespace)) in wanted
            or topic.type in KINDS
        }
        self._messages: Iterator[RawMessage] = iter(())
        self._next: RawMessage | None = None
        self._offset = 0
        """[ns] from a message's time to when it is due."""
        self._clock = Clock(clock_type=ClockType.STEADY_TIME)
        self._rewind(0.0)
        node.create_timer(PERIOD_S, self._publish, clock=self._clock)

    def _rewind(self, pause: float) -> None:
        self._messages = self._recording.raw(self._publishers)
        self._next = next(self._messages, None)
        if self._next is not None:
            self._offset = self._clock.now().nanoseconds + round(pause * 1e9) - self._next.log_time

    def _publish(self) -> None:
        now = self._clock.now().nanoseconds
        while self._next is not None and self._next.log_time + self._offset <= now:
            self._publishers[self._next.topic].publish(self._next.data)
            self._next = next(self._messages, None)
        if self._next is None:
            self._rewind(PAUSE_S)


def _shown(topic: str, namespace: str) -> str:
    if not topic.startswith("/"):
        return f"{NAMESPACE}/{topic}"
    return f"{NAMESPACE}{topic.removeprefix(namespace)}" if topic.startswith(f"{namespace}/") else topic


def _kind(name: str) -> type:
    package, _, kind = name.split("/")
    found: type = getattr(importlib.import_module(f"{package}.msg"), kind)
    return found


def show(recording: Recording, robot: str, host: str, port: int) -> int:
    """Shows a recording until somebody ends it; the exit status."""
    # A domain of its own, where no robot hears it.
    os.environ["ROS_DOMAIN_ID"] = str(1 + (int(os.environ.get("ROS_DOMAIN_ID") or 0) + os.getpid() % 99) % 100)
    values = {"robot": robot, "host": host, "port": port, "recording": str(recording.path)}

    def page() -> Node:
        node = Web()
        Reel(node, recording)
        return node

    arguments = [word for name, value in values.items() for word in ("-p", f"{name}:={value}")]
    return run(page, ["--ros-args", "-r", f"__ns:={NAMESPACE}", *arguments])
