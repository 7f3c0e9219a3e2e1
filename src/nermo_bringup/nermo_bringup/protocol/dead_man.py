"""Whoever watches the mouse lets it move by holding something: the space bar, or the gamepad's dead-man button.

Where they steer it too, they hold the key of a direction instead of the space bar, or push the pad's stick.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager

from nermo_bringup.teleop.joystick import JoystickError, PadReader
from nermo_bringup.teleop.keyboard import HOLD_S, KeyboardError, raw_terminal, read_keys
from nermo_bringup.teleop.pads import load_pad
from nermo_description.results import CommandError
from nermo_sim.experiments.on_robot import DeadMan

REPEATED_S = 0.2
"""A held key repeats every 20 to 90 ms."""
REPEAT_HOLD_S = 0.25
"""So long a key that repeats counts as held: as an operator's stick may be silent (`silence.STICK`)."""

STEERS = {" ": 0.0, "w": 0.0, "a": 1.0, "d": -1.0}
"""Keys of which one is held, and how far each turns to the left, in [-1, 1]; arrows are these letters too."""
HOLDS = {" ": 0.0}
"""The same where nobody steers."""

Watch = Callable[[], float | None]
"""How far whoever holds it turns to the left, in [-1, 1]: 0 where nobody steers. None where it is let go."""


class HeldKey:
    """The space bar, of which a terminal tells presses and repetitions only; any other key lets go.

    ``keys`` may be more than the space bar: then each of them holds, and says how far it turns.
    The first repetition of a key comes late, so that a first press counts for `HOLD_S`; once it repeats, it is let go
    `REPEAT_HOLD_S` after the last one. Times are [s] of a clock that does not stop.
    """

    def __init__(self, keys: Mapping[str, float] = HOLDS) -> None:
        self._keys = keys
        self._key = ""
        self._pressed = -math.inf
        self._until = -math.inf

    def press(self, key: str, now: float) -> None:
        """Takes a key."""
        if key not in self._keys:
            self._until = now
            return
        repeats = key == self._key and now - self._pressed <= REPEATED_S
        self._key, self._pressed = key, now
        self._until = now + (REPEAT_HOLD_S if repeats else HOLD_S)

    def held(self, now: float) -> bool:
        """Whether it is held."""
        return now < self._until

    def turn(self, now: float) -> float | None:
        """How far it turns to the left; None where it is not held."""
        return self._keys[self._key] if self.held(now) else None


def hint(dead_man: DeadMan, steers: bool = False) -> str:
    """What the person beside the mouse is to do; empty where nothing is."""
    steer = {"space": ", or instead of it a or d (or an arrow) to turn left or right", "pad": " and steer", "none": ""}
    hold = {"space": "hold the space bar", "pad": "hold the pad's dead-man button", "none": ""}
    return hold[dead_man] + steer[dead_man] * steers


@contextmanager
def watching(dead_man: DeadMan, pad: str, steers: bool = False) -> Iterator[Watch]:
    """What tells whether it is held, and how it is steered where whoever holds it ``steers``, while the block runs.

    Raises:
        CommandError: there is no terminal to hold a key of, or no gamepad.
        ParameterError: nobody knows a pad of this name.
    """
    if dead_man == "space":
        with _keyboard(STEERS if steers else HOLDS) as watch:
            yield watch
    elif dead_man == "pad":
        with _pad(pad, steers) as watch:
            yield watch
    else:
        yield lambda: 0.0


@contextmanager
def _keyboard(keys: Mapping[str, float]) -> Iterator[Watch]:
    key = HeldKey(keys)

    def held() -> float | None:
        try:
            for pressed in read_keys(sys.stdin.fileno()):
                key.press(pressed, time.monotonic())
        except KeyboardError:
            return None
        return key.turn(time.monotonic())

    with raw_terminal(sys.stdin.fileno()):
        yield held


@contextmanager
def _pad(name: str, steers: bool) -> Iterator[Watch]:
    layout = load_pad(name)
    try:
        reader = PadReader()
    except JoystickError as error:
        raise CommandError(str(error)) from error

    def held() -> float | None:
        state = reader.read()
        if state is None or len(state.axes) < layout.axis_count or len(state.buttons) < layout.button_count:
            return None
        axes, buttons = list(state.axes), list(state.buttons)
        if not layout.read("dead_man", axes, buttons):
            return None
        return float(layout.read("turn", axes, buttons)) if steers else 0.0

    with reader:
        yield held
