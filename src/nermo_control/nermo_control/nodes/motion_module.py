"""Node `motion_module`: motion_command [b], servo_targets, gait_parameters, foot_trajectories, leg_loads,
servo_states [d] -> servo_command [c], leg_states.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from typing import Any

from pydantic import Field
from rclpy.node import Node
from sensor_msgs.msg import Imu as ImuMessage

from nermo_control.gait.knowledge_base import GaitParameters
from nermo_control.motion.config import MotionModuleConfig
from nermo_control.motion_module import MotionModule
from nermo_control.nodes import conversions
from nermo_control.nodes.gait_parameters import GaitParametersInput
from nermo_control.nodes.robot import RobotChoice
from nermo_control.types import Imu, LegLoads, MotionCommand, MotionOutput, Posture, ServoTargets
from nermo_interfaces import msg
from nermo_node import qos, run
from nermo_node.command_input import CommandInput
from nermo_node.complaints import Complaints
from nermo_node.diagnostics import OK, WARN, Diagnostics, Status, Ticks
from nermo_node.inputs import Inputs
from nermo_node.parameters import declare
from nermo_node.synchronizer import TickSynchronizer
from nermo_node.time import to_nanoseconds


class MotionModuleParameters(MotionModuleConfig, RobotChoice):
    """Parameters of the node."""

    control_rate: float = Field(
        200.0,
        ge=20.0,
        le=1000.0,
        description="Rate of servo_states: foot trajectories are asked for one such tick ahead",
        json_schema_extra={"unit": "Hz", "readOnly": True},
    )


class MotionModuleNode(Node):
    """Ticks with each servo_states, on the newest command, IMU and, with the coordination `tegotae`, leg loads.

    In lockstep it ticks once the command of the same tick and the trajectories that it asked for are there too, and the
    IMU of the same tick if it began with the gaze mode `imu`, and the servo targets where they are to be followed.
    """

    def __init__(self) -> None:
        super().__init__("motion_module")
        self._settings = parameters = declare(self, MotionModuleParameters, self._on_parameters)
        self._robot = parameters.load()
        self._servos = conversions.ServoArrays(self._robot)
        self._module: MotionModule | None = None
        self._command: MotionCommand | None = None
        self._stamp: int | None = None
        self._imu: Imu | None = None
        self._loads: LegLoads | None = None
        self._targets: ServoTargets | None = None
        self._lockstep = parameters.lockstep
        self._inputs = ("servos", "command", "imu") if parameters.gaze == "imu" else ("servos", "command")
        self._tick = TickSynchronizer(self._inputs, self._on_tick)
        self._waiting: tuple[int, Mapping[str, Any]] | None = None
        self._asked: msg.LegStates | None = None
        """Leg states with a request that is not answered yet."""
        self._ticks = Ticks()
        self._walking = False
        self._refused = Complaints(self, "refused")
        self._clamped = Complaints(self, "clamped")

        self._servo_commands = self.create_publisher(msg.ServoCommand, "servo_command", qos.COMMAND)
        self._leg_states = self.create_publisher(msg.LegStates, "leg_states", qos.EVENT)
        GaitParametersInput(self, self._refused, self._on_gait_parameters, self._on_knowledge_base_alive)
        inputs, sensor = Inputs(self, self._refused.add_one), qos.sensor_input(parameters.lockstep)
        inputs.subscribe(msg.FootTrajectories, "foot_trajectories", self._on_foot_trajectories, qos.EVENT)
        oldest = None if parameters.lockstep else parameters.silence_timeout
        self._commands = CommandInput(self, self._refused.add_one, self._time, oldest)
        self._commands.subscribe(msg.MotionCommand, "motion_command", self._on_motion_command)
        self._players = CommandInput(self, self._refused.add_one, self._time, oldest)
        self._players.subscribe(msg.ServoCommand, "servo_targets", self._on_servo_targets)
        inputs.subscribe(msg.ServoStates, "servo_states", self._on_servo_states, sensor)
        inputs.subscribe(ImuMessage, "imu/data_raw", self._on_imu, sensor)
        if parameters.coordination == "tegotae":
            inputs.subscribe(msg.LegLoads, "leg_loads", self._on_leg_loads, qos.BEST_EFFORT)
        Diagnostics(
            self,
            self._robot.name,
            {
                "state": self._state,
                "owner": self._commands.status,
                "owner of servo_targets": self._players.status,
                "messages": self._refused.status,
                "limits": self._clamped.status,
            },
        )

    # Inputs

    def _time(self) -> int:
        """The time of the last tick [ns], which commands are compared with; before the first, the node's clock."""
        return int(self.get_clock().now().nanoseconds) if self._stamp is None else self._stamp

    def _on_parameters(self, parameters: MotionModuleParameters) -> None:
        self._settings = parameters
        if self._module is not None:
            self._module.set_config(parameters)

    def _on_imu(self, message: ImuMessage) -> None:
        imu = conversions.imu_from_message(message)
        if not self._lockstep:
            self._imu = imu
        elif "imu" in self._inputs:
            self._tick.add("imu", imu.stamp, imu)

    def _on_leg_loads(self, message: msg.LegLoads) -> None:
        self._loads = conversions.leg_loads_from_message(message)

    def _on_gait_parameters(self, parameters: GaitParameters) -> None:
        if self._module is None:
            period = round(1e9 / self._settings.control_rate)
            self._module = MotionModule(self._robot, parameters, period, self._settings)
        else:
            self._module.set_parameters(parameters)

    def _on_knowledge_base_alive(self, stamp: int) -> None:
        if self._module is not None:
            self._module.sign_of_life("gait_knowledge_base", stamp)

    def _on_foot_trajectories(self, message: msg.FootTrajectories) -> None:
        if self._module is None:
            return
        stamp = to_nanoseconds(message.header.stamp)
        for trajectory in conversions.foot_trajectories_from_message(message):
            self._module.accept(trajectory)
        self._module.sign_of_life("trajectory_generator", stamp)
        if self._asked is not None and stamp == to_nanoseconds(self._asked.header.stamp):
            self._asked = None
            self._step_if_ready()

    def _on_motion_command(self, message: msg.MotionCommand) -> None:
        self._command = command = conversions.motion_command_from_message(message)
        if self._lockstep:
            self._tick.add("command", command.stamp, command)

    def _on_servo_targets(self, message: msg.ServoCommand) -> None:
        self._targets = self._servos.targets(message)
        self._step_if_ready()

    def _on_servo_states(self, message: msg.ServoStates) -> None:
        positions = self._servos.positions(message)
        self._stamp = stamp = to_nanoseconds(message.header.stamp)
        if self._lockstep:
            self._tick.add("servos", stamp, positions)
        else:
            self._step(stamp, self._command, positions)

    # The tick

    def _on_tick(self, stamp: int, inputs: Mapping[str, Any]) -> None:
        if self._waiting is not None and self._waiting[0] == stamp and self._asked is not None:
            self._leg_states.publish(self._asked)  # the tick was repeated, so the request may have been lost
        self._waiting = (stamp, inputs)
        self._step_if_ready()

    def _step_if_ready(self) -> None:
        if self._waiting is None or self._asked is not None:
            return
        (stamp, inputs) = self._waiting
        direct = inputs["command"].posture is Posture.DIRECT
        if direct and (self._targets is None or self._targets.stamp != stamp):
            return
        self._waiting = None
        self._imu = inputs.get("imu")
        self._step(stamp, inputs["command"], inputs["servos"])

    def _step(self, stamp: int, command: MotionCommand | None, positions: list[float]) -> None:
        if self._module is None:
            return
        output = self._module.step(stamp, command, positions, self._imu, self._loads, self._targets)
        self._servo_commands.publish(self._servos.command(stamp, output.servo_positions))
        self._publish_leg_states(output)
        self._clamped.add(output.warnings)
        self._ticks.count()

    def _publish_leg_states(self, output: MotionOutput) -> None:
        message = conversions.leg_states_to_message(output.leg_states)
        if self._lockstep and any(output.leg_states.requested):
            self._asked = message
        self._leg_states.publish(message)
        self._walking = output.leg_states.gait_frequency > 0.0

    def _state(self) -> Status:
        ticks = self._ticks.since_told()
        values = {"ticks": self._ticks.total, "ticks_in_last_second": ticks}
        if self._module is None:
            return WARN, "waiting for gait_parameters", values
        if ticks == 0:
            return WARN, "no servo_states", values
        return OK, "walking" if self._walking else "standing", values


def main() -> int:
    """Runs the node."""
    return run(MotionModuleNode)


if __name__ == "__main__":
    sys.exit(main())
