"""Node `conductor`: plays a protocol's segment into the graph that was brought up for it."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry as OdometryMessage
from rclpy.executors import Executor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import Bool

from nermo_bringup.nodes.outlet import SERVO_PERIOD_S, Outlet
from nermo_bringup.nodes.present import others
from nermo_control.driver import Driver, Limits
from nermo_control.nodes.conversions import odometry_from_message
from nermo_control.nodes.operator import Operator
from nermo_control.types import Odometry, Posture
from nermo_interfaces.msg import ServoCommand
from nermo_node import qos
from nermo_node.complaints import Complaints
from nermo_node.emergency_stop_input import TOPIC
from nermo_node.graph_clock import USE_SIM_TIME
from nermo_node.inputs import Inputs
from nermo_node.run import EventsExecutor
from nermo_node.time import to_nanoseconds

LONGEST_S = 0.02
"""So long a tick is waited for; a stepped twin may wait too."""
EARLY_S = 2e-4
"""A tick may come so much early, so that those of a clock with the same period are not passed over."""


class ConductorNode(Node):
    """The clock, the outlet, who asks for the servos' release, and what an emulated mouse tells; its owner spins it."""

    def __init__(self, namespace: str, sim_time: bool, executor: Executor) -> None:
        given = [Parameter(USE_SIM_TIME, value=sim_time)]
        super().__init__("conductor", namespace=namespace, parameter_overrides=given)
        self._executor = executor
        self._driver = Driver(Limits())
        refused = Complaints(self, "refused")
        self._operator = Operator(self, self._driver, refused.add_one)
        self.outlet = Outlet(self, of_servos=True)
        self.commanded = 0
        """Stamp [ns] of what the servos were told last."""
        self.stopped = False
        """Whether somebody has said emergency stop since this node began."""
        self.truth: Odometry | None = None
        """Where an emulated mouse was last, once `see_truth` was asked for; None of one that nobody sees."""
        self.skipped = 0.0
        """[s] that an emulated device has left out so far, as it says once a second: its machine was too slow."""
        self.create_subscription(Bool, TOPIC, self._on_stop, qos.STATE)
        self.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)
        self._inputs = Inputs(self, refused.add_one)
        self._inputs.subscribe(ServoCommand, "servo_command", self._on_servo_command, qos.BEST_EFFORT)

    def see_truth(self) -> None:
        """Take where an emulated mouse is, from now on: a message in each tick, which only who steers it needs."""
        self._inputs.subscribe(OdometryMessage, "truth/odom", self._on_truth, qos.BEST_EFFORT)

    def _on_stop(self, message: Bool) -> None:
        self.stopped |= message.data

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        said = (pair.value for status in message.status for pair in status.values if pair.key == "skipped_s")
        for value in said:
            with suppress(ValueError):
                if math.isfinite(skipped := float(value)):
                    self.skipped = max(self.skipped, skipped)

    def _on_servo_command(self, message: ServoCommand) -> None:
        self.commanded = to_nanoseconds(message.header.stamp)

    def _on_truth(self, message: OdometryMessage) -> None:
        self.truth = odometry_from_message(message)

    @property
    def now(self) -> int:
        """[ns] of the graph's clock; 0 also while it has not begun."""
        return int(self.get_clock().now().nanoseconds)

    def release(self) -> None:
        """Asks that the servos may have power: somebody wants the mouse to stand."""
        self._driver.take(Posture.STAND)

    def present(self) -> set[str]:
        """Full names of the other nodes in the graph."""
        return others(self)

    def serve(self, seconds: float) -> None:
        """Serves the node for so long [s] at most."""
        self._executor.spin_once(timeout_sec=seconds)

    def next_tick(self, last: int) -> int:
        """Serves the node until there is another control tick than `last` [ns], at most for `LONGEST_S`; now [ns]."""
        until = time.monotonic() + LONGEST_S
        while (left := SERVO_PERIOD_S - EARLY_S - (self.now - last) * 1e-9) > 0.0 and time.monotonic() < until:
            self._executor.spin_once(timeout_sec=min(left, SERVO_PERIOD_S))
        self._operator.send(None)
        return self.now


@contextmanager
def in_graph(namespace: str, sim_time: bool) -> Iterator[ConductorNode]:
    """The node, while the block runs; signals are left to whoever runs it."""
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    executor = EventsExecutor()
    node = ConductorNode(namespace, sim_time, executor)
    executor.add_node(node)
    try:
        yield node
    finally:
        executor.shutdown()
        node.destroy_node()
        rclpy.try_shutdown()
