"""A walk that begins anew: what a person must do on purpose before a robot that was left alone follows again."""

from __future__ import annotations

import numpy as np

from nermo_description.silence import HOLD
from nermo_hw.types import Array

STILL = 0.03
"""[rad] Commands that stay this near to each other are a stand."""
BEGUN = 0.1
"""[rad] A command that is so far from the stand begins a walk."""
STAND_FOR = 1.0
"""[s] Longer than a controller that is told to go on takes for its first step."""


class NewWalk:
    """Watches commands: they must stand still for `STAND_FOR`, with no silence, and then set off. Times are [ns]."""

    def __init__(self) -> None:
        self.start()

    def start(self) -> None:
        """Begins to watch; what was seen before does not count."""
        self._stand: Array | None = None
        self._since = self._last = 0
        self.begun = False
        """Whether a walk has begun anew."""

    def take(self, command: Array, now: int) -> None:
        """One command: servo positions [rad], shape (n,)."""
        gap, self._last = now - self._last, now
        if self._stand is None or gap > HOLD.after * 1e9:
            self._stand, self._since = command, now
            return
        away = float(np.abs(command - self._stand).max())
        stood = now - self._since >= STAND_FOR * 1e9
        if stood:
            self.begun = self.begun or away > BEGUN
        elif away > STILL:
            self._stand, self._since = command, now

    def stands(self, now: int) -> bool:
        """Whether the commands have stood still for long enough, and still come."""
        return self._stand is not None and now - self._last <= HOLD.after * 1e9 and self._stood()

    def _stood(self) -> bool:
        return self._last - self._since >= STAND_FOR * 1e9
