"""The door of a node: what it subscribes, and why it does not take what it gets."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message

from nermo_description.ranges import CHECKS, message_error
from nermo_node.backlog import Backlog

LARGEST_MESSAGE = 65_536
"""Bytes. A path of 20 000 points has 1.4 million, and 0.4 s would pass until Python had unpacked them."""

Take = Callable[[Any], None]
"""Takes a message; raises ValueError where it cannot be used."""


class Inputs:
    """The subscriptions of a node. What is too long, or out of the ranges of its kind, is refused in words.

    Where more comes than the node can take, messages of topics that it reads as best effort are left out.

    Args:
        node: Whose subscriptions these are.
        refuse: Gets a sentence for every message that is refused.
    """

    def __init__(self, node: Node, refuse: Callable[[str], None]) -> None:
        self._node, self._refuse = node, refuse
        self._backlog = Backlog(node, refuse)

    def subscribe(
        self,
        kind: type,
        topic: str,
        take: Take,
        profile: QoSProfile | int,
        refused: Callable[[], None] = lambda: None,
    ) -> None:
        """Hands messages of a kind that `nermo_description.ranges` knows over to `take`.

        refused: called after a refusal, for whom a sensor that says what cannot be is news.
        """
        name = kind_name(kind)
        may_be_lost = isinstance(profile, QoSProfile) and profile.reliability == ReliabilityPolicy.BEST_EFFORT

        def receive(packed: bytes) -> None:
            if may_be_lost and self._backlog.leaves_out():
                return
            try:
                take(unpack(kind, name, packed))
            except ValueError as error:
                self._refuse(f"{topic} refused: {error}")
                refused()

        self._node.create_subscription(kind, topic, receive, profile, raw=True)


def kind_name(kind: type) -> str:
    """As in sensor_msgs/Imu. Raises KeyError where nobody knows the ranges of this kind."""
    name = f"{kind.__module__.partition('.')[0]}/{kind.__name__}"
    if name not in CHECKS:
        raise KeyError(f"nermo_description.ranges does not know {name}")
    return name


def unpack(kind: type, name: str, packed: bytes) -> Any:
    """The message of a kind from its bytes. Raises ValueError where it is too long, broken or out of range."""
    if len(packed) > LARGEST_MESSAGE:
        raise ValueError(f"{len(packed)} bytes: allowed are {LARGEST_MESSAGE}")
    try:
        message = deserialize_message(packed, kind)
    except RuntimeError as error:
        raise ValueError(f"{len(packed)} bytes are no {name}") from error
    if (wrong := message_error(name, message)) is not None:
        raise ValueError(wrong)
    return message
