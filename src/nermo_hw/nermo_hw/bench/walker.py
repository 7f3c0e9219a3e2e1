"""The workstation of a measurement: sends commands over the link, right ones and wrong ones, and hears the robot.

python -m nermo_hw.bench.walker LINK_YAML ROBOT
"""

from __future__ import annotations

import math
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from nermo_description.robots import load_robot
from nermo_hw.bench.json_lines import serve
from nermo_hw.link import stamp
from nermo_hw.link.clock import SteadyClock
from nermo_hw.link.config import Side, Topic, load_link
from nermo_hw.link.end import LinkEnd
from nermo_hw.link.messages import decode_diagnostics, encode_command
from nermo_hw.link.transport import LinkError

COUNTER_SERVO, CHECK_SERVOS = "tail", ("spine_lateral", "head_pan")
"""Positions of these tell which command it was: nothing else on the way knows the number."""
FIRST, STEP = -1.0, 1e-3
"""Position of the counter at command 0, and from one to the next [rad]; ten times the resolution of the boards."""
COUNT = 2000
"""How many there are before the counter's range ends."""
PREPARATION_S = 1.5
"""For the counter to go to its start."""
SECOND = 1_000_000_000


class Walker:
    """Sends by itself at a rate, or answers each tick with the next posture of a gait."""

    def __init__(self, link: Path, robot: str) -> None:
        self._robot = load_robot(robot)
        self._names = list(self._robot.servos)
        self._neutral = np.array([servo.neutral for servo in self._robot.servos.values()])
        self._clock = SteadyClock()
        self._gait = self._neutral[None]
        self._tick = 0
        self._walking = False
        self._wrong: str | None = None
        self._last = self._repeated = 0
        self._states = 0
        self._diagnostics: bytes | None = None
        self._end = LinkEnd(load_link(link), Side.WORKSTATION, self._on_message, self._clock)
        self._end.open()
        self.words: dict[str, Callable[..., Any]] = {
            "status": self._status,
            "robot": self._robot_says,
            "release": self._release,
            "stop": self._stop,
            "gait": self._set_gait,
            "walk": self._walk,
            "prepare": self._prepare,
            "send": self._send,
            "wait": self._wait,
        }

    def close(self) -> None:
        """Ends the connection."""
        self._end.close()

    def _status(self) -> dict[str, Any]:
        return {"states": self._states, **{key: str(value) for key, value in self._end.status().items()}}

    def _robot_says(self, seconds: float) -> dict[str, dict[str, str]]:
        """Values by part of the next diagnostics that come from the robot; empty where none come in time."""
        self._diagnostics = None
        deadline = time.monotonic() + seconds
        while (message := self._diagnostics) is None:
            if time.monotonic() > deadline:
                return {}
            time.sleep(0.02)
        return decode_diagnostics(message)

    def _wait(self, seconds: float) -> bool:
        """Waits until the robot is heard."""
        deadline = time.monotonic() + seconds
        before = self._states
        while not (self._end.connected and self._states > before):
            if time.monotonic() > deadline:
                return False
            time.sleep(0.01)
        return True

    def _release(self) -> str | None:
        try:
            return self._end.ask_release(1.0)
        except LinkError:
            return None

    def _stop(self, pressed: bool, source: str = "pad") -> None:
        """What somebody at the workstation says."""
        self._end.stops.say(source, pressed)
        self._end.beat()

    def _set_gait(self, postures: list[list[float]]) -> None:
        self._gait = np.array(postures)

    def _walk(self, on: bool, wrong: str | None = None) -> None:
        """Answers ticks or not; `wrong` says what is the matter with the answers."""
        self._wrong, self._walking, self._repeated = wrong, on, 0

    def _on_message(self, topic: Topic, payload: bytes, _: str) -> None:
        if topic.name == "/diagnostics":
            self._diagnostics = payload
        if topic.name != "servo_states":
            return
        self._states += 1
        at = stamp.read(payload)
        if not self._walking or at <= self._last:
            return
        self._last = at
        self._tick += 1
        positions = self._gait[self._tick % len(self._gait)]
        self._end.send("servo_command", self._command(at, positions))

    def _command(self, at: int, positions: np.ndarray) -> bytes:
        names = self._names
        match self._wrong:
            case "repeated":
                self._repeated = at = self._repeated or at
            case "stale":
                at -= SECOND // 2
            case "future":
                at += SECOND
            case "nan":
                positions = np.where(np.arange(len(names)) == 0, math.nan, positions)
            case "infinite":
                positions = positions * math.inf
            case "unknown_name":
                names = ["nose", *names[1:]]
            case "wrong_length":
                names, positions = names[:-1], positions[:-1]
            case "out_of_range":
                positions = positions + 100.0
        return encode_command(at, names, positions.tolist())

    def _prepare(self, rate: float) -> int:
        """Sends command 0 at a rate [Hz] until the servos are there; how often."""
        sent = 0
        until = time.monotonic() + PREPARATION_S
        while time.monotonic() < until:
            sent += self._send_number(0)
            time.sleep(1.0 / rate)
        return sent

    def _send(self, count: int, rate: float) -> list[int]:
        """Sends numbered commands at a rate [Hz]; the monotonic time of each [ns], 0 where the link left it out."""
        times = []
        due = time.monotonic()
        for number in range(min(count, COUNT)):
            now = time.monotonic_ns()
            times.append(now if self._send_number(number) else 0)
            due += 1.0 / rate
            time.sleep(max(due - time.monotonic(), 0.0))
        return times

    def _send_number(self, number: int) -> bool:
        positions = self._neutral.copy()
        for servo, position in coded(number).items():
            positions[self._names.index(servo)] = position
        return self._end.send("servo_command", encode_command(self._clock(), self._names, positions.tolist()))


def coded(number: int) -> dict[str, float]:
    """Positions [rad] by which a command's number is known: a counter, and two that no posture has.

    Postures have them at 0, a crouching robot too.
    """
    checks = {servo: STEP * (1 + number * prime % 20) for servo, prime in zip(CHECK_SERVOS, (7, 13), strict=True)}
    return {COUNTER_SERVO: FIRST + STEP * number, **checks}


def main() -> int:
    """Obeys words from stdin."""
    walker = Walker(Path(sys.argv[1]), sys.argv[2])
    threading.current_thread().name = "words"
    serve(walker.words, walker.close)
    return 0


if __name__ == "__main__":
    sys.exit(main())
