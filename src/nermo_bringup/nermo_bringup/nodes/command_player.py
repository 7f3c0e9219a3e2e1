"""Node `command_player`: a command file, or the commands of a recording, into the graph."""

from __future__ import annotations

import signal
from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field
from rclpy.node import Node
from rosgraph_msgs.msg import Clock

from nermo_bringup.teleop.script import Script, load_script
from nermo_control.nodes.conversions import control_command_to_message
from nermo_description.invocation import called
from nermo_interfaces.msg import ControlCommand, ServoCommand
from nermo_node import qos, run
from nermo_node.complaints import Complaints
from nermo_node.inputs import Inputs
from nermo_node.parameters import declare
from nermo_node.time import to_message, to_nanoseconds

CONTROL_PERIOD_S = 0.05
SERVO_PERIOD_S = 0.005


class PlayerParameters(BaseModel):
    """Parameters of the command player."""

    model_config = ConfigDict(frozen=True)

    file: str = Field("", description="command file, or recording")
    commands: Literal["control", "servo"] = Field("control", description="which commands of a recording to play")
    lockstep: bool = Field(False, description="answer each tick of /clock with the command of that tick")


class CommandPlayer(Node):
    """Plays once, from the moment that somebody listens, and ends.

    Outside lockstep the command that holds is repeated at 20 Hz of ROS time (servo positions at 200 Hz). When the
    script is over, one command that stops the mouse follows.
    """

    def __init__(self) -> None:
        super().__init__("command_player")
        parameters = declare(self, PlayerParameters)
        if not parameters.file:
            raise ValueError("the parameter file is empty; give a command file or a recording")
        self._script: Script = load_script(Path(parameters.file), parameters.commands)
        of_servos = bool(self._script.servos)
        self._publisher = (
            self.create_publisher(ServoCommand, "servo_command", qos.COMMAND)
            if of_servos
            else self.create_publisher(ControlCommand, "control_command", qos.COMMAND)
        )
        self._start: int | None = None
        self._over = self._told = False
        self.get_logger().info(f"waiting for somebody who listens to {self._publisher.topic_name} ({called()} up)")
        if parameters.lockstep:
            inputs = Inputs(self, Complaints(self, "refused").add_one)
            inputs.subscribe(Clock, "/clock", lambda message: self._play(to_nanoseconds(message.clock)), 10)
        else:
            period = SERVO_PERIOD_S if of_servos else CONTROL_PERIOD_S
            self.create_timer(period, lambda: self._play(self.get_clock().now().nanoseconds))

    def _play(self, now: int) -> None:
        if self._over:
            return
        if self._start is None:
            if self._publisher.get_subscription_count() == 0:
                return
            self._start = now
            self.get_logger().info(f"playing {self._script.duration / 1e9:g} s")
        if now - self._start > self._script.duration:
            self._finish(now)
        elif self._script.servos:
            self._send_servos(now - self._start, now)
        elif (command := self._script.control_at(now - self._start, now)) is not None:
            self._publisher.publish(control_command_to_message(command))

    def _send_servos(self, elapsed: int, now: int) -> None:
        if not self._told and self.count_publishers(self._publisher.topic_name) > 1:
            self._told = True
            self.get_logger().error(
                f"somebody else commands the servos on {self._publisher.topic_name}, and a second one is refused: "
                f"start the graph without its controller ({called()} up controller:=false)"
            )
        positions = self._script.servos_at(elapsed)
        if positions is not None:
            message = ServoCommand(name=list(positions), position=list(positions.values()))
            message.header.stamp = to_message(now)
            self._publisher.publish(message)

    def _finish(self, now: int) -> None:
        self._over = True
        if self._script.controls:
            last = self._script.control_at(self._script.duration, now)
            assert last is not None
            message = control_command_to_message(last)
            message.forward_velocity = message.turn_rate = 0.0
            self._publisher.publish(message)
        self.get_logger().info("done")
        # The same way out as Ctrl-C.
        signal.raise_signal(signal.SIGINT)


def main() -> int:
    """Run the command player."""
    return run(CommandPlayer)
