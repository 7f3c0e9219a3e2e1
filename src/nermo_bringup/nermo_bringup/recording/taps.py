"""Which topics a recorder listens to, and what got lost on the way to it."""

from __future__ import annotations

import time
from collections.abc import Iterable
from fnmatch import fnmatchcase
from pathlib import Path

HIDDEN = "/_"


class TopicFilter:
    """Shell patterns (`*`, `?`, `[...]`), separated by spaces, of the topics to record and of those to leave out."""

    def __init__(self, include: str = "*", exclude: str = "") -> None:
        self._include = include.split()
        self._exclude = exclude.split()

    def __call__(self, topic: str) -> bool:
        """Whether to record a topic, given by its full name. Hidden topics need a pattern that spells `/_`."""
        if HIDDEN in topic and not any(HIDDEN in pattern for pattern in self._include):
            return False
        return self._matches(topic, self._include) and not self._matches(topic, self._exclude)

    @staticmethod
    def _matches(topic: str, patterns: Iterable[str]) -> bool:
        return any(fnmatchcase(topic, pattern) for pattern in patterns)


class LossCounter:
    """Counts messages that the middleware lost, from gaps in the sequence numbers of each publisher of a topic."""

    def __init__(self) -> None:
        self._last: dict[bytes, int] = {}
        self.lost = 0

    def see(self, publisher: bytes, sequence: int) -> None:
        """Take note of one received message. The first of a publisher only sets where counting starts."""
        last = self._last.get(publisher)
        if last is not None and sequence > last + 1:
            self.lost += sequence - last - 1
        self._last[publisher] = max(sequence, last or 0)


def dated_directory(parent: Path) -> Path:
    """Name of a new recording in a directory, from the local date and time; counted up if there is one already."""
    stem = time.strftime("%Y-%m-%d_%H-%M-%S")
    candidate = parent / stem
    number = 2
    while candidate.exists():
        candidate = parent / f"{stem}_{number}"
        number += 1
    return candidate
