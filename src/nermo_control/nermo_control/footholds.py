"""Steps over a gap in the ground that is seen ahead: by how much each foot must land elsewhere (C 3.2.5, figure 3.1).

A walk in its limit cycle repeats itself: a foot will stand where it stood last, one stride ahead. Places are along the
way, in a frame that stands still. Which of the two ways to change the steps is better is C's open question:

- `landing_change`: each leg for itself, in the one step that would end in the gap;
- `length_change`: the same change of the step length for all, from the moment on in which the gap is seen (as C does).
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from nermo_control.types import Phase

Stretch = tuple[float, float]
"""From where to where a foot touches the ground during one stance [m], because feet slip."""
STRIDES = 2
"""Strides of which the mean is taken."""
LANDING = 0.75
"""Share of its swing after which what a foot touches belongs to the next stance [1]: in the middle it may brush."""


@dataclass(frozen=True, slots=True)
class Gap:
    """Where no foot may stand, from `near` to `far` along the way [m]. Raises ValueError where that is not a gap."""

    near: float
    far: float

    def __post_init__(self) -> None:
        if not (math.isfinite(self.near) and math.isfinite(self.far) and self.near < self.far):
            raise ValueError(f"gap from {self.near} m to {self.far} m: must be finite, and end after it begins")

    def clearance(self, stretch: Stretch) -> float:
        """Distance of a stretch from the gap [m]; below 0 it reaches into it."""
        return max(self.near - stretch[1], stretch[0] - self.far)


class Footfalls:
    """Where each of four feet stands now, or stood last, and how far the robot goes in a stride."""

    def __init__(self) -> None:
        self._stretches: list[Stretch | None] = [None] * 4
        self._touch_downs: list[deque[float]] = [deque(maxlen=STRIDES + 1) for _ in range(4)]
        self._swings = [False] * 4
        self._lands = [False] * 4

    def step(
        self,
        body: float,
        feet: Sequence[float],
        touching: Sequence[bool],
        phases: Sequence[Phase],
        fractions: Sequence[float],
    ) -> None:
        """One control tick: places of body and feet [m], which feet touch, each leg's phase and its share of it."""
        for leg in range(4):
            swings = phases[leg] is Phase.SWING
            lands = swings and fractions[leg] >= LANDING
            if lands and not self._lands[leg]:
                self._stretches[leg] = None
            if self._swings[leg] and not swings and fractions[leg] < 0.5:
                self._touch_downs[leg].append(body)
            self._swings[leg], self._lands[leg] = swings, lands
            if touching[leg] and (lands or not swings):
                low, high = self._stretches[leg] or (feet[leg], feet[leg])
                self._stretches[leg] = min(low, feet[leg]), max(high, feet[leg])

    def stretch(self, leg: int) -> Stretch | None:
        """Where a foot has touched the ground since it last came down; None before it has."""
        return self._stretches[leg]

    def stride(self, leg: int) -> float | None:
        """How far the body goes between two touch-downs of a foot [m]; None before the second."""
        places = self._touch_downs[leg]
        return None if len(places) < 2 else (places[-1] - places[0]) / (len(places) - 1)

    def ahead(self, leg: int, steps: int = 1) -> Stretch | None:
        """Where a foot will stand in some steps' time if nothing changes; None where that is not known yet."""
        stretch, stride = self.stretch(leg), self.stride(leg)
        if stretch is None or stride is None:
            return None
        return stretch[0] + steps * stride, stretch[1] + steps * stride


def landing_change(gap: Gap, stretch: Stretch, margin: float, most_ahead: float, most_back: float) -> float:
    """How much farther ahead a foot must land [m] for its stretch to keep a margin from the gap: the smaller change.

    At most `most_ahead`, and at most `most_back` back [m]; where neither is enough, as far ahead as it goes.
    """
    if gap.clearance(stretch) >= margin:
        return 0.0
    ahead = gap.far + margin - stretch[0]
    back = stretch[1] - gap.near + margin
    if back <= most_back and back < ahead:
        return -back
    if ahead <= most_ahead:
        return ahead
    return -back if back <= most_back else most_ahead


def length_change(gap: Gap, footfalls: Footfalls, margin: float, response: float, most: float) -> float | None:
    """By how much all steps must change [m], from now on, for all feet to keep a margin from the gap; 0 or below.

    The k-th footstep after a change by d is taken to move by `response` k d. The smallest change that will do, to the
    millimetre and down to -`most`; where none will, that with most room. None where the strides are not known yet.
    """
    stretches: list[list[Stretch]] = []
    for leg in range(4):
        stretch, stride = footfalls.stretch(leg), footfalls.stride(leg)
        if stretch is None or stride is None or stride <= 0.0:
            return None
        steps = max(1, math.ceil((gap.far + margin - stretch[0]) / stride) + 1)
        stretches.append([(stretch[0] + k * stride, stretch[1] + k * stride) for k in range(1, 2 * steps)])
    best = (-math.inf, 0.0)
    for change in -np.arange(0.0, most + 5e-4, 1e-3):
        room = min(
            gap.clearance((low + response * k * change, high + response * k * change))
            for each in stretches
            for k, (low, high) in enumerate(each, 1)
        )
        if room >= margin:
            return float(change)
        best = max(best, (room, float(change)))
    return best[1]
