"""Who has stopped the robot: every source for itself. The same at twin, cable and the robot's end."""

from __future__ import annotations

from collections.abc import Collection, Hashable


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

    def say(self, source: Hashable, stop: bool, name: str = "") -> None:
        """What a source says now. It may say so as often as it likes: this is a state, not an event."""
        if stop:
            self._saying[source] = self._latched[source] = name or str(source)
        else:
            self._saying.pop(source, None)

    def press(self, name: str) -> None:
        """A stop without an end of its own, as of a signal. Safe in a signal handler."""
        self.say(name, True)
        self.say(name, False)

    def keep(self, present: Collection[Hashable]) -> None:
        """Only these sources are there: the others do not say stop any more. What they have latched stays."""
        for source in [source for source in list(self._saying) if source not in present]:
            self.say(source, False)

    def release(self) -> str:
        """Takes all stops back; where somebody still says stop none, and who it is comes back in words."""
        saying = list(self._saying.values())
        if saying:
            return f"emergency_stop ({_names(saying)} still says stop: end it there first)"
        self._latched.clear()
        return ""

    @property
    def active(self) -> bool:
        """Whether the servos must be without power."""
        return bool(self._latched)

    def __str__(self) -> str:
        """Who has stopped it, and who says so still; empty where it is not stopped."""
        latched = list(self._latched.items())
        saying = [name for source, name in latched if source in self._saying]
        ended = [name for source, name in latched if source not in self._saying]
        parts = [f"{_names(saying)} says stop"] if saying else []
        if ended:
            parts.append(f"{_names(ended)} has said stop and waits for a release")
        return ", ".join(parts)


def _names(names: list[str]) -> str:
    return " and ".join(sorted(set(names)))
