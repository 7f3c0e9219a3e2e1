"""What carries the link's messages between its ends."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

Receive = Callable[[str, bytes, bytes], None]
"""Gets key, payload and note of each message that came."""

Refused = Callable[[str], None]
"""Gets a sentence each time that somebody was turned away, from any thread."""

Answer = Callable[[bytes], bytes]
"""Gets the note of a question and answers it."""


class LinkError(OSError):
    """The link cannot be set up; the text says which end and why."""


class KeysMissingError(LinkError):
    """There are no keys, and trying again makes none."""


class Transport(Protocol):
    """Carries messages by key, at once or not at all. A note goes along with a message, outside of its payload."""

    def open(self, receive: Receive, answer: Answer) -> None:
        """Begins; both are called from any thread. Raises LinkError."""

    def close(self) -> None:
        """Ends; it may be opened again."""

    def put(self, key: str, payload: bytes, note: bytes = b"") -> bool:
        """Sends a message; false where there is nothing to send it with."""

    def ask(self, question: bytes, note: bytes, timeout: float) -> bytes | None:
        """At the workstation: the robot's answer to the one question there is; None where none comes in time [s]."""

    def peers(self) -> list[str]:
        """Who is connected, as far as is known."""

    def tell_refused(self, refused: Refused) -> None:
        """Tells it from now on, where the transport has a log that says so; this may take over the process's stdout."""
