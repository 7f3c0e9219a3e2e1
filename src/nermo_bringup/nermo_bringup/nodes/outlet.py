"""What players put into the graph: what the operator would say, and where the servos are to be meanwhile."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from rclpy.node import Node

from nermo_control.nodes.conversions import control_command_to_message
from nermo_control.types import ControlCommand
from nermo_interfaces.msg import ControlCommand as ControlCommandMessage
from nermo_interfaces.msg import ServoCommand
from nermo_node import qos
from nermo_node.time import to_message

CONTROL_PERIOD_S = 0.05
SERVO_PERIOD_S = 0.005
"""The motion module tells the servos as often."""
_PERIOD_NS = CONTROL_PERIOD_S * 1e9


class Outlet:
    """Publishes `control_command`, and `servo_targets` where there are any."""

    def __init__(self, node: Node, of_servos: bool) -> None:
        self._controls = node.create_publisher(ControlCommandMessage, "control_command", qos.COMMAND)
        self._targets = node.create_publisher(ServoCommand, "servo_targets", qos.COMMAND) if of_servos else None
        self._said: ControlCommand | None = None

    @property
    def unheard(self) -> str | None:
        """Name of a topic to which nobody listens; None where everything is heard."""
        publishers = [p for p in (self._controls, self._targets) if p is not None]
        return next((p.topic_name for p in publishers if p.get_subscription_count() == 0), None)

    def send(self, command: ControlCommand, servos: Mapping[str, float] | None, every_tick: bool = False) -> None:
        """What holds now; called at every tick.

        The command goes out when it is another one and at 20 Hz, positions [rad] by servo always. Their stamp is the
        command's. every_tick: the command always too.
        """
        if servos is not None and self._targets is not None:
            message = ServoCommand(name=list(servos), position=list(servos.values()))
            message.header.stamp = to_message(command.stamp)
            self._targets.publish(message)
        said = self._said
        # Time that runs backwards is another clock's, and nothing has been said by that one.
        if said is None or every_tick or _other(command, said) or not 0 <= command.stamp - said.stamp < _PERIOD_NS:
            self._controls.publish(control_command_to_message(command))
            self._said = command


def _other(command: ControlCommand, said: ControlCommand) -> bool:
    return replace(command, stamp=0) != replace(said, stamp=0)
