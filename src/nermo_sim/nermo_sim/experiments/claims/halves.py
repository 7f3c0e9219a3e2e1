"""Which of the twin's claims a calibration may see: one half of the topics, drawn once by seed and written down here.

Drawn are topics, not claims: of two claims that follow from the same quantity one would give the other away.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

import numpy as np

Half = Literal["fitted", "checked"]
SEED = 26
SEEN: tuple[str, ...] = ("balance table",)
"""Topics that are fitted whatever is drawn: the robot's COM was placed for this one before there were halves."""
FITTED: frozenset[str] = frozenset(
    {
        "arcs that fail",
        "balance table",
        "ground impact",
        "load on the diagonal",
        "load on the front right foot",
        "load on the rear left foot",
        "maze pitch",
        "maze time, spine",
        "mix over spine radius",
        "order of the radii",
        "order on the arcs",
        "pitch and yaw with offset compensation",
        "pitch deviation",
        "pitch of front lifts",
        "pitch with spine",
        "pitch with stride",
        "roll with frequency",
        "saturation of the lateral walk",
        "speed with stride",
        "spine alone",
        "spine radius of the lateral walk",
        "trot speed",
        "turning with frequency",
    }
)
CHECKED: frozenset[str] = frozenset(
    {
        "0.5 m arc",
        "1.0 m arc",
        "maze finished",
        "maze roll",
        "maze time, no spine",
        "mean pitch",
        "order of the gaits",
        "pitch of rear lifts",
        "radius at full lock",
        "range of roll",
        "roll with duty factor",
        "roll with offset compensation",
        "roll with spine",
        "slip",
        "speed with frequency",
        "spine gain at 0.5 Hz",
        "trot over lateral walk",
        "trot speed at 0.67 Hz",
        "trot speed at 0.67 Hz with spine",
        "trot speed with spine",
        "yaw with spine",
    }
)


def half_of(topic: str) -> Half:
    """The half of a topic of the twin's. ValueError for one that was never drawn."""
    if topic in FITTED:
        return "fitted"
    if topic in CHECKED:
        return "checked"
    raise ValueError(f"topic {topic!r} is in neither half: write it into `halves.py`")


def draw(claims: Mapping[str, int], seed: int = SEED) -> dict[Half, list[str]]:
    """The halves of topics with so many claims each: in random order, each to the half with fewer claims so far."""
    order = [topic for topic in np.random.default_rng(seed).permutation(sorted(claims)) if topic not in SEEN]
    halves: dict[Half, list[str]] = {"fitted": list(SEEN), "checked": []}
    for topic in map(str, order):
        halves[min(halves, key=lambda half: sum(claims[each] for each in halves[half]))].append(topic)
    return {half: sorted(topics) for half, topics in halves.items()}
