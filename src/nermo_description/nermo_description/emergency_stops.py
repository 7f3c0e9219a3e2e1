"""Who has stopped the robot: every source for itself. The same at twin, cable and the robot's end."""

from __future__ import annotations

from collections.abc import Collection, Hashable, Mapping
from dataclasses import dataclass
from typing import Any

REMEMBERED_TELLERS = 64
"""Far ends of which it is remembered what they have told; there is one at a time, and a restarted one is another."""


@dataclass(frozen=True, slots=True)
class Stop:
    """What one source has said, in a form that crosses a link as a state: it may be told as often as one likes."""

    source: str
    name: str
    """What people read."""
    saying: bool
    """Whether it says stop now."""
    number: int
    """Counts the stops of whoever tells: a stop that has ended meanwhile is still seen to have been another one."""


class EmergencyStops:
    """The latched stops of all sources.

    A source that says stop latches one. When it says so no more, nothing else changes: power comes back only with a
    release, and none is granted while any source says stop. A source that is gone says nothing any more.

    A source is whatever tells one from another; its name is what people read.
    """

    def __init__(self) -> None:
        self._saying: dict[Hashable, str] = {}
        """Who says stop now."""
        self._latched: dict[Hashable, str] = {}
        """Who has said so since the last release."""
        self._number: dict[Hashable, int] = {}
        """The last stop of each source, counted over all."""
        self._count = 0
        self._known: dict[str, dict[str, int]] = {}
        """The last stop of each source that each far end has told."""

    def say(self, source: Hashable, stop: bool, name: str = "") -> None:
        """What a source says now. It may say so as often as it likes: this is a state, not an event."""
        if not stop:
            self._saying.pop(source, None)
            return
        if source not in self._saying:
            self._count += 1
            self._number[source] = self._count
        self._saying[source] = self._latched[source] = name or str(source)

    def says(self, source: Hashable) -> bool:
        """Whether a source says stop now."""
        return source in self._saying

    def press(self, name: str) -> None:
        """A stop without an end of its own, as of a signal. Safe in a signal handler."""
        self.say(name, True)
        self.say(name, False)

    def keep(self, present: Collection[Hashable]) -> None:
        """Only these sources are there: the others do not say stop any more. What they have latched stays."""
        for source in [source for source in list(self._saying) if source not in present]:
            self.say(source, False)

    def rename(self, names: Mapping[Any, str]) -> None:
        """What people read of sources, where it is learnt only after they have said something."""
        for said in (self._saying, self._latched):
            said.update({source: name for source, name in names.items() if source in said})

    def release(self) -> str:
        """Takes all stops back; where somebody still says stop none, and who it is comes back in words."""
        count, saying = self._count, list(self._saying.values())
        if saying:
            return f"emergency_stop ({_who(saying, 'still says', 'still say')} stop: end it there first)"
        released, self._latched = self._latched, {}
        if self._count != count:  # a signal handler has come between
            self._latched = {**released, **self._latched}
            return f"emergency_stop ({self})"
        return ""

    @property
    def active(self) -> bool:
        """Whether the servos must be without power."""
        return bool(self._latched)

    # Over a link

    def told(self) -> tuple[Stop, ...]:
        """All that is latched or said here, for a far end."""
        return tuple(
            Stop(_text(source), name, source in self._saying, self._number[source])
            for source, name in list(self._latched.items())
        )

    def take(self, teller: str, stops: Collection[Stop]) -> None:
        """What a far end tells, all of it: a source that it does not name says nothing.

        Each stop is latched once, however often it is told; one that is still said is latched all the time.
        """
        known = self._known.pop(teller, {})
        for stop in stops:
            if stop.saying or stop.number > known.get(stop.source, 0):
                self.say((teller, stop.source), True, stop.name)
            if not stop.saying:
                self.say((teller, stop.source), False)
        named = {stop.source: stop.number for stop in stops}
        self._hush(teller, named)
        self._known[teller] = named
        if len(self._known) > REMEMBERED_TELLERS:
            del self._known[next(iter(self._known))]

    def forget(self, teller: str) -> None:
        """A far end that is gone says nothing any more. What it has latched stays."""
        self._hush(teller, ())

    def _hush(self, teller: str, but: Collection[str]) -> None:
        for source in list(self._saying):
            if isinstance(source, tuple) and source[0] == teller and source[1] not in but:
                self.say(source, False)

    def __str__(self) -> str:
        """Who has stopped it, and who says so still; empty where it is not stopped."""
        latched = list(self._latched.items())
        saying = [name for source, name in latched if source in self._saying]
        ended = [name for source, name in latched if source not in self._saying]
        parts = [f"{_who(saying, 'says', 'say')} stop"] if saying else []
        if ended:
            parts.append(_who(ended, "has said stop and waits for a release", "have said stop and wait for a release"))
        return ", ".join(parts)


def _text(source: Hashable) -> str:
    return source.hex() if isinstance(source, bytes) else str(source)


def _who(names: list[str], one: str, several: str) -> str:
    different = sorted(set(names))
    return f"{' and '.join(different)} {one if len(different) == 1 else several}"
