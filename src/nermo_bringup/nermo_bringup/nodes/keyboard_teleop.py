"""Node `keyboard_teleop`: the keys of a terminal as control commands."""

from __future__ import annotations

import signal
import sys
import time
from contextlib import ExitStack

from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node
from rich.console import Console
from rich.live import Live
from rich.table import Table
from std_msgs.msg import Bool

from nermo_bringup.teleop.driver import Driver, Limits
from nermo_bringup.teleop.keyboard import HELP, KeyMapping, raw_terminal, read_keys
from nermo_control.nodes.conversions import control_command_to_message
from nermo_interfaces.msg import ControlCommand, GaitParameters
from nermo_node import qos, run
from nermo_node.complaints import Complaints
from nermo_node.diagnostics import Diagnostics
from nermo_node.inputs import Inputs
from nermo_node.parameters import declare

COMMAND_PERIOD_S = 0.05
KEY_PERIOD_S = 0.01


class KeyboardTeleop(Node):
    """Publishes `control_command` at 20 Hz while a driving key is held, and `emergency_stop` when it changes."""

    def __init__(self) -> None:
        self._terminal = ExitStack()
        super().__init__("keyboard_teleop")
        self._driver = Driver(declare(self, Limits))
        self._mapping = KeyMapping(self._driver)
        self._commands = self.create_publisher(ControlCommand, "control_command", qos.COMMAND)
        self._stop = self.create_publisher(Bool, "emergency_stop", qos.LATCHED)
        self._stop_sent = False
        self._last = "none"
        refused = Complaints(self, "refused")
        Inputs(self, refused.add_one).subscribe(GaitParameters, "gait_parameters", self._gaits, qos.LATCHED)
        Diagnostics(self, "keyboard", {"messages": refused.status})
        self._input = sys.stdin.fileno()
        self._terminal.enter_context(raw_terminal(self._input))
        self._live = self._terminal.enter_context(
            Live(self._screen(), console=Console(), auto_refresh=False, redirect_stdout=False, redirect_stderr=False)
        )
        # Hands work in real time, whatever the simulation's clock does.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(KEY_PERIOD_S, self._read, clock=steady)
        self.create_timer(COMMAND_PERIOD_S, self._tick, clock=steady)

    def destroy_node(self) -> None:
        """Give the terminal back."""
        self._terminal.close()
        super().destroy_node()

    def _gaits(self, message: GaitParameters) -> None:
        self._driver.gaits = [gait.name for gait in message.gaits]
        self._driver.default_frequency = message.default_gait_frequency

    def _read(self) -> None:
        for key in read_keys(self._input):
            self._mapping.press(key, time.monotonic())
        if self._driver.stopped != self._stop_sent or self._mapping.left:
            self._tick()
        if self._mapping.left:
            # The same way out as Ctrl-C.
            signal.raise_signal(signal.SIGINT)

    def _tick(self) -> None:
        if self._driver.stopped != self._stop_sent:
            self._stop_sent = self._driver.stopped
            self._stop.publish(Bool(data=self._stop_sent))
        command = self._mapping.command(time.monotonic(), self.get_clock().now().nanoseconds)
        if command is not None:
            self._commands.publish(control_command_to_message(command))
            self._last = f"{command.forward_velocity:+.3f} m/s, {command.turn_rate:+.2f} rad/s"
        self._live.update(self._screen(), refresh=True)

    def _screen(self) -> Table:
        screen = Table(title="Nermo from the keyboard", show_header=False, caption=f"{self._driver}\n{self._last}")
        for keys, meaning in HELP.items():
            screen.add_row(keys, meaning)
        return screen


def main() -> int:
    """Run the keyboard teleop."""
    return run(KeyboardTeleop)
