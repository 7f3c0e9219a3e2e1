"""Node `joystick`: a gamepad as sensor_msgs/Joy, for machines without ROS's own joy package."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node
from sensor_msgs.msg import Joy

from nermo_bringup.teleop.joystick import JoyState, PadReader
from nermo_node import run
from nermo_node.parameters import declare

POLL_PERIOD_S = 0.005


class JoystickParameters(BaseModel):
    """Parameters of the joystick, named as those of ROS's joy_node."""

    model_config = ConfigDict(frozen=True)

    device_name: str = Field("", description="name of the pad to read; empty: the first there is")
    deadzone: float = Field(0.05, ge=0.0, le=0.9, description="share of a stick's way around its centre that is 0")
    autorepeat_rate: float = Field(
        20.0, ge=1.0, le=100.0, description="at which an unchanged state is repeated", json_schema_extra={"unit": "Hz"}
    )


class Joystick(Node):
    """Publishes `joy` at every change and at the autorepeat rate, while a pad is plugged in."""

    _reader: PadReader | None = None

    def __init__(self) -> None:
        super().__init__("joystick")
        parameters = declare(self, JoystickParameters)
        self._reader = PadReader(parameters.device_name, parameters.deadzone)
        self._publisher = self.create_publisher(Joy, "joy", 10)
        self._state: JoyState | None = None
        self._pad = ""
        self._repeat_polls = max(1, round(1.0 / (parameters.autorepeat_rate * POLL_PERIOD_S)))
        self._polls = 0
        # A person's hand does not stop with the simulation's clock.
        self.create_timer(POLL_PERIOD_S, self._poll, clock=Clock(clock_type=ClockType.STEADY_TIME))
        if not self._reader.names:
            self.get_logger().warning("no pad found; waiting for one to be plugged in")

    def destroy_node(self) -> None:
        """Let the pad go."""
        if self._reader is not None:
            self._reader.close()
        super().destroy_node()

    def _poll(self) -> None:
        assert self._reader is not None
        state = self._reader.read()
        if self._reader.name != self._pad:
            self._pad = self._reader.name
            self.get_logger().info(f"reading {self._pad}" if self._pad else "the pad was unplugged")
        self._polls += 1
        if state is not None and (state != self._state or self._polls >= self._repeat_polls):
            message = Joy(axes=list(state.axes), buttons=list(state.buttons))
            message.header.stamp = self.get_clock().now().to_msg()
            message.header.frame_id = "joy"
            self._publisher.publish(message)
            self._polls = 0
        self._state = state


def main() -> int:
    """Run the joystick."""
    return run(Joystick)
