"""The door for commands: what is unusable is refused in words, what is too old no longer counts."""

from __future__ import annotations

from collections.abc import Callable
from typing import Generic, TypeVar

from nermo_control.types import ControlCommand, MotionCommand

Command = TypeVar("Command", ControlCommand, MotionCommand)


class Inbox(Generic[Command]):
    """Keeps the last valid command and knows until when it counts.

    `check` says in words what is wrong with a command, or None. A refused command leaves the last valid one in force
    until that times out. In lockstep each tick's command is fresh by construction, so its stamp is not looked at.
    """

    def __init__(self, check: Callable[[Command], str | None], timeout: float, lockstep: bool) -> None:
        self._check: Callable[[Command], str | None] = check
        self._timeout, self._lockstep = round(timeout * 1e9), lockstep
        self._seen: Command | None = None
        self._usable = False
        self._valid_at = 0
        self.command: Command | None = None
        """The last valid command."""

    def take(self, stamp: int, command: Command | None, warnings: list[str]) -> None:
        """Takes the newest command at a tick [ns]; None where none has come. Refusals are added to `warnings`."""
        if command is None:
            return
        if command is not self._seen:
            self._seen = command
            problem = self._check(command)
            self._usable = problem is None
            if problem is not None:
                warnings.append(f"command refused: {problem}")
        if self._usable:
            self.command = command
            self._valid_at = stamp if self._lockstep else command.stamp

    def fresh(self, stamp: int) -> bool:
        """Whether the last valid command still counts at a tick [ns]; one from another clock's future does not."""
        return self.command is not None and abs(stamp - self._valid_at) <= self._timeout

    def recheck(self) -> None:
        """Checks all anew, because what is allowed has changed."""
        self._seen = None
        if self.command is not None and self._check(self.command) is not None:
            self.command = None

    def clear(self) -> None:
        """Forgets everything."""
        self._seen = self.command = None
