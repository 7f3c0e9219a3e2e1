"""The state publisher as a node: odom carries the stamp of its tick, from truth or by dead reckoning."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import pytest
from control_graph import PERIOD, ControlGraph
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Imu
from tf2_msgs.msg import TFMessage

from nermo_control.nodes.conversions import ServoArrays, header, odometry_from_message
from nermo_description.parameters import RobotParameters
from nermo_interfaces.msg import ServoStates
from nermo_node import qos
from nermo_node.time import to_nanoseconds


@pytest.fixture
def graph() -> Iterator[ControlGraph]:
    graph = ControlGraph()
    yield graph
    graph.close()


def listen(graph: ControlGraph) -> list[Odometry]:
    heard: list[Odometry] = []
    graph.node.create_subscription(Odometry, "mouse/odom", heard.append, qos.EVENT)
    return heard


def ticks(graph: ControlGraph, publish: Callable[[int], None], condition: Callable[[], bool], what: str) -> None:
    """One tick after the other until something holds."""
    stamps = iter(range(PERIOD, 10**12, PERIOD))

    def tick() -> bool:
        publish(next(stamps))
        return condition()

    graph.until(tick, what)


def test_dead_reckoning_follows_the_imu(graph: ControlGraph, robot: RobotParameters) -> None:
    heard = listen(graph)
    servos = ServoArrays(robot)
    states = graph.node.create_publisher(ServoStates, "mouse/servo_states", qos.SENSOR)
    imus = graph.node.create_publisher(Imu, "mouse/imu/data_raw", qos.SENSOR)
    graph.start("mouse", "state_publisher", use_truth=False)
    neutral = [servo.neutral for servo in robot.servos.values()]
    yaw = 0.3

    def publish(stamp: int) -> None:
        imu = Imu(header=header(stamp))
        imu.orientation.w, imu.orientation.z = math.cos(yaw / 2), math.sin(yaw / 2)
        imus.publish(imu)
        states.publish(ServoStates(header=header(stamp), name=servos.names, position=neutral))

    ticks(graph, publish, lambda: len(heard) > 10, "odom comes")
    first = odometry_from_message(heard[-1])
    yaw = 0.8
    ticks(
        graph,
        publish,
        lambda: odometry_from_message(heard[-1]).yaw == pytest.approx(first.yaw + 0.5),
        "the mouse turns",
    )
    assert first.stamp % PERIOD == 0
    assert math.hypot(first.x, first.y) < 0.05
    assert (heard[-1].header.frame_id, heard[-1].child_frame_id) == ("odom", "base_link")


def test_truth_is_passed_on_with_its_stamp_and_what_is_not_finite_is_not(graph: ControlGraph) -> None:
    heard = listen(graph)
    transforms: list[TFMessage] = []
    graph.node.create_subscription(TFMessage, "/tf", transforms.append, qos.TRANSFORM)
    truths = graph.node.create_publisher(Odometry, "mouse/truth/odom", qos.SENSOR)
    graph.start("mouse", "state_publisher", frame_prefix="mouse/")

    def publish(stamp: int) -> None:
        truth = Odometry(header=header(stamp))
        pose = truth.pose.pose
        pose.position.x, pose.position.z = (math.nan if stamp // PERIOD % 2 else 1.5), 0.06
        pose.orientation.w, pose.orientation.y = math.cos(0.1), math.sin(0.1)
        truths.publish(truth)

    ticks(graph, publish, lambda: len(heard) > 10 and len(transforms) > 2, "odom and transforms come")
    assert all(message.pose.pose.position.x == 1.5 for message in heard)
    assert all(to_nanoseconds(message.header.stamp) // PERIOD % 2 == 0 for message in heard)
    footprint, base = transforms[-1].transforms
    assert (footprint.header.frame_id, footprint.child_frame_id) == ("mouse/odom", "mouse/base_footprint")
    assert (footprint.transform.translation.x, footprint.transform.translation.z) == (1.5, 0.0)
    assert (footprint.transform.rotation.w, footprint.transform.rotation.y) == (1.0, 0.0)
    assert (base.header.frame_id, base.child_frame_id) == ("mouse/base_footprint", "mouse/base_link")
    assert base.transform.translation.z == 0.06
    assert base.transform.rotation.y == pytest.approx(math.sin(0.1))
