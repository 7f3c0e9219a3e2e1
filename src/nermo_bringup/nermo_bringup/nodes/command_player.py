"""Node `command_player`: a command file, or the commands of a recording, into the graph."""

from __future__ import annotations

import signal
from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field
from rclpy.clock import Clock as NodeClock
from rclpy.clock import ClockType
from rclpy.node import Node
from rosgraph_msgs.msg import Clock

from nermo_bringup.nodes.outlet import CONTROL_PERIOD_S, SERVO_PERIOD_S, Outlet
from nermo_bringup.teleop.script import Script, load_script
from nermo_description.invocation import called
from nermo_node import run
from nermo_node.complaints import Complaints
from nermo_node.graph_clock import GraphClock
from nermo_node.inputs import Inputs
from nermo_node.parameters import declare
from nermo_node.time import to_nanoseconds

JUMP_S = 2.0
"""A clock that goes on by more at once is another one: that of the machine, where a twin has ended."""

WATCH_S = 0.5


class PlayerParameters(BaseModel):
    """Parameters of the command player."""

    model_config = ConfigDict(frozen=True)

    file: str = Field("", description="command file, or recording")
    commands: Literal["control", "servo"] = Field("control", description="which commands of a recording to play")
    lockstep: bool = Field(False, description="answer each tick of /clock with the command of that tick")


class CommandPlayer(Node):
    """Plays once, from the moment that somebody listens, and ends.

    Outside lockstep the command that holds is repeated at 20 Hz of the graph's time, and servo positions, which the
    motion module passes on, at 200 Hz. When the script is over, one command that stops the mouse follows.
    """

    def __init__(self) -> None:
        super().__init__("command_player")
        parameters = declare(self, PlayerParameters)
        if not parameters.file:
            raise ValueError("the parameter file is empty; give a command file or a recording")
        self._script: Script = load_script(Path(parameters.file), parameters.commands)
        self._outlet = Outlet(self, of_servos=bool(self._script.servos))
        self._lockstep = parameters.lockstep
        self._graph_clock = GraphClock(self)
        self._start: int | None = None
        self._last = 0
        self._over = False
        if (unheard := self._outlet.unheard) is not None:
            self.get_logger().info(f"waiting for somebody who listens to {unheard} ({called()} up)")
        if parameters.lockstep:
            inputs = Inputs(self, Complaints(self, "refused").add_one)
            inputs.subscribe(Clock, "/clock", lambda message: self._play(to_nanoseconds(message.clock)), 10)
        else:
            period = SERVO_PERIOD_S if self._script.servos else CONTROL_PERIOD_S
            self.create_timer(period, lambda: self._play(self._graph_clock.stamp()))
            # The timer above stands still with a twin that has ended; this one sees it.
            steady = NodeClock(clock_type=ClockType.STEADY_TIME)
            self.create_timer(WATCH_S, lambda: self._play(self._graph_clock.stamp()), clock=steady)

    def _play(self, now: int) -> None:
        if self._over or (now == 0 and not self._lockstep):
            return
        if self._start is None:
            if self._outlet.unheard is not None:
                return
            self._start = self._last = now
            self.get_logger().info(f"playing {self._script.duration / 1e9:g} s")
        if now < self._start:
            # A twin that came up later is the clock now: what went out before was another's time.
            self._start = None
            return
        if now - self._last > JUMP_S * 1e9:
            played = (self._last - self._start) * 1e-9
            raise RuntimeError(
                f"the clock went on by {(now - self._last) * 1e-9:.0f} s at once (has the twin ended?): the first "
                f"{played:.1f} s of {self._script.duration / 1e9:g} s were played"
            )
        self._last, elapsed = now, now - self._start
        if elapsed > self._script.duration:
            self._finish(now)
        elif (command := self._script.control_at(elapsed, now)) is not None:
            self._outlet.send(command, self._script.servos_at(elapsed), every_tick=self._lockstep)

    def _finish(self, now: int) -> None:
        self._over = True
        self._outlet.send(self._script.last(now), None, every_tick=True)
        self.get_logger().info("done")
        # The same way out as Ctrl-C.
        signal.raise_signal(signal.SIGINT)


def main() -> int:
    """Run the command player."""
    return run(CommandPlayer)
