"""What a person may look at while the twin runs: MuJoCo's window, and the head cameras' pictures as topics."""

from __future__ import annotations

import os
from typing import Any, Protocol

from rclpy.node import Node
from sensor_msgs.msg import Image

from nermo_node import qos
from nermo_node.time import to_message
from nermo_sim.render import Renderer, RenderingUnavailableError
from nermo_sim.twin import Twin

CAMERAS = ("head_left", "head_right")
WINDOW_RATE = 30.0


class View(Protocol):
    """Something that shows a twin after each tick, if it is its time."""

    def show(self, twin: Twin[Any]) -> None:
        """Shows the present state, if that is due."""


def open_views(node: Node, twin: Twin[Any], window: bool, camera_rate: float, frame_prefix: str) -> list[View]:
    """Opens what was asked for; what this machine cannot show is left out with a warning."""
    views: list[View] = []
    if window and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        node.get_logger().warning("viewer: there is no display, so there is no window")
    elif window:
        views.append(Window(twin))
    if camera_rate > 0.0:
        try:
            views.append(HeadCameras(node, twin, camera_rate, frame_prefix))
        except RenderingUnavailableError as error:
            node.get_logger().warning(f"camera_rate: {error}; there are no pictures")
    return views


class Window:
    """MuJoCo's own viewer. Closing it does not end the simulation."""

    def __init__(self, twin: Twin[Any]) -> None:
        import mujoco.viewer  # opens a connection to the display, so only where one is wanted

        self._viewer = mujoco.viewer.launch_passive(twin.model, twin.data)
        self._next = 0

    def show(self, twin: Twin[Any]) -> None:
        """Redraws the window."""
        if twin.time_ns >= self._next and self._viewer.is_running():
            self._next = twin.time_ns + round(1e9 / WINDOW_RATE)
            self._viewer.sync()


class HeadCameras:
    """`<camera>/image_raw` of each head camera."""

    def __init__(self, node: Node, twin: Twin[Any], rate: float, frame_prefix: str) -> None:
        self._renderer = Renderer(twin.model, width=320, height=240)
        self._period = round(1e9 / rate)
        self._next = 0
        self._publishers = {
            camera: node.create_publisher(Image, f"{camera}/image_raw", qos.SENSOR) for camera in CAMERAS
        }
        self._frame_prefix = frame_prefix

    def show(self, twin: Twin[Any]) -> None:
        """Takes and publishes one picture of each camera."""
        if twin.time_ns < self._next:
            return
        self._next = twin.time_ns + self._period
        for camera, publisher in self._publishers.items():
            picture = self._renderer.picture(twin.data, camera)
            height, width, _ = picture.shape
            message = Image(height=height, width=width, encoding="rgb8", step=3 * width, data=picture.tobytes())
            message.header.stamp = to_message(twin.time_ns)
            message.header.frame_id = f"{self._frame_prefix}{camera}"
            publisher.publish(message)
