"""What a node through which somebody drives tells the graph, and what it must know of it."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from rclpy.node import Node
from rclpy.task import Future
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from nermo_control.driver import Driver
from nermo_control.nodes.conversions import control_command_to_message
from nermo_control.types import ControlCommand
from nermo_interfaces.msg import ControlCommand as ControlCommandMessage
from nermo_interfaces.msg import GaitParameters
from nermo_node import qos
from nermo_node.emergency_stop_input import TOPIC
from nermo_node.graph_clock import GraphClock
from nermo_node.inputs import Inputs

RELEASE_ATTEMPTS = 40
"""A release may come before the end of the stop that it is for, by another way."""
ANSWER_S = 2.0
"""An answer that takes longer is taken for lost, and the release is asked for again."""


class Operator:
    """Publishes `control_command` and, when it changes, `emergency_stop`; asks for the release that standing means.

    `send` is to be called at a steady rate. `refuse` gets a sentence for every message that cannot be used. `stamp`
    gives the stamp [ns] of a command of now; None: as `GraphClock`.
    """

    def __init__(
        self, node: Node, driver: Driver, refuse: Callable[[str], None], stamp: Callable[[], int] | None = None
    ) -> None:
        self._node, self._driver = node, driver
        self.stamp = stamp or GraphClock(node).stamp
        self._commands = node.create_publisher(ControlCommandMessage, "control_command", qos.COMMAND)
        self._stop = node.create_publisher(Bool, TOPIC, qos.LATCHED)
        self._release = node.create_client(Trigger, "release")
        self._stopped = self._said = False
        self._attempts = 0
        self._answer: Future | None = None
        self._asked = 0.0
        Inputs(node, refuse).subscribe(GaitParameters, "gait_parameters", self._on_gaits, qos.LATCHED)

    def send(self, command: ControlCommand | None) -> None:
        """Says whether this source stops the robot, and gives a command if there is one."""
        if self._driver.stopped != self._stopped:
            self._stopped, self._said = self._driver.stopped, True
            self._stop.publish(Bool(data=self._stopped))
        self._ask_for_release()
        if command is not None:
            self._commands.publish(control_command_to_message(command))

    def repeat_stop(self) -> None:
        """Says once more whether this source stops the robot, if it has ever said so: it is a state, not an event."""
        if self._said:
            self._stop.publish(Bool(data=self._stopped))

    @property
    def stop_is_news(self) -> bool:
        """Whether a stop, or its end, has not been sent yet: it does not wait for the next time."""
        return self._driver.stopped != self._stopped

    def _ask_for_release(self) -> None:
        if self._driver.release_wanted:
            self._driver.release_wanted = False
            self._attempts = RELEASE_ATTEMPTS
        if self._stopped:
            self._attempts = 0
        if self._attempts == 0 or not self._release.service_is_ready():
            return
        if self._answer is not None and time.monotonic() - self._asked > ANSWER_S:
            self._release.remove_pending_request(self._answer)
            self._answer = None
        if self._answer is None:
            self._attempts -= 1
            self._asked = time.monotonic()
            self._answer = self._release.call_async(Trigger.Request())
            self._answer.add_done_callback(self._on_answer)

    def _on_answer(self, answer: Any) -> None:
        if answer is self._answer:
            self._answer = None
        response = answer.result()
        if response.success:
            self._attempts = 0
        elif self._attempts == 0:
            self._node.get_logger().warning(f"no release: {response.message}")

    def _on_gaits(self, message: GaitParameters) -> None:
        self._driver.gaits = [gait.name for gait in message.gaits]
        self._driver.default_gait = message.default_gait
        self._driver.default_frequency = message.default_gait_frequency
