"""How far, how long and how fast a robot has walked, from where it was."""

from __future__ import annotations

import math
from collections import deque

RULER_M = 0.05
"""The way is measured in straight pieces of this length, so that swaying by a centimetre counts for little."""
WINDOW_S = 1.25
"""The speed is the mean over so long, about a cycle of the gait."""
COASTING_S = 1.0
"""So long after the last driving command a robot may still be stepping to its stand."""


class Odometer:
    """Takes positions at increasing times [s], with whether the robot was told to move."""

    def __init__(self) -> None:
        self._measured_m = 0.0
        self.driven_s = 0.0
        """Time in which the robot was told to move."""
        self._anchor: tuple[float, float] | None = None
        """Where the present piece of the way began; None while it stands."""
        self._recent: deque[tuple[float, float, float]] = deque()
        self._last_told = -math.inf
        self._heading = 0.0

    def add(self, time: float, x: float, y: float, heading: float, told: bool) -> None:
        """Where the robot is [m] and looks to [rad], and whether it is told to move."""
        before = self._recent[-1][0] if self._recent else time
        if told:
            self.driven_s += time - before
            self._last_told = time
        self._heading = heading
        self._recent.append((time, x, y))
        while self._recent[0][0] < time - WINDOW_S:
            self._recent.popleft()
        moving = time - self._last_told <= COASTING_S
        if self._anchor is None:
            self._anchor = (x, y) if moving else None
        elif (piece := math.dist(self._anchor, (x, y))) >= RULER_M or not moving:
            self._measured_m += piece
            self._anchor = (x, y) if moving else None

    @property
    def distance_m(self) -> float:
        """Length of the way."""
        open_piece = math.dist(self._anchor, self._recent[-1][1:]) if self._anchor is not None else 0.0
        return self._measured_m + open_piece

    @property
    def speed_m_s(self) -> float:
        """Speed along the heading, backward negative."""
        if len(self._recent) < 2:
            return 0.0
        (begin, x0, y0), (end, x1, y1) = self._recent[0], self._recent[-1]
        ahead = (x1 - x0) * math.cos(self._heading) + (y1 - y0) * math.sin(self._heading)
        return ahead / (end - begin)

    def __str__(self) -> str:
        return f"walked {self.distance_m:.2f} m in {self.driven_s:.0f} s"
