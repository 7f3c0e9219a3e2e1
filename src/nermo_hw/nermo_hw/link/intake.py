"""Where commands wait at the robot's end for the next tick: the newest of each sender, and one sender at a time."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from nermo_description.commanding import Ownership, RefusedCommandError
from nermo_description.silence import OWNER
from nermo_hw.link import stamp

LARGEST_NUMBER_OF_SENDERS = 8
"""While nobody commands, so many may try in one tick."""


class CommandIntake:
    """One place a sender for its newest command: what is newer takes its place, what is older never does.

    The first sender whose command was usable owns the robot until it has been silent for `silence.OWNER`. What is not
    usable, as with a stamp in the future, keeps nobody else out.

    name: says in words who a sender is. now: [ns] of a steady clock.
    """

    def __init__(self, name: Callable[[str], str], now: Callable[[], int] = time.monotonic_ns) -> None:
        self._name, self._now = name, now
        self._lock = threading.Lock()
        self._ownership: Ownership[str] = Ownership()
        self._waiting: dict[str, tuple[int, bytes]] = {}
        self.received = 0
        self.turned_away = 0
        """Commands of senders that had to wait."""
        self.last_turned_away = ""

    def put(self, payload: bytes, sender: str) -> None:
        """Raises ValueError where it has no stamp, RefusedCommandError where the sender has to wait."""
        at, now = stamp.read(payload), self._now()
        with self._lock:
            self.received += 1
            owner = self._ownership.owner(now)
            if owner not in (None, sender):
                self.turned_away += 1
                self.last_turned_away = (
                    f"{self._name(sender)} has to wait, {self.owner()} commands until it is silent for "
                    f"{OWNER.after:g} s"
                )
                raise RefusedCommandError(self.last_turned_away)
            before = self._waiting.get(sender)
            if before is None and len(self._waiting) >= LARGEST_NUMBER_OF_SENDERS:
                raise RefusedCommandError(f"{len(self._waiting)} others try to command in the same moment")
            if before is None or at > before[0]:
                self._waiting[sender] = (at, payload)

    def take(self) -> dict[str, bytes]:
        """The newest command of each sender, once."""
        with self._lock:
            waiting, self._waiting = self._waiting, {}
        return {sender: payload for sender, (_, payload) in waiting.items()}

    def accepted(self, sender: str) -> None:
        """Its command was usable: it owns the robot now."""
        with self._lock:
            self._ownership.heard(sender, self._now())

    def owner(self) -> str:
        """Who commands, in words; empty where nobody does."""
        owner = self._ownership.owner(self._now())
        return "" if owner is None else self._name(owner)
