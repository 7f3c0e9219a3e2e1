"""Command topics: one publisher at a time, stamps of this graph's clock, and every refusal in words."""

from __future__ import annotations

import inspect
import time
from collections.abc import Callable
from functools import partial
from typing import Any

from rclpy.node import Node
from rclpy.qos import QoSProfile

from nermo_description.commanding import Ownership, command_time
from nermo_description.silence import OWNER
from nermo_node import qos
from nermo_node.backlog import Backlog
from nermo_node.diagnostics import OK, Status
from nermo_node.inputs import Take, kind_name, unpack
from nermo_node.time import to_message, to_nanoseconds

UNNAMED = b""
"""The sender of a message of which ROS does not say whose it is."""


class CommandInput:
    """The command topics of one receiver, which together have one owner; the door is that of `Inputs`.

    The first publisher whose command is usable owns them until it has been silent for `silence.OWNER`; meanwhile all
    others are refused by name. Publishers are told apart by the identifier that the middleware gives each. A ROS that
    does not hand it over (Jazzy) cannot tell them apart, so there nobody is obeyed while there are several. Of a flood,
    messages are left out, whosever they are.

    Args:
        node: Whose subscriptions these are.
        refuse: Gets a sentence for every message that is refused.
        now: The time [ns] that stamps are compared with.
        oldest: How far a stamp may be from it [s]. None leaves all stamps as they are: in lockstep they name the tick,
            and a door behind may judge them itself.
    """

    def __init__(self, node: Node, refuse: Callable[[str], None], now: Callable[[], int], oldest: float | None) -> None:
        self._node, self._refuse, self._now, self._oldest = node, refuse, now, oldest
        self._backlog = Backlog(node, refuse)
        self._ownership: Ownership[bytes] = Ownership()
        self._topics: list[str] = []
        self._names: dict[bytes, str] = {}

    def subscribe(
        self, kind: type, topic: str, take: Take, profile: QoSProfile = qos.COMMAND_INPUT, *, raw: bool = False
    ) -> None:
        """Hands messages with a header over to `take`, those of the owner alone; a stamp of 0 becomes now.

        raw: as the bytes that came, with whatever stamp they have.
        """
        assert self._oldest is None or not raw, "stamps of raw messages are not read here"
        name = kind_name(kind)

        def receive(packed: bytes, info: dict[str, Any]) -> None:
            if self._backlog.leaves_out():
                return
            try:
                message = partial(unpack, kind, name, packed)
                self._receive(message, sender_of(info), (lambda _: take(packed)) if raw else take)
            except ValueError as error:
                self._refuse(f"{topic} refused: {error}")

        subscription = self._node.create_subscription(kind, topic, WithInfo(receive), profile, raw=True)
        self._topics.append(subscription.topic_name)

    def status(self) -> Status:
        """Who commands, for the diagnostics."""
        owner = self._ownership.owner(time.monotonic_ns())
        if owner is None:
            return OK, "nobody commands", {"owner": ""}
        name = self._name(owner)
        return OK, f"{name} commands", {"owner": name}

    def _receive(self, unpacked: Callable[[], Any], sender: bytes, take: Take) -> None:
        arrived = time.monotonic_ns()
        if sender == UNNAMED:
            self._insist_on_one_publisher()
        elif not self._ownership.admits(sender, arrived):
            owner = self._ownership.owner(arrived)
            assert owner is not None, "nobody is refused unless somebody commands"
            raise ValueError(
                f"{self._name(sender)} has to wait, {self._name(owner)} commands until it is silent for "
                f"{OWNER.after:g} s"
            )
        message = unpacked()
        if self._oldest is not None:
            stamp = to_nanoseconds(message.header.stamp)
            if (counts := command_time(stamp, self._now(), self._oldest, self._oldest)) != stamp:
                message.header.stamp = to_message(counts)
        take(message)
        self._ownership.heard(sender, arrived)

    def _insist_on_one_publisher(self) -> None:
        publishers = self._publishers()
        if len(publishers) > 1:
            raise ValueError(
                f"{', '.join(sorted(publishers.values()))} publish commands, and this version of ROS does not tell "
                "whose a message is: leave only one of them running"
            )

    def _publishers(self) -> dict[bytes, str]:
        return {
            bytes(found.endpoint_gid): f"{found.node_namespace.rstrip('/')}/{found.node_name}"
            for topic in self._topics
            for found in self._node.get_publishers_info_by_topic(topic)
        }

    def _name(self, sender: bytes) -> str:
        """The publisher's node, also after it has gone."""
        if sender not in self._names:
            self._names = self._publishers()
        return self._names.get(sender, "a publisher without a name")


class WithInfo:
    """A subscription's callback that gets the message's origin too.

    The events executor of Kilted hands both over as one tuple, against rclpy's own documentation.
    """

    __signature__ = inspect.Signature(
        [inspect.Parameter(name, inspect.Parameter.POSITIONAL_ONLY) for name in ("message", "info")]
    )

    def __init__(self, receive: Callable[[Any, dict[str, Any]], None]) -> None:
        self._receive = receive

    def __call__(self, *arguments: Any) -> None:
        message, info = arguments[0] if len(arguments) == 1 else arguments
        self._receive(message, info)


def sender_of(info: dict[str, Any]) -> bytes:
    """The middleware's identifier of the publisher of a message; empty where ROS does not hand it over."""
    gid = info.get("publisher_gid")
    return UNNAMED if gid is None else bytes(gid["data"])
