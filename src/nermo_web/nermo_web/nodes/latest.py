"""The latest message of a topic, unpacked only when somebody looks."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.node import Node
from rclpy.qos import QoSProfile

from nermo_node import qos
from nermo_node.inputs import kind_name, unpack


class Latest:
    """A topic that comes far more often than it is looked at. The door is that of `Inputs`.

    Args:
        node: Whose subscription it is.
        kind: The type of its messages.
        topic: Its name.
        refuse: Gets a sentence for a message that is refused.
        profile: Its quality of service.
    """

    def __init__(
        self,
        node: Node,
        kind: type,
        topic: str,
        refuse: Callable[[str], None],
        profile: QoSProfile = qos.BEST_EFFORT,
    ) -> None:
        self._kind, self._topic, self._refuse = kind, topic, refuse
        self._name = kind_name(kind)
        self._packed: bytes | None = None
        node.create_subscription(kind, topic, self._receive, profile, raw=True)

    def take(self) -> Any | None:
        """The newest message since the last call; None where there is none, or none that can be used."""
        packed, self._packed = self._packed, None
        if packed is None:
            return None
        try:
            return unpack(self._kind, self._name, packed)
        except ValueError as error:
            self._refuse(f"{self._topic} refused: {error}")
            return None

    def _receive(self, packed: bytes) -> None:
        self._packed = packed
