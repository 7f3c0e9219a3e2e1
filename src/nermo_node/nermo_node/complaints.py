"""What a node had to refuse or clamp: counted, logged without flooding the log, and told on /diagnostics."""

from __future__ import annotations

import time
from collections.abc import Iterable

from rclpy.node import Node

from nermo_node.diagnostics import OK, WARN, Status

LOG_PERIOD_S = 1.0
"""At most one line is logged in this time; all are counted."""


class Complaints:
    """Collects what is wrong, in words. `what` names it in the diagnostics, as in "refused"."""

    def __init__(self, node: Node, what: str) -> None:
        self._node, self._what = node, what
        self._count = self._told = 0
        self._last = ""
        self._logged_at = -LOG_PERIOD_S

    def add(self, texts: Iterable[str]) -> None:
        """Takes complaints of one tick or message; usually there are none."""
        for text in texts:
            self._count += 1
            self._last = text
            now = time.monotonic()
            if now - self._logged_at >= LOG_PERIOD_S:
                self._logged_at = now
                self._node.get_logger().warning(text)

    def add_one(self, text: str) -> None:
        """Takes one."""
        self.add((text,))

    def status(self) -> Status:
        """WARN with the last complaint if there were any since the last call."""
        new, self._told = self._count - self._told, self._count
        values = {f"{self._what}_count": self._count, f"{self._what}_last": self._last}
        return (WARN, self._last, values) if new else (OK, f"nothing {self._what}", values)
