"""The way that the mouse has walked, and how fast it walks."""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from numpy.typing import NDArray

STEP_M = 0.005
"""Between two points of the way: finer than a stride, which is some centimetres long."""
MOST_POINTS = 2000
"""Beyond, every second point goes and the steps double: the way stays whole, and its size bounded."""
JUMP_M = 0.5
"""Nobody walks so far between two looks: the mouse was put elsewhere, and a new way begins."""
WINDOW_NS = 1_000_000_000
"""Over which the speed is taken: about a stride, so that it does not swing with each step."""


class Trail:
    """The way of base_link over the ground."""

    def __init__(self) -> None:
        self._points: list[tuple[float, float]] = []
        self._step = STEP_M
        self.news = False
        """Whether the way has changed since this was last set to False."""

    def add(self, x: float, y: float) -> None:
        """Where it is now [m]."""
        if self._points:
            moved = math.dist(self._points[-1], (x, y))
            if moved < self._step:
                return
            if moved > JUMP_M:
                self._points, self._step = [], STEP_M
        self._points.append((x, y))
        self.news = True
        if len(self._points) > MOST_POINTS:
            self._points, self._step = self._points[::2], 2.0 * self._step

    def pieces(self, height: float) -> NDArray[np.float32]:
        """The way as straight pieces at a height [m] above the ground, shape (N, 2, 3)."""
        flat = np.array(self._points, np.float32).reshape(-1, 2)
        points = np.column_stack([flat, np.full(len(flat), height, np.float32)])
        return np.stack([points[:-1], points[1:]], axis=1)


class Speedometer:
    """Speed along the mouse's own heading, over the last second of its time."""

    def __init__(self) -> None:
        self._seen: deque[tuple[int, float, float]] = deque()
        self.forward = 0.0
        """[m/s]"""

    def add(self, stamp: int, x: float, y: float, yaw: float) -> None:
        """Where it is [m, rad] at a time [ns]; one that does not follow the others begins anew."""
        seen = self._seen
        if seen and not 0 <= stamp - seen[-1][0] <= WINDOW_NS:
            seen.clear()
        seen.append((stamp, x, y))
        while stamp - seen[0][0] > WINDOW_NS:
            seen.popleft()
        first, x0, y0 = seen[0]
        passed = (stamp - first) * 1e-9
        along = (x - x0) * math.cos(yaw) + (y - y0) * math.sin(yaw)
        self.forward = along / passed if passed > 0.0 else 0.0
