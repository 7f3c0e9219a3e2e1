"""Node `high_level_controller`: control_command [a] or cmd_vel, odom, path -> motion_command [b]."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from typing import Any

from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry as OdometryMessage
from nav_msgs.msg import Path as PathMessage
from rclpy.node import Node

from nermo_control.gait.knowledge_base import GaitParameters
from nermo_control.high_level_controller import HighLevelController, HighLevelControllerConfig
from nermo_control.nodes import conversions
from nermo_control.nodes.conversions import UnusableMessageError
from nermo_control.nodes.gait_parameters import GaitParametersInput
from nermo_control.nodes.robot import RobotChoice
from nermo_control.types import ControlCommand, Odometry
from nermo_interfaces import msg
from nermo_node import qos, run
from nermo_node.command_input import CommandInput
from nermo_node.complaints import Complaints
from nermo_node.diagnostics import OK, WARN, Diagnostics, Status
from nermo_node.inputs import Inputs
from nermo_node.parameters import declare
from nermo_node.synchronizer import TickSynchronizer


class HighLevelControllerParameters(HighLevelControllerConfig, RobotChoice):
    """Parameters of the node."""


class HighLevelControllerNode(Node):
    """Ticks with each odometry, on the newest command; in lockstep once the command of the same tick is there."""

    def __init__(self) -> None:
        super().__init__("high_level_controller")
        parameters = declare(self, HighLevelControllerParameters, self._on_parameters)
        self._config: HighLevelControllerConfig = parameters
        self._robot = parameters.load()
        self._controller: HighLevelController | None = None
        self._command: ControlCommand | None = None
        self._stamp: int | None = None
        self._refused = Complaints(self, "refused")
        self._clipped = Complaints(self, "clipped")
        self._tick = TickSynchronizer(("odometry", "command"), self._on_tick)
        self._lockstep = parameters.lockstep

        self._motion_commands = self.create_publisher(msg.MotionCommand, "motion_command", qos.COMMAND)
        GaitParametersInput(self, self._refused, self._on_gait_parameters)
        self._commands = CommandInput(
            self,
            self._refused.add_one,
            self._time,
            oldest=None if parameters.lockstep else parameters.command_timeout,
        )
        self._commands.subscribe(msg.ControlCommand, "control_command", self._on_control_command)
        self._commands.subscribe(TwistStamped, "cmd_vel", self._on_cmd_vel)
        inputs = Inputs(self, self._refused.add_one)
        inputs.subscribe(OdometryMessage, "odom", self._on_odometry, qos.sensor_input(parameters.lockstep))
        inputs.subscribe(PathMessage, "path", self._on_path, qos.COMMAND)
        Diagnostics(
            self,
            self._robot.name,
            {
                "state": self._state,
                "owner": self._commands.status,
                "messages": self._refused.status,
                "commands": self._clipped.status,
            },
        )

    # Parameters

    def _on_parameters(self, parameters: HighLevelControllerParameters) -> None:
        self._config = parameters
        if self._controller is not None:
            self._controller.set_config(parameters)

    def _on_gait_parameters(self, parameters: GaitParameters) -> None:
        if self._controller is None:
            self._controller = HighLevelController(self._robot, parameters, self._config)
        else:
            self._controller.set_parameters(parameters)

    # Inputs

    def _time(self) -> int:
        """The time of the last tick [ns], which commands are compared with; before the first, the node's clock."""
        return int(self.get_clock().now().nanoseconds) if self._stamp is None else self._stamp

    def _on_control_command(self, message: msg.ControlCommand) -> None:
        self._take(conversions.control_command_from_message(message))

    def _on_cmd_vel(self, message: TwistStamped) -> None:
        self._take(conversions.control_command_from_twist(message))

    def _take(self, command: ControlCommand) -> None:
        self._command = command
        if self._lockstep:
            self._tick.add("command", command.stamp, command)

    def _on_odometry(self, message: OdometryMessage) -> None:
        odometry = conversions.odometry_from_message(message)
        self._stamp = odometry.stamp
        if self._lockstep:
            self._tick.add("odometry", odometry.stamp, odometry)
        else:
            self._step(odometry.stamp, self._command, odometry)

    def _on_path(self, message: PathMessage) -> None:
        """A path to follow in the trajectory mode PATH; an empty one takes it away."""
        if self._controller is None:
            raise UnusableMessageError("there are no gait_parameters yet")
        self._controller.follow(conversions.path_from_message(message, self._config.path_corner_radius))

    # The tick

    def _on_tick(self, stamp: int, inputs: Mapping[str, Any]) -> None:
        self._step(stamp, inputs["command"], inputs["odometry"])

    def _step(self, stamp: int, command: ControlCommand | None, odometry: Odometry) -> None:
        if self._controller is None:
            return
        motion = self._controller.step(stamp, command, odometry)
        self._motion_commands.publish(conversions.motion_command_to_message(motion))
        self._clipped.add(self._controller.warnings)

    def _state(self) -> Status:
        if self._controller is None:
            return WARN, "waiting for gait_parameters", {}
        return OK, "running", {"path": str(self._controller.path_status)}


def main() -> int:
    """Runs the node."""
    return run(HighLevelControllerNode)


if __name__ == "__main__":
    sys.exit(main())
