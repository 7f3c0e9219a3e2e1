"""From commands that come when they come to targets for every cycle: smoothly, and with an answer to silence."""

from __future__ import annotations

from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from nermo_description.parameters import RobotParameters

Array = NDArray[np.float64]

HOLD_AFTER = 0.2
"""[s] without a command until the last posture is held."""
CROUCH_AFTER = 1.0
"""[s] without a command until the robot crouches."""
RESUME_JUMP = 0.1
"""A command farther than this [rad] from where the servos are is approached smoothly."""
MOVE_DURATION = 0.4
"""Time that such a move and the crouch take [s]."""


class Following(StrEnum):
    """What the targets come from; the same words as the twin's."""

    WAITING = "waiting for the first command"
    FOLLOWING = "following commands"
    HOLDING = "holding the last posture"
    CROUCHING = "crouching"


class CommandFollower:
    """Targets of one robot; positions in the order of `robot.servos`, times in s."""

    def __init__(self, robot: RobotParameters) -> None:
        self._crouch = np.array(list(robot.posture("crouch").values()))
        self._lower = np.array([servo.lower for servo in robot.servos.values()])
        self._upper = np.array([servo.upper for servo in robot.servos.values()])
        self.state = Following.WAITING
        self.clamped = 0
        """Commands with a position outside its servo's range."""
        self._command: Array | None = None
        self._silent = 0.0
        self._goal: Array | None = None
        self._start: Array | None = None
        self._moving: float | None = None
        self._target: Array | None = None

    def command(self, positions: Array) -> None:
        """Takes a command: servo positions [rad], finite, shape (n,)."""
        inside = np.clip(positions, self._lower, self._upper)
        self.clamped += bool((inside != positions).any())
        self._command = inside

    def forget(self) -> None:
        """The servos were limp, or the robot was away: the next command is the first."""
        self.state, self._command, self._goal = Following.WAITING, None, None
        self._moving = self._target = None

    def step(self, elapsed: float, measured: Array) -> Array | None:
        """Targets after `elapsed` [s], or None as long as nobody has commanded.

        measured: where the servos are [rad], NaN for one that does not know; a move begins there if nothing was told
        them before.
        """
        command, self._command = self._command, None
        if command is not None:
            self._silent = 0.0
            self._goal = command
            if self.state is not Following.FOLLOWING:
                self.state = Following.FOLLOWING
                here = measured if self._target is None else self._target
                if (np.abs(command - here) > RESUME_JUMP).any():
                    self._begin(here, command)
        elif self.state is not Following.WAITING:
            self._silent += elapsed
            if self.state is Following.FOLLOWING and self._silent >= HOLD_AFTER:
                self.state = Following.HOLDING
            if self.state is Following.HOLDING and self._silent >= CROUCH_AFTER:
                self.state, self._goal = Following.CROUCHING, self._crouch
                self._begin(measured if self._target is None else self._target, self._crouch)
        if self._goal is None:
            return None
        self._target = self._goal if self._moving is None else self._on_the_way(elapsed, self._goal)
        return self._target

    def _begin(self, start: Array, goal: Array) -> None:
        self._start, self._moving = np.where(np.isfinite(start), start, goal), 0.0

    def _on_the_way(self, elapsed: float, goal: Array) -> Array:
        assert self._moving is not None and self._start is not None, "a move is on"
        self._moving += elapsed
        share = self._moving / MOVE_DURATION
        if share >= 1.0:
            self._moving = None
            return goal
        return self._start + share * share * (3.0 - 2.0 * share) * (goal - self._start)
