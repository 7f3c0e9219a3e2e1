"""Node `safety_supervisor`: servo_command [c], [d], emergency_stop -> safe_servo_command, servo_power.

For a robot at a cable, in front of `serial_driver`; over Wi-Fi the same supervisor is part of `robot_end`.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from typing import Literal

import numpy as np
from pydantic import Field
from rclpy.node import Node
from sensor_msgs.msg import BatteryState, Imu
from std_msgs.msg import Bool

from nermo_description.robots import load_robot
from nermo_hw.safety.rules import Cause, State
from nermo_hw.safety.supervisor import Output, SafetySettings, SafetySupervisor
from nermo_hw.types import Array, Fault, SensorSample
from nermo_interfaces.msg import ServoCommand, ServoStates
from nermo_node import qos
from nermo_node.command_input import CommandInput
from nermo_node.complaints import Complaints
from nermo_node.diagnostics import ERROR, OK, WARN, Diagnostics, Status
from nermo_node.emergency_stop_input import EmergencyStopInput
from nermo_node.inputs import Inputs
from nermo_node.parameters import blame, declare
from nermo_node.run import run
from nermo_node.time import to_message, to_nanoseconds

TICK_S = 0.02
"""Between two looks at what does not come any more."""
NO_IMU: tuple[Array, Array, Array] = (np.full(4, math.nan), np.full(3, math.nan), np.full(3, math.nan))
NO_SUPPLY = (math.nan, math.nan)
"""As long as nothing has come, or where what came cannot be."""


class SafetySupervisorParameters(SafetySettings):
    """Parameters of the node."""

    robot: str = Field("nermo_lite", description="Name of the robot, or path of its parameter file")
    bus: Literal["", "servo_boards", "pwm_board"] = Field(
        "", description="What its servos hang on: servo_boards or pwm_board; empty: what the robot's file says"
    )
    auto_release: bool = Field(
        False, description="Give power unasked, at the start and when the device was away: for emulated robots"
    )


class SafetySupervisorNode(Node):
    """Answers each servo_states with what the servos may do; without power nothing is commanded."""

    def __init__(self) -> None:
        super().__init__("safety_supervisor")
        settings = declare(self, SafetySupervisorParameters)
        with blame("robot"):
            robot = load_robot(settings.robot)
        self._supervisor = SafetySupervisor(robot, settings, now=self._now())
        self._names = list(robot.servos)
        self._blind = (settings.bus or robot.bus) == "pwm_board"
        """Whether no sensors but that of the supply are there to be checked, as far as none has been heard."""
        self._auto_release = settings.auto_release
        self._imu = NO_IMU
        """Orientation, rates, accelerations."""
        self._supply = NO_SUPPLY
        """Voltage, current."""
        self._power: bool | None = None
        self._sensed_at = self._now()
        self._output: Output | None = None
        self._refused = Complaints(self, "refused")
        self._commands = self.create_publisher(ServoCommand, "safe_servo_command", qos.COMMAND)
        self._powers = self.create_publisher(Bool, "servo_power", qos.LATCHED)
        # The supervisor's door judges the stamps.
        self._owned = CommandInput(self, lambda text: self._refused.add([text]), self._now, oldest=None)
        self._owned.subscribe(ServoCommand, "servo_command", self._on_command)
        # A sensor that says what cannot be has no reading, and the supervisor acts on that.
        inputs = Inputs(self, self._refused.add_one)
        for kind, topic, take, refused in (
            (ServoStates, "servo_states", self._on_servo_states, self._servos_without_reading),
            (Imu, "imu/data_raw", self._on_imu, self._imu_without_reading),
            (BatteryState, "battery", self._on_battery, self._battery_without_reading),
        ):
            inputs.subscribe(kind, topic, take, qos.BEST_EFFORT, refused)
        self._stop_input = EmergencyStopInput(self, self._supervisor.stops, self._decide, self._release)
        parts = {"safety": self._status, "commands": self._refused.status, "owner": self._owned.status}
        Diagnostics(self, robot.name, parts)
        self.create_timer(TICK_S, self._watch)
        self._decide()

    def _now(self) -> int:
        return int(self.get_clock().now().nanoseconds)

    def _on_command(self, message: ServoCommand) -> None:
        stamp = to_nanoseconds(message.header.stamp)
        self._supervisor.take_command(stamp, message.name, message.position, self._now())

    def _on_servo_states(self, message: ServoStates) -> None:
        values = (message.position, message.velocity, message.current)
        self._sense(to_nanoseconds(message.header.stamp), *(self._ordered(message.name, value) for value in values))

    def _servos_without_reading(self) -> None:
        nothing = self._ordered((), ())
        self._sense(self._now(), nothing, nothing, nothing)

    def _sense(self, stamp: int, positions: Array, velocities: Array, currents: Array) -> None:
        self._sensed_at = now = self._now()
        sample = SensorSample(
            stamp=stamp,
            elapsed=0.0,
            servo_positions=positions,
            servo_velocities=velocities,
            servo_currents=currents,
            knee_angles=np.zeros(4),
            cells={},
            orientation=self._imu[0],
            angular_velocity=self._imu[1],
            linear_acceleration=self._imu[2],
            battery_voltage=self._supply[0],
            battery_current=self._supply[1],
            faults=Fault(0),
            limp=False,
            blind=self._blind,
        )
        self._supervisor.take_sensors(sample, now)
        if self._auto_release and self._supervisor.waits_for_the_line_only:
            self._supervisor.release(now)
        self._decide()

    def _ordered(self, names: Sequence[str], values: Sequence[float]) -> Array:
        """In the robot's order; NaN for what is not said."""
        by_name = dict(zip(names, values, strict=False))
        return np.array([by_name.get(name, math.nan) for name in self._names])

    def _on_imu(self, message: Imu) -> None:
        q, rate, acceleration = message.orientation, message.angular_velocity, message.linear_acceleration
        # Whoever has an IMU, a broken one too, is not blind, whatever his file says; then its silence is a fault.
        self._blind = False
        self._imu = (
            np.array([q.w, q.x, q.y, q.z]),
            np.array([rate.x, rate.y, rate.z]),
            np.array([acceleration.x, acceleration.y, acceleration.z]),
        )

    def _imu_without_reading(self) -> None:
        self._blind = False
        self._imu = NO_IMU

    def _on_battery(self, message: BatteryState) -> None:
        self._supply = (message.voltage, -message.current)

    def _battery_without_reading(self) -> None:
        self._supply = NO_SUPPLY

    def _release(self) -> str:
        left = self._supervisor.release(self._now())
        self._decide()
        return left

    def _watch(self) -> None:
        """Decides also when no sensor data comes."""
        now = self._now()
        if now - self._sensed_at > TICK_S * 1e9:
            self._supervisor.device_silent("no servo_states", now)
            self._decide()

    def _decide(self) -> None:
        now = self._now()
        self._output = output = self._supervisor.step(now)
        if output.targets.energised != self._power:
            self._power = output.targets.energised
            self._powers.publish(Bool(data=self._power))
        if self._power and self._supervisor.command_stamp is not None:
            command = ServoCommand(name=self._names, position=output.targets.positions.tolist())
            command.header.stamp = to_message(now)
            self._commands.publish(command)

    def _status(self) -> Status:
        output = self._output
        assert output is not None, "the constructor has decided once"
        self._stop_input.forget_the_gone()
        level = {State.FOLLOW: OK, State.HOLD: WARN}.get(output.state, ERROR)
        if output.causes == (Cause.START,):
            level = WARN
        values = {
            "state": output.state,
            "causes": ", ".join(str(cause) for cause in output.causes),
            "commands_accepted": self._supervisor.accepted,
            "commands_refused": self._supervisor.refused,
        }
        return level, self._supervisor.sentence(output), values


def main() -> int:
    """Runs the node."""
    return run(SafetySupervisorNode)


if __name__ == "__main__":
    sys.exit(main())
