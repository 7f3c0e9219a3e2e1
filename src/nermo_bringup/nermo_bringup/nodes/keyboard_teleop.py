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

from nermo_bringup.teleop.keyboard import HELP, KeyMapping, raw_terminal, read_keys
from nermo_control.driver import Driver, Limits
from nermo_control.nodes.operator import Operator
from nermo_node import run
from nermo_node.complaints import Complaints
from nermo_node.diagnostics import Diagnostics
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
        refused = Complaints(self, "refused")
        self._operator = Operator(self, self._driver, refused.add_one)
        self._last = "none"
        Diagnostics(self, "keyboard", {"messages": refused.status})
        self._input = sys.stdin.fileno()
        self._terminal.enter_context(raw_terminal(self._input))
        self._live = self._terminal.enter_context(
            Live(
                self._screen(),
                console=Console(markup=False),
                auto_refresh=False,
                redirect_stdout=False,
                redirect_stderr=False,
            )
        )
        # Hands work in real time, whatever the simulation's clock does.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(KEY_PERIOD_S, self._read, clock=steady)
        self.create_timer(COMMAND_PERIOD_S, self._tick, clock=steady)

    def destroy_node(self) -> None:
        """Give the terminal back."""
        self._terminal.close()
        super().destroy_node()

    def _read(self) -> None:
        for key in read_keys(self._input):
            self._mapping.press(key, time.monotonic())
        if self._operator.stop_is_news or self._mapping.left:
            self._tick()
        if self._mapping.left:
            # The same way out as Ctrl-C.
            signal.raise_signal(signal.SIGINT)

    def _tick(self) -> None:
        command = self._mapping.command(time.monotonic(), self._operator.stamp())
        self._operator.send(command)
        if command is not None:
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
