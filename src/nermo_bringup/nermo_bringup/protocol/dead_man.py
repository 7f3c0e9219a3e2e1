"""Whoever watches the mouse lets it move by holding something: the space bar, or the gamepad's dead-man button."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Iterator
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

Watch = Callable[[], bool]
"""Whether it is held now."""


class HeldKey:
    """The space bar, of which a terminal tells presses and repetitions only; any other key lets go.

    The first repetition of a key comes late, so that a first press counts for `HOLD_S`; once it repeats, it is let go
    `REPEAT_HOLD_S` after the last one. Times are [s] of a clock that does not stop.
    """

    def __init__(self) -> None:
        self._pressed = -math.inf
        self._until = -math.inf

    def press(self, key: str, now: float) -> None:
        """Takes a key."""
        if key != " ":
            self._until = now
            return
        repeats = now - self._pressed <= REPEATED_S
        self._pressed = now
        self._until = now + (REPEAT_HOLD_S if repeats else HOLD_S)

    def held(self, now: float) -> bool:
        """Whether it is held."""
        return now < self._until


def hint(dead_man: DeadMan) -> str:
    """What the person beside the mouse is to do; empty where nothing is."""
    return {"space": "hold the space bar", "pad": "hold the pad's dead-man button", "none": ""}[dead_man]


@contextmanager
def watching(dead_man: DeadMan, pad: str) -> Iterator[Watch]:
    """What tells whether it is held, while the block runs.

    Raises:
        CommandError: there is no terminal to hold a key of, or no gamepad.
        ParameterError: nobody knows a pad of this name.
    """
    if dead_man == "space":
        with _keyboard() as watch:
            yield watch
    elif dead_man == "pad":
        with _pad(pad) as watch:
            yield watch
    else:
        yield lambda: True


@contextmanager
def _keyboard() -> Iterator[Watch]:
    key = HeldKey()

    def held() -> bool:
        try:
            for pressed in read_keys(sys.stdin.fileno()):
                key.press(pressed, time.monotonic())
        except KeyboardError:
            return False
        return key.held(time.monotonic())

    with raw_terminal(sys.stdin.fileno()):
        yield held


@contextmanager
def _pad(name: str) -> Iterator[Watch]:
    layout = load_pad(name)
    try:
        reader = PadReader()
    except JoystickError as error:
        raise CommandError(str(error)) from error

    def held() -> bool:
        state = reader.read()
        if state is None or len(state.axes) < layout.axis_count or len(state.buttons) < layout.button_count:
            return False
        return bool(layout.read("dead_man", list(state.axes), list(state.buttons)))

    with reader:
        yield held
