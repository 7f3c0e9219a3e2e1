"""Both ends of a link in one process, without a network: for tests, and as plain as the protocol allows."""

from __future__ import annotations

from nermo_hw.link.config import Side
from nermo_hw.link.transport import Answer, Receive, Refused


class Loopback:
    """A wire that the ends of a link hang on. What is sent arrives at once, or never while it is cut."""

    def __init__(self) -> None:
        self.cut = False
        self.ends: list[LoopbackTransport] = []

    def end(self, side: Side) -> LoopbackTransport:
        """The transport of one more end."""
        return LoopbackTransport(self, side)


class LoopbackTransport:
    """A `Transport` on a `Loopback`."""

    def __init__(self, wire: Loopback, side: Side) -> None:
        self._wire, self._side = wire, side

    def open(self, receive: Receive, answer: Answer) -> None:
        """As `Transport` says."""
        self._receive, self._answer = receive, answer
        self._wire.ends.append(self)

    def close(self) -> None:
        """As `Transport` says."""
        if self in self._wire.ends:
            self._wire.ends.remove(self)

    def put(self, key: str, payload: bytes, note: bytes = b"") -> bool:
        """As `Transport` says."""
        for end in self._others():
            end._receive(key, payload, note)
        return self in self._wire.ends

    def ask(self, question: bytes, note: bytes, timeout: float) -> bytes | None:
        """As `Transport` says."""
        return next((end._answer(note) for end in self._others()), None)

    def peers(self) -> list[str]:
        """As `Transport` says."""
        return [end._side.value for end in self._others()]

    def tell_refused(self, refused: Refused) -> None:
        """As `Transport` says: nobody is ever turned away."""

    def _others(self) -> list[LoopbackTransport]:
        if self._wire.cut or self not in self._wire.ends:
            return []
        return [end for end in self._wire.ends if end._side is not self._side]
