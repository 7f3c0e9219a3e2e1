"""Publishes the samples of the device: the messages of `sample_topics`."""

from __future__ import annotations

import importlib
from array import array
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from rclpy.node import Node
from rclpy.publisher import Publisher

from nermo_description.parameters import RobotParameters
from nermo_hw.sample_topics import SAMPLE_TOPICS, SampleTopic, fill
from nermo_hw.types import Array, SensorSample
from nermo_node import qos
from nermo_node.time import to_message


@dataclass(frozen=True, slots=True)
class _Topic:
    """A topic, the samples from one of its messages to the next, and its one message."""

    publisher: Publisher
    every: int
    message: Any
    what: SampleTopic


class SamplePublishers:
    """Publishes what SAMPLE_TOPICS has.

    every: samples from one message to the next by topic; 1 where a topic is not named.
    """

    def __init__(self, node: Node, robot: RobotParameters, frame_prefix: str, every: Mapping[str, int]) -> None:
        self._count = 0
        self._topics = []
        for name, topic in SAMPLE_TOPICS.items():
            message = message_type(topic.type)()
            message.header.frame_id = f"{frame_prefix}{topic.frame}" if topic.frame else ""
            fill(message, topic.fixed(robot), _doubles)
            publisher = node.create_publisher(type(message), name, qos.SENSOR)
            self._topics.append(_Topic(publisher, every.get(name, 1), message, topic))

    def publish(self, sample: SensorSample) -> None:
        """Publishes what is due with this sample."""
        stamp = to_message(sample.stamp)
        for topic in self._topics:
            if self._count % topic.every == 0 and topic.what.said_with(sample):
                topic.message.header.stamp = stamp
                fill(topic.message, topic.what.fields(sample), _doubles)
                topic.publisher.publish(topic.message)
        self._count += 1


def message_type(name: str) -> Any:
    """The class of a message type by its name, as in `sensor_msgs/msg/Imu`. Raises ImportError and AttributeError."""
    package, _, message = name.split("/")
    return getattr(importlib.import_module(f"{package}.msg"), message)


def _doubles(values: Array) -> array[float]:
    return array("d", values)
