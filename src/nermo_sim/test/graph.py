"""A test's own node in the graph, and the simulations that it started there."""

from __future__ import annotations

import subprocess
import sys
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from graph_bench import GraphBench
from rclpy.qos import QoSProfile

from nermo_interfaces.msg import ServoCommand, ServoStates


class Graph(GraphBench):
    """Starts simulations, hears their topics, calls their services."""

    def __init__(self) -> None:
        super().__init__("tester")
        self._commands: dict[str, Any] = {}
        self._diagnostics = self.hear(DiagnosticArray, "/diagnostics")

    def start(self, *arguments: str, **parameters: object) -> subprocess.Popen[str]:
        """Runs a simulation with ROS arguments and parameters."""
        for name, value in parameters.items():
            arguments += ("-p", f"{name}:={str(value).lower() if isinstance(value, bool) else value}")
        return self.begin([sys.executable, "-m", "nermo_sim.nodes.mujoco_sim", "--ros-args", *arguments])

    def hear(self, kind: type, topic: str) -> list[Any]:
        """A list that every message of a topic is appended to."""
        heard: list[Any] = []
        self.node.create_subscription(kind, topic, heard.append, QoSProfile(depth=1000))
        return heard

    def command(self, states: ServoStates, namespace: str = "", **changes: Any) -> None:
        """Sends a servo command that answers `states` and stays there, but for `changes` of its fields."""
        message = ServoCommand(name=states.name, position=states.position)
        message.header.stamp = states.header.stamp
        for name, value in changes.items():
            setattr(message, name, value)
        self.until(lambda: self.hears(namespace), "commands are heard")
        self._commands[namespace].publish(message)

    def hears(self, namespace: str = "") -> bool:
        """Whether servo commands are heard: what is answered before is old by then."""
        if namespace not in self._commands:
            self._commands[namespace] = self.node.create_publisher(ServoCommand, f"{namespace}/servo_command", 1)
        return bool(self._commands[namespace].get_subscription_count() > 0)

    def status(self, name: str = "mujoco_sim") -> dict[str, str]:
        """Newest diagnostics of a simulation, with its `level` and `message`; empty before the first."""
        if not (statuses := self.statuses(name)):
            return {}
        values = {pair.key: pair.value for pair in statuses[-1].values}
        return {**values, "level": str(statuses[-1].level[0]), "message": statuses[-1].message}

    def statuses(self, name: str) -> list[DiagnosticStatus]:
        """All diagnostics of a simulation; of each message the first."""
        found = [[each for each in array.status if each.name.startswith(f"{name}:")] for array in self._diagnostics]
        return [statuses[0] for statuses in found if statuses]
