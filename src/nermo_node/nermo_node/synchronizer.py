"""Brings together what belongs to one control tick (lockstep)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

LARGEST_BACKLOG = 64
"""Ticks that are waited for at the same time."""


class TickSynchronizer:
    """Calls `fire(stamp, values)` once all `inputs` with the same stamp are there, and forgets what is older.

    An input of the tick that fired last fires it again: whoever repeats a question wants an answer. A clock that jumped
    back starts anew once all inputs follow it.
    """

    def __init__(self, inputs: Iterable[str], fire: Callable[[int, Mapping[str, Any]], None]) -> None:
        self._inputs = frozenset(inputs)
        self._fire = fire
        self._waiting: dict[int, dict[str, Any]] = {}
        self._fired: tuple[int, dict[str, Any]] | None = None

    def add(self, name: str, stamp: int, value: Any) -> None:
        """Takes the input `name` with its stamp [ns]. Raises KeyError for an input that was not named."""
        if name not in self._inputs:
            raise KeyError(name)
        if self._fired is not None and stamp == self._fired[0]:
            values = self._fired[1]
        else:
            values = self._waiting.setdefault(stamp, {})
        values[name] = value
        if len(values) < len(self._inputs):
            self._bound()
            return
        self._fired = (stamp, values)
        self._waiting = {other: seen for other, seen in self._waiting.items() if other > stamp}
        self._fire(stamp, values)

    def _bound(self) -> None:
        """A source that runs ahead, or one that never comes, does not fill the memory: the oldest to come go."""
        while len(self._waiting) > LARGEST_BACKLOG:
            del self._waiting[next(iter(self._waiting))]
