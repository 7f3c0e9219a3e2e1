"""The node in a graph with a twin: it sees that robot and twin agree, and the leg in which they do not."""

from __future__ import annotations

import math
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import Imu

from nermo_description.robots import load_robot
from nermo_interfaces.msg import ServoCommand, ServoStates
from nermo_node import qos
from nermo_node.time import to_message
from nermo_sim.twin import Twin

PATIENCE = 60.0


class Robot:
    """A robot of its own: sends commands and what it measures, hears what the monitor says."""

    def __init__(self, robot: str) -> None:
        self._context = Context()
        rclpy.init(context=self._context)
        self.node = Node("robot", context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._twin = Twin(load_robot(robot))
        self._servos = list(load_robot(robot).servos)
        self._neutral = [s.neutral for s in load_robot(robot).servos.values()]
        self._commands = self.node.create_publisher(ServoCommand, "servo_command", 200)
        self._states = self.node.create_publisher(ServoStates, "servo_states", qos.SENSOR)
        self._imu = self.node.create_publisher(Imu, "imu/data_raw", qos.SENSOR)
        self.diagnostics: list[DiagnosticArray] = []
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self.diagnostics.append, 100)
        self._tick = 0

    def step(self) -> None:
        """One tick."""
        stamp = to_message(self._twin.time_ns)
        told = [n + 0.15 * math.sin(0.03 * self._tick) for n in self._neutral]
        command = ServoCommand(name=self._servos, position=told)
        command.header.stamp = stamp
        self._commands.publish(command)
        sensors = self._twin.step(told)
        self._tick += 1
        states = ServoStates(name=self._servos, position=sensors.servo_positions)
        imu = Imu()
        states.header.stamp = imu.header.stamp = to_message(sensors.stamp)
        imu.angular_velocity.x, imu.angular_velocity.y, imu.angular_velocity.z = sensors.angular_velocity
        self._states.publish(states)
        self._imu.publish(imu)
        self._executor.spin_once(timeout_sec=0.004)

    def status(self) -> dict[str, Any]:
        """The newest of what the monitor says; empty before the first."""
        for array in reversed(self.diagnostics):
            for status in array.status:
                if status.name == "gap_monitor: gap":
                    return {"message": status.message, **{v.key: v.value for v in status.values}}
        return {}

    def walk_until(self, condition: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
        """Goes on until the monitor says what is waited for."""
        deadline = time.monotonic() + PATIENCE
        while self._commands.get_subscription_count() == 0 or self._states.get_subscription_count() == 0:
            assert time.monotonic() < deadline, "nobody listens"
            self._executor.spin_once(timeout_sec=0.02)
        while not condition(self.status()):
            assert time.monotonic() < deadline, f"waited in vain; the last was {self.status()}"
            self.step()
        return self.status()

    def close(self) -> None:
        self._executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self._context)


@pytest.fixture
def weak(tmp_path: Path) -> Path:
    """A parameter file of a mouse with a weak servo."""
    path = tmp_path / "weak.yaml"
    path.write_text(
        "name: weak\nbase: nermo_lite\n"
        "deviations: [{effect: servo_gain, sites: [rear_left_knee], values: {factor: 0.2}}]\n",
        encoding="utf-8",
    )
    return path


@pytest.fixture
def monitor() -> Iterator[subprocess.Popen[str]]:
    process = subprocess.Popen([sys.executable, "-m", "nermo_gap.nodes.gap_monitor"], text=True)
    yield process
    process.terminate()
    assert process.wait(timeout=PATIENCE) == 0


@pytest.mark.usefixtures("monitor")
def test_the_monitor_names_the_leg_in_which_the_robot_differs(weak: Path) -> None:
    own = Robot("nermo_lite")
    try:
        status = own.walk_until(lambda s: "agree" in s.get("message", ""))
        assert float(status["front_left_leg_gap"]) < 3.0 and "body_gap" in status
    finally:
        own.close()
    # The other robot begins at stamp 0 again, as after a restart of the graph.
    other = Robot(str(weak))
    try:
        other.walk_until(lambda s: "rear_left leg" in s.get("message", ""))
    finally:
        other.close()
