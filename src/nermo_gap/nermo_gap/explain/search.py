"""Effects, alone and in pairs, ranked by how many cells of a published table they reproduce.

One-at-a-time experiments at a few sizes give each effect's curve through every cell; in between results are
interpolated, and the changes of two effects are taken to add up (in the logarithm). That is coarse, so what it promises
is run for real before it is reported.
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nermo_gap.explain.candidates import Candidate
from nermo_gap.explain.evaluate import Evaluator, Point, Results
from nermo_gap.explain.summary import Cell, Run, Summary

Array = NDArray[np.float64]
Progress = Callable[[str, int, int], None]

SHARES = (0.0, 0.5, 1.0)
"""Where sizes between those that were run are looked at."""
VERIFIED = 6
"""Hypotheses of each number of effects that are run for real."""
_LOST = 5.0
"""Stands for an infinite time in logarithms: farther than any arc that was walked."""


@dataclass(frozen=True)
class Part:
    """An effect at a size."""

    candidate: Candidate
    size: float


@dataclass(frozen=True)
class Explanation:
    """A set of effects with the cells that it meets.

    values: the number of each cell as the experiments give it. predicted: whether the emulator thought it met.
    """

    parts: tuple[Part, ...]
    met: tuple[bool, ...]
    values: tuple[float, ...]
    distance: float
    """Root mean square distance of the continuous cells from their intervals, in widths of these."""
    predicted: tuple[bool, ...] = ()

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


class Emulator:
    """Results at any sizes of a few effects, from one-at-a-time runs."""

    def __init__(self, runs: Sequence[Run], nominal: Results, alone: dict[str, list[Results]]) -> None:
        self._runs, self._nominal, self._alone = list(runs), nominal, alone

    def __call__(self, parts: Sequence[tuple[Candidate, float]]) -> Results:
        """Results where each effect is at a position: 0 nothing, 1 its first size, 2 its second..."""
        found: Results = {}
        for run in self._runs:
            start = _log(self._nominal[run.key])
            if run.experiment == "balance":
                # A lift fails where one of the effects makes it fail; what it takes to pass must pass with all.
                states = [self._at(candidate, run, position, 0.0) for candidate, position in parts]
                nominal = self._nominal[run.key]
                changed = [s for s in states if abs(s - nominal) > 0.5]
                found[run.key] = changed[0] if changed else nominal
                continue
            change = sum(self._at(candidate, run, position, start) - start for candidate, position in parts)
            total = start + change
            found[run.key] = math.inf if total > _LOST - 0.5 else math.exp(total)
        return found

    def _at(self, candidate: Candidate, run: Run, position: float, start: float) -> float:
        results = [r[run.key] for r in self._alone[candidate.key]]
        if run.experiment == "balance":
            levels = [self._nominal[run.key], *results]
            return levels[min(round(position), len(levels) - 1)]
        values = [start, *(_log(v) for v in results)]
        return float(np.interp(position, np.arange(len(values)), values))


def _log(value: float) -> float:
    return _LOST if not math.isfinite(value) else math.log(max(value, 1e-4))


def explain(
    summary: Summary,
    choices: Sequence[Candidate],
    evaluator: Evaluator,
    largest: int = 2,
    progress: Progress | None = None,
) -> tuple[Explanation, list[Explanation]]:
    """(the twin as it is, explanations best first); all of them run for real."""
    say = progress or (lambda stage, done, total: None)
    runs, cells = summary.runs, summary.cells
    points: list[Point] = [()]
    points += [(c.deviation(size),) for c in choices for size in c.sizes]
    results = evaluator(points, runs, functools.partial(say, "one effect at a time"))
    nominal, rest = results[0], iter(results[1:])
    alone = {c.key: [next(rest) for _ in c.sizes] for c in choices}
    met, values, distance = judge(cells, nominal, nominal)
    before = Explanation((), tuple(met), tuple(values), distance)
    emulator = Emulator(runs, nominal, alone)
    found: dict[tuple[str, ...], Explanation] = {}
    for candidate in choices:
        for size, result in zip(candidate.sizes, alone[candidate.key], strict=True):
            met, values, distance = judge(cells, result, nominal)
            one = Explanation((Part(candidate, size),), tuple(met), tuple(values), distance)
            _keep(found, one)
    for count in range(1, largest + 1):
        promising = _promising(summary, choices, emulator, nominal, count)[:VERIFIED]
        stage = f"checking {count} effect{'s' if count > 1 else ''}"
        verified = evaluator([point_of(parts) for parts, _ in promising], runs, functools.partial(say, stage))
        for (parts, predicted), result in zip(promising, verified, strict=True):
            met, values, distance = judge(cells, result, nominal)
            _keep(found, Explanation(parts, tuple(met), tuple(values), distance, tuple(predicted)))
    return before, sorted(found.values(), key=lambda e: e.rank)


def _keep(found: dict[tuple[str, ...], Explanation], new: Explanation) -> None:
    key = tuple(sorted(p.candidate.key for p in new.parts))
    if key not in found or new.rank < found[key].rank:
        found[key] = new


def _promising(
    summary: Summary, choices: Sequence[Candidate], emulator: Emulator, nominal: Results, count: int
) -> list[tuple[tuple[Part, ...], list[bool]]]:
    """Sets of ``count`` effects at the sizes that the emulator likes best, best first, with the cells it thinks met."""
    ranked = []
    for chosen in itertools.combinations(choices, count):
        grids = [[k + s for k in range(len(c.sizes)) for s in SHARES[1:]] for c in chosen]
        best: tuple[tuple[float, float], tuple[Part, ...], list[bool]] | None = None
        for positions in itertools.product(*grids):
            met, _, distance = judge(summary.cells, emulator(list(zip(chosen, positions, strict=True))), nominal)
            rank = (-float(sum(met)), distance)
            if best is None or rank < best[0]:
                parts = tuple(Part(c, _size(c, p)) for c, p in zip(chosen, positions, strict=True))
                best = (rank, parts, met)
        assert best is not None
        ranked.append(best)
    ranked.sort(key=lambda r: r[0])
    return [(parts, met) for _, parts, met in ranked]


def _size(candidate: Candidate, position: float) -> float:
    """Size at a position; position 0 is the neutral value, 1 for a factor."""
    neutral = 1.0 if candidate.unit == "1" else 0.0
    if candidate.effect in ("joint_range", "servo_rate_limit"):
        neutral = 2.0 * candidate.sizes[0]
    sizes = [neutral, *candidate.sizes]
    return round(float(np.interp(position, np.arange(len(sizes)), sizes)), 6)
