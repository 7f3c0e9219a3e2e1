"""Once a second on /diagnostics: how the node is doing."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

OK = DiagnosticStatus.OK
WARN = DiagnosticStatus.WARN
ERROR = DiagnosticStatus.ERROR
STALE = DiagnosticStatus.STALE

Status = tuple[bytes, str, Mapping[str, object]]
"""Level (OK, WARN, ERROR, STALE), a sentence, and values by name with their unit in the name."""


class Ticks:
    """Counts the ticks of a control node, and how many came since its diagnostics last told."""

    def __init__(self) -> None:
        self.total = self._told = 0

    def count(self) -> None:
        """One more."""
        self.total += 1

    def since_told(self) -> int:
        """Ticks since this was last asked, about a second ago."""
        ticks, self._told = self.total - self._told, self.total
        return ticks


class Diagnostics:
    """Publishes the status that each function of `parts` gives, by the name of the part it speaks of.

    Goes by the machine's clock, so that a paused simulation is still diagnosed; the stamp is ROS time.
    """

    def __init__(self, node: Node, hardware_id: str, parts: Mapping[str, Callable[[], Status]]) -> None:
        self._node, self._hardware_id, self._parts = node, hardware_id, dict(parts)
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", 10)
        node.create_timer(1.0, self.publish, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def publish(self) -> None:
        """Publishes now."""
        message = DiagnosticArray()
        message.header.stamp = self._node.get_clock().now().to_msg()
        node = self._node.get_fully_qualified_name().lstrip("/")
        for part, status in self._parts.items():
            level, sentence, values = status()
            pairs = [KeyValue(key=key, value=str(value)) for key, value in values.items()]
            message.status.append(
                DiagnosticStatus(
                    level=level, name=f"{node}: {part}", message=sentence, hardware_id=self._hardware_id, values=pairs
                )
            )
        self._publisher.publish(message)
