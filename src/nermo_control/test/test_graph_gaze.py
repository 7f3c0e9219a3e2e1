"""The neck by the IMU, over topics: the same as in one process."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator

import pytest
from control_graph import LOCKSTEP_NODES, NODES, PERIOD, REPEAT_AFTER_S, ControlGraph, GraphRobot
from graph_bench import PATIENCE_S
from sensor_msgs.msg import Imu as ImuMessage

from nermo_control.controller import LOCKSTEP_MOTION, Controller
from nermo_control.gait.knowledge_base import GaitParameters
from nermo_control.nodes import conversions
from nermo_control.types import ControlCommand, Imu, Odometry
from nermo_description.robots import load_robot
from nermo_node import qos

TICKS = 500


@pytest.fixture
def graph() -> Iterator[ControlGraph]:
    graph = ControlGraph()
    yield graph
    graph.close()


def test_in_lockstep_the_neck_gets_the_imu_of_its_tick(graph: ControlGraph) -> None:
    robot = load_robot("nermo")
    mouse = GraphRobot(graph, "gaze", robot)
    publisher = graph.node.create_publisher(ImuMessage, "gaze/imu/data_raw", qos.SENSOR)
    for name in NODES:
        own = {"gaze": "imu"} if name == "motion_module" else {}
        robot_choice = {} if name == "trajectory_generator" else {"robot": "nermo"}
        graph.start("gaze", name, **robot_choice, **own, **({"lockstep": True} if name in LOCKSTEP_NODES else {}))
    motion = LOCKSTEP_MOTION.model_copy(update={"gaze": "imu"})
    controller = Controller(robot, GaitParameters(), PERIOD, motion=motion)
    tilt, moved = list(robot.servos).index("head_tilt"), 0.0
    for tick in range(TICKS):
        mouse.stamp += PERIOD
        half = 0.5 * 0.1 * math.sin(0.02 * tick)
        imu = Imu(mouse.stamp, (math.cos(half), 0.0, math.sin(half), 0.0), (0.0, 0.3, 0.1))
        message = ImuMessage(header=conversions.header(mouse.stamp))
        message.orientation.w, message.orientation.y = imu.orientation[0], imu.orientation[2]
        message.angular_velocity.y, message.angular_velocity.z = 0.3, 0.1
        command, odometry = ControlCommand(mouse.stamp, 0.05), Odometry(mouse.stamp, 0.0, 0.0, 0.0)
        expected = controller.step(mouse.stamp, command, odometry, mouse.servos, imu)
        deadline = time.monotonic() + PATIENCE_S
        while not mouse.answered():
            mouse.send(command)
            publisher.publish(message)
            mouse.publish(odometry)
            repeat = time.monotonic() + REPEAT_AFTER_S
            while not mouse.answered() and time.monotonic() < repeat:
                graph.spin_once(0.05)
            assert time.monotonic() < deadline, f"no servo command for tick {tick}"
        assert mouse.servos == pytest.approx(expected.servo_positions, abs=1e-9)
        moved = max(moved, abs(mouse.servos[tilt]))
    assert moved > 0.05
