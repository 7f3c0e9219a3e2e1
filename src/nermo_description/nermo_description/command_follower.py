"""From servo commands that come when they come to targets for every tick: smoothly, and with an answer to silence.

The twin and the serial driver follow alike. The supervisor at the robot's end has the same times, but is no faster than
its approach velocity where this takes a fixed time: it limits torques on the way, and more causes send it there.
"""

from __future__ import annotations

from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from nermo_description.blend import smooth
from nermo_description.silence import CROUCH, HOLD

Array = NDArray[np.float64]

RESUME_JUMP = 0.1
"""The first command after a pause, if it is farther than this [rad], is approached smoothly."""
MOVE_DURATION = 0.4
"""Time that such a move and the crouch take [s]."""


class Following(StrEnum):
    """What the targets come from."""

    WAITING = "waiting for the first command"
    FOLLOWING = "following commands"
    HOLDING = "holding the last posture"
    CROUCHING = "crouching"
    LIMP = "nothing: no power"


class CommandFollower:
    """Targets of servos; positions [rad] have shape (n,).

    crouch: the posture that long silence ends in.
    """

    def __init__(self, crouch: Array) -> None:
        self._crouch = crouch
        self.rest()

    def rest(self, at: Array | None = None, state: Following = Following.WAITING) -> None:
        """Forgets what was commanded: the next command is the first. Until then the targets are `at`, or None."""
        self.state = state
        self._command: Array | None = None
        self._goal = self._target = at
        self._start: Array | None = None
        self._silent = self._moving = 0

    def command(self, positions: Array) -> None:
        """Takes a command, finite, for the next step."""
        self._command = positions

    def step(self, elapsed: int, measured: Array | None = None) -> Array | None:
        """Targets after `elapsed` [ns]; None as long as nobody has commanded and there is nowhere to rest.

        measured: where the servos are, NaN for one that does not know; a move begins there if nothing was told them
        before.
        """
        command, self._command = self._command, None
        if command is not None:
            self._silent, self._goal = 0, command
            if self.state is not Following.FOLLOWING:
                self.state = Following.FOLLOWING
                here = self._here(measured)
                if (np.abs(command - here) > RESUME_JUMP).any():
                    self._begin(here, command)
        elif self.state not in (Following.WAITING, Following.LIMP):
            self._silent += elapsed
            if self.state is Following.FOLLOWING and self._silent >= HOLD.after * 1e9:
                self.state = Following.HOLDING
            if self.state is Following.HOLDING and self._silent >= CROUCH.after * 1e9:
                self.state, self._goal = Following.CROUCHING, self._crouch
                self._begin(self._here(measured), self._crouch)
        if self._start is None or self._goal is None:
            self._target = self._goal
        else:
            self._target = self._on_the_way(elapsed, self._start, self._goal)
        return self._target

    def _here(self, measured: Array | None) -> Array:
        here = measured if self._target is None else self._target
        assert here is not None, "without a place to rest, the servos are measured"
        return here

    def _begin(self, start: Array, goal: Array) -> None:
        self._start, self._moving = np.where(np.isfinite(start), start, goal), 0

    def _on_the_way(self, elapsed: int, start: Array, goal: Array) -> Array:
        self._moving += elapsed
        share = self._moving * 1e-9 / MOVE_DURATION
        if share >= 1.0:
            self._start = None
            return goal
        return start + smooth(share) * (goal - start)
