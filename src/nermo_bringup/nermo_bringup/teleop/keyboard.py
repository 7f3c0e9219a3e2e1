"""Driving from the keyboard of a terminal.

A terminal tells of keys that are pressed, not of keys that are let go. So a driving key holds for `HOLD_S`, which the
keyboard's own repetition renews; then the mouse stops.
"""

from __future__ import annotations

import math
import os
import select
import termios
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial

from nermo_control.driver import Driver
from nermo_control.spine.functions import SPINE_FUNCTIONS
from nermo_control.types import ControlCommand, Posture

HOLD_S = 0.7
"""Longer than the usual delay before a held key repeats (0.25 to 0.66 s)."""

_ARROWS = {"\x1b[A": "w", "\x1b[B": "s", "\x1b[C": "d", "\x1b[D": "a"}

DIRECTIONS = {
    "w": (1.0, 0.0),
    "s": (-1.0, 0.0),
    "a": (0.0, 1.0),
    "d": (0.0, -1.0),
    "e": (1.0, 1.0),
    "r": (1.0, -1.0),
}
"""Forward and turn for each driving key."""

SPINE_KEYS = dict(zip("tyuiop", SPINE_FUNCTIONS, strict=False))
"""The spine function that each key switches."""


def _short(function: str) -> str:
    return function.removesuffix("_compensation").replace("_", " ")


HELP = {
    "w s a d": "forward, backward, left, right (or the arrow keys); hold to keep going",
    "e r": "forward and left, forward and right",
    "space": "stop now",
    "x": "EMERGENCY STOP, limp; 1 takes it back",
    "1 2 3": "stand, sit, crouch",
    "4": "lift a leg: front left, front right, rear left, rear right, none",
    "0": "freeze every servo",
    "+ -": "faster, slower",
    "] [": "higher, lower gait frequency",
    "g": "next gait",
    "l": "hold a straight line, on and off",
    ", .": "trim to the left, to the right",
    " ".join(SPINE_KEYS): f"spine: {', '.join(map(_short, SPINE_KEYS.values()))}; on and off",
    "q": "leave (or Esc, Ctrl-C)",
}


class KeyboardError(RuntimeError):
    """There is no terminal to read keys from."""


class KeyMapping:
    """Turns keys into commands. Times are seconds of any clock that does not stop."""

    def __init__(self, driver: Driver, hold: float = HOLD_S) -> None:
        self.driver = driver
        self.left = False
        """The person wants to leave."""
        self._hold = hold
        self._until = -math.inf
        self._direction = (0.0, 0.0)
        self._driving = False
        self._actions: dict[str, Callable[[], None]] = {
            "x": driver.emergency_stop,
            "1": lambda: driver.take(Posture.STAND),
            "2": lambda: driver.take(Posture.SIT),
            "3": lambda: driver.take(Posture.CROUCH),
            "4": driver.lift_leg,
            "0": lambda: driver.take(Posture.STOP),
            "+": lambda: driver.change_speed(1),
            "=": lambda: driver.change_speed(1),
            "-": lambda: driver.change_speed(-1),
            "]": lambda: driver.change_frequency(1),
            "[": lambda: driver.change_frequency(-1),
            "g": driver.next_gait,
            "l": self._toggle_line,
            ",": lambda: driver.change_trim(1),
            ".": lambda: driver.change_trim(-1),
            **{key: partial(driver.toggle_spine, name) for key, name in SPINE_KEYS.items()},
        }

    @staticmethod
    def leaves(key: str) -> bool:
        """Whether this key is for leaving."""
        return key in ("q", "Q", "\x1b", "\x03")

    def press(self, key: str, now: float) -> None:
        """Take one key; keys without a meaning do nothing."""
        key = key.lower()
        if key in DIRECTIONS:
            self._direction = DIRECTIONS[key]
            self._until = now + self._hold
        elif key == " ":
            self._until = now
        elif self.leaves(key):
            self._until = now
            self.left = True
        elif key in self._actions:
            self._actions[key]()
            if key in "x0123":
                self._direction = (0.0, 0.0)
                self._until = now + self._hold

    def command(self, now: float, stamp: int) -> ControlCommand | None:
        """The command to send now, if any; to be asked for at a steady rate. `stamp` in ns of ROS time."""
        if now < self._until or self.driver.stopped:
            self._driving = True
            return self.driver.command(stamp, *((0.0, 0.0) if self.driver.stopped else self._direction))
        if self._driving:
            self._driving = False
            return self.driver.command(stamp, 0.0, 0.0)
        return None

    def _toggle_line(self) -> None:
        self.driver.straight_line = not self.driver.straight_line


@contextmanager
def raw_terminal(descriptor: int) -> Iterator[None]:
    """Deliver each key at once and unseen, those before too; whatever ends the block, the terminal is as it was.

    Raises:
        KeyboardError: the descriptor is no terminal.
    """
    if not os.isatty(descriptor):
        raise KeyboardError("the keyboard teleop needs a terminal as its input")
    before = termios.tcgetattr(descriptor)
    try:
        tty.setcbreak(descriptor, termios.TCSANOW)
        yield
    finally:
        termios.tcsetattr(descriptor, termios.TCSADRAIN, before)


def read_keys(descriptor: int) -> list[str]:
    """Keys that were pressed since the last call, without waiting; an arrow key is given as its letter.

    Raises:
        KeyboardError: the terminal was closed.
    """
    data = b""
    while select.select([descriptor], [], [], 0.0)[0]:
        try:
            chunk = os.read(descriptor, 1024)
        except OSError as error:
            raise KeyboardError(f"the terminal was closed: {error.strerror}") from None
        if not chunk:
            raise KeyboardError("the terminal was closed")
        data += chunk
    text = data.decode(errors="ignore")
    keys = []
    while text:
        sequence = text[:3]
        if sequence in _ARROWS:
            keys.append(_ARROWS[sequence])
            text = text[3:]
        elif text.startswith("\x1b["):
            # Some other function key: its letters are no keys of ours.
            text = text.lstrip("\x1b[0123456789;")[1:]
        else:
            keys.append(text[0])
            text = text[1:]
    return keys
