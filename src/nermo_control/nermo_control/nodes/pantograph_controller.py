"""Node `pantograph_controller`: control_command [a], leg_loads, servo_states [d] -> servo_command [c], leg_states.

The whole controller of a robot with pantograph legs (C figure 3.4), in the place of a mouse's five nodes.
"""

from __future__ import annotations

import sys
from pathlib import Path

from pydantic import Field
from rclpy.node import Node

from nermo_control.nodes import conversions
from nermo_control.pantograph_motion import PantographMotion, PantographMotionConfig, SavedGait, read_saved_gait
from nermo_control.types import ControlCommand, LegLoads
from nermo_description.pantograph import PantographParameters
from nermo_description.robots import load_of_family
from nermo_interfaces import msg
from nermo_node import qos
from nermo_node.command_input import CommandInput
from nermo_node.complaints import Complaints
from nermo_node.diagnostics import OK, WARN, Diagnostics, Status, Ticks
from nermo_node.inputs import Inputs
from nermo_node.parameters import blame, declare
from nermo_node.run import run
from nermo_node.time import to_nanoseconds


class PantographControllerParameters(PantographMotionConfig):
    """Parameters of the node."""

    robot: str = Field(
        "cheetah_cub",
        description="Name of a robot with pantograph legs, or path of its parameter file",
        json_schema_extra={"readOnly": True},
    )
    gait_file: str = Field(
        "",
        description="YAML that nermo optimize --cost limit-cycle wrote; empty: the controller's own trot",
        json_schema_extra={"readOnly": True},
    )
    control_rate: float = Field(
        200.0,
        ge=20.0,
        le=1000.0,
        description="Rate of servo_states",
        json_schema_extra={"unit": "Hz", "readOnly": True},
    )
    lockstep: bool = Field(
        False,
        description="The robot waits for each answer, so every sample must arrive",
        json_schema_extra={"readOnly": True},
    )


class PantographControllerNode(Node):
    """Ticks with each servo_states, on the newest command and leg loads."""

    def __init__(self) -> None:
        super().__init__("pantograph_controller")
        parameters = declare(self, PantographControllerParameters)
        with blame("robot"):
            robot = load_of_family(PantographParameters, parameters.robot)
        with blame("gait_file"):
            saved = read_saved_gait(Path(parameters.gait_file)) if parameters.gait_file else SavedGait()
        self._servos = conversions.ServoArrays(robot)
        self._motion = PantographMotion(robot, saved, round(1e9 / parameters.control_rate), parameters)
        self._command: ControlCommand | None = None
        self._stamp: int | None = None
        self._loads: LegLoads | None = None
        self._ticks = Ticks()
        self._walking = False
        self._refused = Complaints(self, "refused")
        self._clamped = Complaints(self, "clamped")
        self._servo_commands = self.create_publisher(msg.ServoCommand, "servo_command", qos.COMMAND)
        self._leg_states = self.create_publisher(msg.LegStates, "leg_states", qos.EVENT)
        self._commands = CommandInput(
            self,
            self._refused.add_one,
            self._time,
            oldest=None if parameters.lockstep else parameters.silence_timeout,
        )
        self._commands.subscribe(msg.ControlCommand, "control_command", self._on_control_command)
        inputs = Inputs(self, self._refused.add_one)
        if parameters.coordination == "tegotae":
            inputs.subscribe(msg.LegLoads, "leg_loads", self._on_leg_loads, qos.BEST_EFFORT)
        inputs.subscribe(msg.ServoStates, "servo_states", self._on_servo_states, qos.sensor_input(parameters.lockstep))
        Diagnostics(
            self,
            robot.name,
            {
                "state": self._state,
                "owner": self._commands.status,
                "messages": self._refused.status,
                "limits": self._clamped.status,
            },
        )

    def _time(self) -> int:
        """The time of the last tick [ns], which commands are compared with; before the first, the node's clock."""
        return int(self.get_clock().now().nanoseconds) if self._stamp is None else self._stamp

    def _on_control_command(self, message: msg.ControlCommand) -> None:
        self._command = conversions.control_command_from_message(message)

    def _on_leg_loads(self, message: msg.LegLoads) -> None:
        self._loads = conversions.leg_loads_from_message(message)

    def _on_servo_states(self, message: msg.ServoStates) -> None:
        positions = self._servos.positions(message)
        self._stamp = stamp = to_nanoseconds(message.header.stamp)
        output = self._motion.step(stamp, self._command, positions, self._loads)
        self._servo_commands.publish(self._servos.command(stamp, output.servo_positions))
        self._leg_states.publish(conversions.leg_states_to_message(output.leg_states))
        self._clamped.add(output.warnings)
        self._walking = output.leg_states.gait_frequency > 0.0
        self._ticks.count()

    def _state(self) -> Status:
        ticks = self._ticks.since_told()
        values = {"ticks": self._ticks.total, "ticks_in_last_second": ticks}
        if ticks == 0:
            return WARN, "no servo_states", values
        return OK, "walking" if self._walking else "standing", values


def main() -> int:
    """Runs the node."""
    return run(PantographControllerNode)


if __name__ == "__main__":
    sys.exit(main())
