"""Pictures that anybody in the graph publishes, for the page; nothing is subscribed while nobody looks."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from rclpy.node import Node
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription
from sensor_msgs.msg import CompressedImage, Image

from nermo_node import qos
from nermo_web.pictures import LARGEST_BYTES, compressed, kind_of

KINDS: dict[str, type] = {"sensor_msgs/msg/CompressedImage": CompressedImage, "sensor_msgs/msg/Image": Image}
MOST = 4
"""Cameras that are shown."""
LOOK_S = 1.0
"""Between two looks at which topics there are."""
FRESH_S = 2.0
"""A picture that is older is shown no more."""


class Camera:
    """The newest picture of a topic."""

    def __init__(self, node: Node, topic: str, kind: type, refuse: Callable[[str], None]) -> None:
        self._topic, self._kind, self._refuse = topic, kind, refuse
        self._packed: bytes | None = None
        self._at = 0.0
        self.picture = b""
        self.subscription: Subscription[Any] = node.create_subscription(
            kind, topic, self._receive, qos.BEST_EFFORT, raw=True
        )

    def _receive(self, packed: bytes) -> None:
        self._packed = packed

    def take(self) -> None:
        """Unpack what came last; an old picture goes."""
        packed, self._packed = self._packed, None
        if packed is not None:
            try:
                self.picture, self._at = self._unpacked(packed), time.monotonic()
            except ValueError as error:
                self._refuse(f"{self._topic} refused: {error}")
        elif time.monotonic() - self._at > FRESH_S:
            self.picture = b""

    def _unpacked(self, packed: bytes) -> bytes:
        if len(packed) > LARGEST_BYTES:
            raise ValueError(f"{len(packed)} bytes: allowed are {LARGEST_BYTES}")
        try:
            message: Any = deserialize_message(packed, self._kind)
        except RuntimeError as error:
            raise ValueError(f"{len(packed)} bytes are no {self._kind.__name__}") from error
        data = bytes(message.data)
        if self._kind is Image:
            return compressed(data, message.encoding, message.width, message.height, message.step)
        kind_of(data)
        return data


class Cameras:
    """All topics of pictures, by name; of a camera that compresses them itself, the compressed ones alone."""

    def __init__(self, node: Node, refuse: Callable[[str], None]) -> None:
        self._node, self._refuse = node, refuse
        self._cameras: dict[str, Camera] = {}
        self._looked = 0.0

    def pictures(self, watched: bool) -> dict[str, bytes]:
        """The fresh picture of each topic; to be asked some ten times a second."""
        if not watched:
            self._keep({})
        elif time.monotonic() - self._looked > LOOK_S:
            self._looked = time.monotonic()
            self._keep(self._there())
        for camera in self._cameras.values():
            camera.take()
        return {topic: camera.picture for topic, camera in self._cameras.items() if camera.picture}

    def _there(self) -> dict[str, type]:
        found = {
            topic: KINDS[kind]
            for topic, kinds in sorted(self._node.get_topic_names_and_types())
            for kind in kinds[:1]
            if kind in KINDS and self._node.count_publishers(topic)
        }
        return {t: kind for t, kind in found.items() if kind is CompressedImage or f"{t}/compressed" not in found}

    def _keep(self, there: dict[str, type]) -> None:
        for topic in [topic for topic in self._cameras if topic not in there]:
            self._node.destroy_subscription(self._cameras.pop(topic).subscription)
        for topic in [topic for topic in there if topic not in self._cameras][: MOST - len(self._cameras)]:
            self._cameras[topic] = Camera(self._node, topic, there[topic], self._refuse)
