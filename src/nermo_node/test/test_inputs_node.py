"""A node's door with real publishers: what is too long, broken or out of range is refused in words."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterator

import pytest
import rclpy
from geometry_msgs.msg import PoseStamped, TwistStamped
from nav_msgs.msg import Path
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.serialization import serialize_message
from sensor_msgs.msg import PointCloud2

from nermo_node import qos
from nermo_node.inputs import LARGEST_MESSAGE, Inputs
from nermo_node.run import EventsExecutor

PATIENCE_S = 90.0


class Door:
    """A node that takes paths and velocities, and whoever sends them."""

    def __init__(self, executor_type: type) -> None:
        self.node = Node("door")
        self._executor = executor_type()
        self._executor.add_node(self.node)
        self.taken: list[object] = []
        self.refused: list[str] = []
        inputs = Inputs(self.node, self.refused.append)
        inputs.subscribe(Path, "path", self._take, qos.EVENT)
        inputs.subscribe(TwistStamped, "cmd_vel", self._take, qos.EVENT)
        self.path = self.node.create_publisher(Path, "path", qos.EVENT)
        self.cmd_vel = self.node.create_publisher(TwistStamped, "cmd_vel", qos.EVENT)

    def _take(self, message: object) -> None:
        if isinstance(message, TwistStamped) and message.twist.linear.x == 0.5:
            raise ValueError("0.5 is not liked")
        self.taken.append(message)

    def until(self, condition: Callable[[], bool], act: Callable[[], None]) -> None:
        deadline = time.monotonic() + PATIENCE_S
        while not condition():
            assert time.monotonic() < deadline, "waited in vain"
            act()
            self._executor.spin_once(timeout_sec=0.05)

    def close(self) -> None:
        self._executor.shutdown()
        self.node.destroy_node()


@pytest.fixture(params=[EventsExecutor, SingleThreadedExecutor])
def door(request: pytest.FixtureRequest) -> Iterator[Door]:
    rclpy.init()
    made = Door(request.param)
    yield made
    made.close()
    rclpy.shutdown()


def twist(velocity: float) -> TwistStamped:
    message = TwistStamped()
    message.twist.linear.x = velocity
    return message


def test_a_usual_message_is_taken(door: Door) -> None:
    door.until(lambda: bool(door.taken), lambda: door.cmd_vel.publish(twist(0.1)))
    assert door.taken[0] == twist(0.1)
    assert not door.refused


def test_a_message_that_is_too_long_is_not_even_unpacked(door: Door) -> None:
    path = Path(poses=[PoseStamped()] * 20_000)
    packed = serialize_message(path)
    door.until(lambda: bool(door.refused), lambda: door.path.publish(packed))
    assert door.refused[0] == f"path refused: {len(packed)} bytes: allowed are {LARGEST_MESSAGE}"
    assert not door.taken


def test_bytes_that_are_no_message_are_refused(door: Door) -> None:
    packed = serialize_message(Path(poses=[PoseStamped()] * 3))[:50]
    door.until(lambda: bool(door.refused), lambda: door.path.publish(packed))
    assert door.refused[0] == "path refused: 50 bytes are no nav_msgs/Path"


def test_what_is_out_of_range_and_what_the_node_cannot_use_is_refused_in_words(door: Door) -> None:
    door.until(lambda: bool(door.refused), lambda: door.cmd_vel.publish(twist(1e308)))
    assert door.refused[0] == "cmd_vel refused: twist.linear.x = 1e+308 m/s: allowed -10 to 10 m/s"
    door.refused.clear()
    door.until(lambda: "cmd_vel refused: 0.5 is not liked" in door.refused, lambda: door.cmd_vel.publish(twist(0.5)))
    assert not door.taken


def test_whoever_wants_hears_that_something_was_refused(door: Door) -> None:
    hears: list[str] = []
    Inputs(door.node, door.refused.append).subscribe(
        TwistStamped, "cmd_vel", door.taken.append, 10, lambda: hears.append("refused")
    )
    door.until(lambda: bool(hears), lambda: door.cmd_vel.publish(twist(math.nan)))
    assert "cmd_vel refused: twist.linear.x = nan m/s" in door.refused[0]
    assert not door.taken


def test_a_kind_without_ranges_cannot_be_subscribed(door: Door) -> None:
    with pytest.raises(KeyError, match="does not know sensor_msgs/PointCloud2"):
        Inputs(door.node, door.refused.append).subscribe(PointCloud2, "cloud", door.taken.append, 10)


def test_a_flood_that_is_too_much_is_left_out_and_what_comes_after_it_is_taken() -> None:
    rclpy.init()
    door = Door(EventsExecutor)
    flooding = threading.Event()
    try:
        slow: list[TwistStamped] = []

        def take(message: TwistStamped) -> None:
            time.sleep(0.005)
            slow.append(message)

        Inputs(door.node, door.refused.append).subscribe(TwistStamped, "sensor", take, qos.BEST_EFFORT)
        sender = door.node.create_publisher(TwistStamped, "sensor", qos.SENSOR)

        def flood() -> None:
            while flooding.is_set():
                sender.publish(TwistStamped())
                time.sleep(0.0005)

        flooding.set()
        thread = threading.Thread(target=flood)
        thread.start()
        try:
            door.until(lambda: any("left out, unread" in said for said in door.refused), lambda: None)
        finally:
            flooding.clear()
            thread.join()
        one = TwistStamped()
        one.twist.linear.x = 0.25
        door.until(lambda: one in slow, lambda: sender.publish(one))
    finally:
        door.close()
        rclpy.shutdown()
