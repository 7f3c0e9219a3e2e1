"""Node `drive`: what `nermo drive` tells and hears of the graph that it has brought up."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from nav_msgs.msg import Odometry as OdometryMessage
from rclpy.executors import Executor as Executor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from nermo_bringup.drive.odometer import Odometer
from nermo_bringup.nodes.present import others
from nermo_control.driver import Driver
from nermo_control.nodes.conversions import odometry_from_message
from nermo_control.nodes.operator import Operator
from nermo_interfaces.msg import ControlCommand, ServoCommand
from nermo_node import qos
from nermo_node.complaints import Complaints
from nermo_node.inputs import Inputs
from nermo_node.run import EventsExecutor

FRESH_S = 0.5
"""A command that is older commands no more."""
FALLEN_RAD = math.radians(60.0)
"""A body that is tilted by more does not stand on its feet."""
TROUBLE_S = 3.0
"""So long a warning is shown."""


@contextmanager
def in_graph(driver: Driver, namespace: str) -> Iterator[tuple[Drive, Executor]]:
    """The node and the executor that spins it, while the block runs; signals are left to whoever runs it."""
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    node = Drive(driver, namespace)
    executor = EventsExecutor()
    executor.add_node(node)
    try:
        yield node, executor
    finally:
        executor.shutdown()
        node.destroy_node()
        rclpy.try_shutdown()


class Drive(Node):
    """Holds what there is to know; whoever owns it spins it and calls `operator.send`."""

    def __init__(self, driver: Driver, namespace: str) -> None:
        super().__init__("drive", namespace=namespace)
        self._driver = driver
        self.odometer = Odometer()
        refuse = Complaints(self, "refused").add_one
        self.operator = Operator(self, driver, refuse, lambda: self.time_ns)
        self.time_ns = 0
        """Of the twin; 0 until it has begun."""
        self.fallen = False
        self.servos = "not heard of yet"
        self.real_time_factor = "-"
        self._walks = False
        self._command: ControlCommand | None = None
        self._heard_at = 0.0
        self._trouble: dict[str, tuple[float, str]] = {}
        self._first_answer = self.create_subscription(ServoCommand, "servo_command", self._on_answer, qos.BEST_EFFORT)
        inputs = Inputs(self, refuse)
        inputs.subscribe(OdometryMessage, "truth/odom", self._on_odometry, qos.BEST_EFFORT)
        inputs.subscribe(ControlCommand, "control_command", self._on_command, qos.COMMAND)
        self.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 50)

    def alive(self, needs_gaits: bool) -> bool:
        """Whether the whole way from command to servo and back has spoken."""
        return self._walks and self.time_ns > 0 and (bool(self._driver.gaits) or not needs_gaits)

    def present(self) -> set[str]:
        """Full names of the other nodes in the graph."""
        return others(self)

    @property
    def commanded(self) -> tuple[float, float]:
        """Forward velocity [m/s] and turn rate [rad/s] of the command that holds, whoever gave it."""
        if self._command is None or time.monotonic() - self._heard_at > FRESH_S:
            return 0.0, 0.0
        return self._command.forward_velocity, self._command.turn_rate

    @property
    def trouble(self) -> list[str]:
        """What nodes have warned of lately, newest last."""
        now = time.monotonic()
        return [text for at, text in sorted(self._trouble.values()) if now - at < TROUBLE_S]

    def _on_answer(self, message: ServoCommand) -> None:
        self._walks = True
        self.destroy_subscription(self._first_answer)

    def _on_odometry(self, message: OdometryMessage) -> None:
        odometry = odometry_from_message(message)
        self.time_ns = odometry.stamp
        attitude = message.pose.pose.orientation
        self.fallen = 1.0 - 2.0 * (attitude.x**2 + attitude.y**2) < math.cos(FALLEN_RAD)
        told = any(self.commanded)
        self.odometer.add(odometry.stamp * 1e-9, odometry.x, odometry.y, odometry.yaw, told)

    def _on_command(self, message: ControlCommand) -> None:
        self._command, self._heard_at = message, time.monotonic()

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            node = status.name.partition(":")[0].rpartition("/")[2]
            if status.level in (DiagnosticStatus.WARN, DiagnosticStatus.ERROR):
                self._trouble[status.name] = time.monotonic(), f"{node}: {status.message}"
            if status.name.endswith("mujoco_sim: twin"):
                self._on_twin(status.message, {pair.key: pair.value for pair in status.values})

    def _on_twin(self, message: str, values: Mapping[str, str]) -> None:
        self.servos = message if message.startswith("limp") else values.get("servos", message)
        self.real_time_factor = f"{float(values.get('real_time_factor', 'nan')):.2f}"
