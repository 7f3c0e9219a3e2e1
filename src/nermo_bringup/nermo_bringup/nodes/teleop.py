"""Node `teleop`: gamepad messages in, control commands out."""

from __future__ import annotations

import time

from pydantic import ConfigDict, Field
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node
from sensor_msgs.msg import Joy
from std_msgs.msg import Bool

from nermo_bringup.teleop.driver import Driver, Limits
from nermo_bringup.teleop.mapping import JOY_TIMEOUT_S, PadMapping
from nermo_bringup.teleop.pads import load_pad
from nermo_control.nodes.conversions import control_command_to_message
from nermo_interfaces.msg import ControlCommand, GaitParameters
from nermo_node import qos, run
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
        JOY_TIMEOUT_S, ge=0.05, le=2.0, description="without joy until the mouse stops", json_schema_extra={"unit": "s"}
    )


class Teleop(Node):
    """Publishes `control_command` at 20 Hz while the dead-man button is held, and `emergency_stop` when it changes."""

    def __init__(self) -> None:
        super().__init__("teleop")
        parameters = declare(self, TeleopParameters)
        self._driver = Driver(parameters)
        self._mapping = PadMapping(load_pad(parameters.pad), self._driver, parameters.joy_timeout)
        self._commands = self.create_publisher(ControlCommand, "control_command", qos.COMMAND)
        self._stop = self.create_publisher(Bool, "emergency_stop", qos.LATCHED)
        self._stop_sent = False
        self._shown = ""
        refused = Complaints(self, "refused")
        inputs = Inputs(self, refused.add_one)
        inputs.subscribe(Joy, "joy", self._joy, 10)
        inputs.subscribe(GaitParameters, "gait_parameters", self._gaits, qos.LATCHED)
        Diagnostics(self, parameters.pad, {"messages": refused.status})
        # A person lets go in real time, whatever the simulation's clock does.
        self.create_timer(COMMAND_PERIOD_S, self._tick, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _joy(self, message: Joy) -> None:
        self._mapping.receive(time.monotonic(), message.axes, message.buttons)
        if self._mapping.fault:
            self.get_logger().warning(self._mapping.fault, throttle_duration_sec=5.0)
        if self._driver.stopped != self._stop_sent:
            # Not at the next tick: now.
            self._tick()

    def _gaits(self, message: GaitParameters) -> None:
        self._driver.gaits = [gait.name for gait in message.gaits]
        self._driver.default_frequency = message.default_gait_frequency

    def _tick(self) -> None:
        if self._driver.stopped != self._stop_sent:
            self._stop_sent = self._driver.stopped
            self._stop.publish(Bool(data=self._stop_sent))
        command = self._mapping.command(time.monotonic(), self.get_clock().now().nanoseconds)
        if command is not None:
            self._commands.publish(control_command_to_message(command))
        if str(self._driver) != self._shown:
            self._shown = str(self._driver)
            self.get_logger().info(self._shown)


def main() -> int:
    """Run teleop."""
    return run(Teleop)
