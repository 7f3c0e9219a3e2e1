"""How likely each set of effects is, and each effect, by published tables; and whether these foretell each other.

Only sets that were run for real are weighed, so that what is said holds among these.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nermo_gap.explain.sets import Explanation
from nermo_gap.explain.summary import Cell

Array = NDArray[np.float64]

ACTS = 0.1
"""Chance that an effect acts, before anything is known: one or two of some seventeen."""
WRONG = 0.1
"""Chance that a lift or an arc goes otherwise than the effects have it, by a stumble or by how it was read."""
TAIL = 4.0
"""Degrees of freedom of a number about its interval, whose half is one deviation: heavy tails, for no twin is exact."""
_LOST = 40.0
"""Half intervals that an arc which is never walked is away."""


@dataclass(frozen=True)
class HeldOut:
    """How a table is foretold by the others.

    Attributes:
        twin: cells of it that the twin as it is meets.
        best: cells that the likeliest set by the other tables meets.
        expected: cells that the sets meet on average, each by its probability by the other tables.
    """

    source: str
    cells: int
    twin: int
    best: int
    expected: float


def probabilities(cells: Sequence[Cell], sets: Sequence[Explanation], without: str | None = None) -> Array:
    """Probability of each set among these, by all tables or without one of them."""
    log = [
        len(one.parts) * math.log(ACTS / (1.0 - ACTS))
        + sum(
            _log_likelihood(cell, value)
            for cell, value in zip(cells, one.values, strict=True)
            if cell.source != without
        )
        for one in sets
    ]
    weight: Array = np.exp(np.array(log) - max(log))
    return weight / weight.sum()


def _log_likelihood(cell: Cell, value: float) -> float:
    if cell.passed is not None:
        return math.log(1.0 - WRONG if bool(value) == cell.passed else WRONG)
    assert cell.low is not None and cell.high is not None
    half = 0.5 * (cell.high - cell.low)
    away = min(abs(value - 0.5 * (cell.low + cell.high)) / half, _LOST)
    return -0.5 * (TAIL + 1.0) * math.log1p(away**2 / TAIL)


def of_effects(sets: Sequence[Explanation], probability: Array) -> dict[str, float]:
    """Probability that each effect acts, the likeliest first."""
    keys = {p.candidate.key for one in sets for p in one.parts}
    chance = {key: float(sum(p for one, p in zip(sets, probability, strict=True) if key in _keys(one))) for key in keys}
    return dict(sorted(chance.items(), key=lambda item: (-item[1], item[0])))


def _keys(one: Explanation) -> set[str]:
    return {p.candidate.key for p in one.parts}


def held_out(cells: Sequence[Cell], before: Explanation, sets: Sequence[Explanation]) -> list[HeldOut]:
    """Each table left out in turn and foretold by the sets that the others make likely."""
    rows = []
    for source in dict.fromkeys(cell.source for cell in cells):
        mine = np.array([cell.source == source for cell in cells])
        chance = probabilities(cells, sets, source)
        met = np.array([np.array(one.met)[mine].sum() for one in sets])
        rows.append(
            HeldOut(
                source,
                int(mine.sum()),
                int(np.array(before.met)[mine].sum()),
                int(met[int(np.argmax(chance))]),
                float(chance @ met),
            )
        )
    return rows
