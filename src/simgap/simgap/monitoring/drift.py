"""Whether a level has risen: Page's cumulative sum (Biometrika 1954), against what was usual at first."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

LEARNED = 40
"""Levels from which is learned what is usual, where no reference was given."""
SMALLEST_SPREAD = 0.3
"""Least standard deviation of a logarithm of mean squares: that of windows with twenty independent samples."""
ALLOWANCE, LIMIT = 2.0, 8.0
"""[standard deviations] What a level may lie higher without counting, and the sum of what is more that is an alarm.
A level that lies six too high is noticed after three windows. Independent normal levels sum up to the limit once in
1e15 windows (Siegmund: exp(2 k (h + 1.17)) / 2 k^2); the room is for levels that hang together and are not normal."""
MOST = 6.0
"""Standard deviations that one window counts at most: one alone, a push or a lost packet, is no drift."""


class Drift:
    """Watches a level, the logarithm of a mean square, for a rise that lasts.

    It learns what is usual from the first LEARNED levels, or from those of a reference.
    """

    def __init__(self, reference: Sequence[float] = ()) -> None:
        self._first: list[float] = []
        self._sum = 0.0
        self.usual: float | None = None
        """Level that is usual; None while it learns."""
        self.spread = SMALLEST_SPREAD
        self.risen = False
        if len(reference) >= LEARNED:
            self._learn(reference)

    def add(self, level: float) -> bool:
        """The next level. Returns whether ``risen`` changed."""
        if self.usual is None:
            self._first.append(level)
            if len(self._first) >= LEARNED:
                self._learn(self._first)
            return False
        excess = min((level - self.usual) / self.spread, MOST) - ALLOWANCE
        self._sum = float(np.clip(self._sum + excess, 0.0, 2.0 * LIMIT))
        risen = self._sum > LIMIT or (self.risen and self._sum > 0.0)
        changed, self.risen = risen != self.risen, risen
        return changed

    @property
    def learned(self) -> float:
        """Share of what it has to see before it can tell, 0 to 1."""
        return 1.0 if self.usual is not None else len(self._first) / LEARNED

    def _learn(self, levels: Sequence[float]) -> None:
        low, self.usual, high = (float(v) for v in np.percentile(levels, [5, 50, 95]))
        # The wider side: a robot that is seldom far off is so in health.
        self.spread = max((high - self.usual) / 1.645, (self.usual - low) / 1.645, SMALLEST_SPREAD)
