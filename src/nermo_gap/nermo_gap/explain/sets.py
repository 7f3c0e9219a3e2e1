"""Sets of effects, and how many cells of a published table each of them reproduces."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from nermo_gap.explain.candidates import Candidate
from nermo_gap.explain.evaluate import Point, Results
from nermo_gap.explain.summary import Cell


@dataclass(frozen=True)
class Part:
    """An effect at a size."""

    candidate: Candidate
    size: float


@dataclass(frozen=True)
class Explanation:
    """A set of effects with the cells that it meets.

    values: the number of each cell as the experiments give it. predicted: whether the emulator thought it met.
    results: what every run gave.
    """

    parts: tuple[Part, ...]
    met: tuple[bool, ...]
    values: tuple[float, ...]
    distance: float
    """Root mean square distance of the continuous cells from their intervals, in widths of these."""
    predicted: tuple[bool, ...] = ()
    results: Results = field(default_factory=dict, repr=False)

    @property
    def key(self) -> str:
        """Names of its effects."""
        return " + ".join(p.candidate.key for p in self.parts) or "the twin as it is"

    @property
    def rank(self) -> tuple[float, ...]:
        """Smaller is better: cells not met, distance, number of effects."""
        return (-sum(self.met), self.distance, len(self.parts))


def point_of(parts: Sequence[Part]) -> Point:
    """Deviations of a set of effects."""
    return tuple(p.candidate.deviation(p.size) for p in parts)


def cell_value(cell: Cell, results: Results, nominal: Results) -> float:
    """The number of a cell: a ratio, or 1 and 0 for passed and failed."""
    if cell.passed is not None:
        value = results[cell.run.key]
        return float(math.isfinite(value) and value > 0.0)
    value = results[cell.run.key]
    if cell.over is not None:
        value /= max(results[cell.over.key], 1e-9)
    if cell.relative:
        own = nominal[cell.run.key] / (1.0 if cell.over is None else max(nominal[cell.over.key], 1e-9))
        value /= max(own, 1e-9)
    return value


def judge(cells: Sequence[Cell], results: Results, nominal: Results) -> tuple[list[bool], list[float], float]:
    """(cells met, values, distance) of results."""
    met, values, squares = [], [], []
    for cell in cells:
        value = cell_value(cell, results, nominal)
        values.append(value)
        if cell.passed is not None:
            met.append(bool(value) == cell.passed)
            continue
        assert cell.low is not None and cell.high is not None
        met.append(cell.low <= value <= cell.high)
        outside = max(cell.low - value, value - cell.high, 0.0) / (cell.high - cell.low)
        squares.append(min(outside, 20.0) ** 2)
    return met, values, float(np.sqrt(np.mean(squares))) if squares else 0.0


def explanation(
    cells: Sequence[Cell], parts: Sequence[Part], results: Results, nominal: Results, predicted: Sequence[bool] = ()
) -> Explanation:
    """What a set of effects explains, as its experiments went."""
    met, values, distance = judge(cells, results, nominal)
    return Explanation(tuple(parts), tuple(met), tuple(values), distance, tuple(predicted), results)


class Found:
    """Sets that were run for real: of each the sizes that explain most."""

    def __init__(self) -> None:
        self._best: dict[frozenset[str], Explanation] = {}
        self._run: set[frozenset[tuple[str, float]]] = set()

    def add(self, new: Explanation) -> None:
        """Takes one in."""
        self._run.add(_sizes(new.parts))
        names = frozenset(p.candidate.key for p in new.parts)
        if names not in self._best or new.rank < self._best[names].rank:
            self._best[names] = new

    def knows(self, parts: Sequence[Part]) -> bool:
        """Whether these effects have been run at these sizes."""
        return _sizes(parts) in self._run

    @property
    def ranked(self) -> list[Explanation]:
        """Best first."""
        return sorted(self._best.values(), key=lambda e: e.rank)


def _sizes(parts: Sequence[Part]) -> frozenset[tuple[str, float]]:
    return frozenset((p.candidate.key, p.size) for p in parts)
