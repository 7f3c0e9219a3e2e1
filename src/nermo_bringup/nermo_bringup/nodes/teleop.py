"""Node `teleop`: gamepad messages in, control commands out."""

from __future__ import annotations

import time

from pydantic import ConfigDict, Field
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node
from sensor_msgs.msg import Joy

from nermo_bringup.teleop.mapping import PadMapping
from nermo_bringup.teleop.pads import load_pad
from nermo_control.driver import Driver, Limits
from nermo_control.nodes.operator import Operator
from nermo_description.silence import STICK
from nermo_node import run
from nermo_node.complaints import Complaints
from nermo_node.diagnostics import Diagnostics
from nermo_node.inputs import Inputs
from nermo_node.parameters import declare

COMMAND_PERIOD_S = 0.05


class TeleopParameters(Limits):
    """Parameters of teleop."""

    model_config = ConfigDict(frozen=True)

    pad: str = Field("xbox", description="name of a pad in config/pads, or the path of its YAML")
    joy_timeout: float = Field(
        STICK.after, ge=0.05, le=2.0, description="without joy until the mouse stops", json_schema_extra={"unit": "s"}
    )


class Teleop(Node):
    """Publishes `control_command` at 20 Hz while the dead-man button is held, and `emergency_stop` when it changes."""

    def __init__(self) -> None:
        super().__init__("teleop")
        parameters = declare(self, TeleopParameters)
        self._driver = Driver(parameters)
        self._mapping = PadMapping(load_pad(parameters.pad), self._driver, parameters.joy_timeout)
        refused = Complaints(self, "refused")
        self._operator = Operator(self, self._driver, refused.add_one)
        self._shown = ""
        Inputs(self, refused.add_one).subscribe(Joy, "joy", self._joy, 10)
        Diagnostics(self, parameters.pad, {"messages": refused.status})
        # A person lets go in real time, whatever the simulation's clock does.
        self.create_timer(COMMAND_PERIOD_S, self._tick, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _joy(self, message: Joy) -> None:
        self._mapping.receive(time.monotonic(), message.axes, message.buttons)
        if self._mapping.fault:
            self.get_logger().warning(self._mapping.fault, throttle_duration_sec=5.0)
        if self._operator.stop_is_news:
            # Not at the next tick: now.
            self._tick()

    def _tick(self) -> None:
        self._operator.send(self._mapping.command(time.monotonic(), self._operator.stamp()))
        if str(self._driver) != self._shown:
            self._shown = str(self._driver)
            self.get_logger().info(self._shown)


def main() -> int:
    """Run teleop."""
    return run(Teleop)
