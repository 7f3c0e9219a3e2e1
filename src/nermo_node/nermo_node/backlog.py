"""How far a node is behind what comes in, and what is left out until it is not."""

from __future__ import annotations

import time
from collections.abc import Callable

from rclpy.node import Node

PROBE_S = 0.05
"""Between two looks how long what comes in has to wait."""
LATE_S = 0.1
"""Whoever waits longer is helped: an emergency stop, a timer of the servos."""
MANY = 10
"""So many messages at least are taken in that time: a process that was only not let run has fewer before it."""
TELL_S = 10.0
"""Between two sentences about what was left out: a busy machine would fill the terminal with them."""


class Backlog:
    """Tells which messages to leave out, so that nothing else waits longer than about `LATE_S`.

    The events executor serves one queue in the order in which things happened, without a bound: an emergency stop that
    came after 10 s of a flood was seen after 10 s, and so it was in a node that is a little too slow for its sensors.
    So a mark is put at the end of the queue now and then. Where it takes too long to come to the front, all messages
    that may be left out are, unread, until what stood in the queue by then is gone.

    Args:
        node: Whose queue it is.
        tell: Gets a sentence after something was left out, the next one `TELL_S` later at the earliest.
    """

    def __init__(self, node: Node, tell: Callable[[str], None]) -> None:
        self._node, self._tell = node, tell
        self._marked: float | None = None
        self._next = 0.0
        self._taken = self._left_out = self._untold = 0
        self._told = -TELL_S
        self._ending = False

    def leaves_out(self) -> bool:
        """Whether the message that has just come is left out. Called for each that may be."""
        now = time.monotonic()
        if self._marked is None:
            if now >= self._next:
                self._mark(now)
            return False
        self._taken += 1
        if self._left_out == 0 and not self._waits_long(now):
            return False
        self._left_out += 1
        return True

    def _waits_long(self, now: float) -> bool:
        return self._marked is not None and now - self._marked > LATE_S and self._taken >= MANY

    def _mark(self, now: float) -> None:
        if (executor := self._node.executor) is not None:
            self._marked, self._taken = now, 0
            executor.create_task(self._passed)

    def _passed(self) -> None:
        """The mark has come to the front. What came behind it while messages were left out is as old by now."""
        now = time.monotonic()
        if self._left_out > 0 and not self._ending:
            self._ending = True
            self._mark(now)
            return
        self._untold += self._left_out
        if self._untold > 0 and now >= self._told + TELL_S:
            self._tell(f"too much at once: {self._untold} messages left out, unread, to be in time")
            self._untold, self._told = 0, now
        self._marked, self._next = None, now + PROBE_S
        self._left_out, self._ending = 0, False
