"""Effects, alone and together, ranked by how many cells of a published table they reproduce.

One-at-a-time experiments at a few sizes give each effect's curve through every cell; in between results are
interpolated, and the changes of two effects are taken to add up (in the logarithm). That is coarse, so what it promises
is run for real before it is reported, and the search goes on from what was run: one effect more, less or of another
size, foreseen from the nearest set that is known.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from nermo_gap.explain.candidates import Candidate
from nermo_gap.explain.emulator import Emulator
from nermo_gap.explain.evaluate import Evaluator, Point, Results
from nermo_gap.explain.sets import Explanation, Found, Part, explanation, judge, point_of
from nermo_gap.explain.summary import Summary

Progress = Callable[[str, int, int], None]
Promise = tuple[tuple[float, ...], tuple[Part, ...], list[bool]]
"""Rank, smaller is better; the set; and the cells that it is thought to meet."""

STEP = 0.5
"""Sizes between those that were run are looked at in steps of their positions."""
ENUMERATED = 3
"""All sets of up to so many effects are looked at; larger ones grow out of smaller."""
VERIFIED = 6
"""Sets of each number of effects that are run for real."""
LEADERS, TRIED, ROUNDS = 4, 8, 8
"""The search goes on from so many sets, of whose neighbours so many are run for real in a round; and rounds at most."""


@dataclass
class _Search:
    summary: Summary
    choices: Sequence[Candidate]
    evaluator: Evaluator
    say: Progress
    found: Found
    nominal: Results
    emulator: Emulator

    def verify(self, stage: str, promising: Sequence[Promise]) -> None:
        """Runs sets for real."""
        points = [point_of(parts) for _, parts, _ in promising]
        results = self.evaluator(points, self.summary.runs, functools.partial(self.say, stage))
        for (_, parts, predicted), result in zip(promising, results, strict=True):
            self.found.add(explanation(self.summary.cells, parts, result, self.nominal, predicted))

    def promise(self, parts: tuple[Part, ...], results: Results) -> Promise:
        """What a set is thought to explain."""
        met, _, distance = judge(self.summary.cells, results, self.nominal)
        return (-float(sum(met)), distance, len(parts)), parts, met


def explain(
    summary: Summary,
    choices: Sequence[Candidate],
    evaluator: Evaluator,
    largest: int = 2,
    progress: Progress | None = None,
) -> tuple[Explanation, list[Explanation]]:
    """(the twin as it is, explanations best first); all of them run for real."""
    say = progress or (lambda stage, done, total: None)
    points: list[Point] = [()]
    points += [(c.deviation(size),) for c in choices for size in c.sizes]
    results = evaluator(points, summary.runs, functools.partial(say, "one effect at a time"))
    nominal, rest = results[0], iter(results[1:])
    alone = {c.key: [next(rest) for _ in c.sizes] for c in choices}
    found = Found()
    for candidate in choices:
        for size, result in zip(candidate.sizes, alone[candidate.key], strict=True):
            found.add(explanation(summary.cells, (Part(candidate, size),), result, nominal))
    search = _Search(summary, choices, evaluator, say, found, nominal, Emulator(summary.runs, nominal, alone))
    for count in range(1, min(largest, ENUMERATED) + 1):
        search.verify(f"checking {count} effect{'s' if count > 1 else ''}", _promising(search, count)[:VERIFIED])
    for number in range(ROUNDS):
        best = found.ranked[0]
        search.verify(f"going on, round {number + 1}", _neighbours(search, largest)[:TRIED])
        if found.ranked[0].rank >= best.rank:
            break
    return explanation(summary.cells, (), nominal, nominal), found.ranked


def _promising(search: _Search, count: int) -> list[Promise]:
    """Sets of ``count`` effects at the sizes that the emulator likes best, best first."""
    ranked = []
    for chosen in itertools.combinations(search.choices, count):
        if any(a.excludes(b) for a, b in itertools.combinations(chosen, 2)):
            continue
        sets = itertools.product(*([Part(c, size) for size in _sizes(c)] for c in chosen))
        ranked.append(min((search.promise(s, search.emulator(s)) for s in sets), key=lambda p: p[0]))
    return sorted(ranked, key=lambda p: p[0])


def _neighbours(search: _Search, largest: int) -> list[Promise]:
    """Sets that differ in one effect from those that lead and have not been run, the most promising first."""
    ranked: dict[frozenset[Part], Promise] = {}
    for leader in search.found.ranked[:LEADERS]:
        for parts in _changed(leader.parts, search.choices, largest):
            if not search.found.knows(parts):
                promise = search.promise(parts, search.emulator(parts, leader.parts, leader.results))
                ranked[frozenset(parts)] = min(promise, ranked.get(frozenset(parts), promise), key=lambda p: p[0])
    return sorted(ranked.values(), key=lambda p: p[0])


def _changed(parts: tuple[Part, ...], choices: Sequence[Candidate], largest: int) -> Iterator[tuple[Part, ...]]:
    """A set with one effect more, less, exchanged or of the next size."""
    if len(parts) < largest:
        yield from ((*parts, other) for other in _others(parts, choices))
    for i, part in enumerate(parts):
        rest = parts[:i] + parts[i + 1 :]
        if rest:
            yield rest
        yield from ((*rest, other) for other in _others(rest, choices) if other.candidate != part.candidate)
        at, sizes = part.candidate.position(part.size), _sizes(part.candidate)
        near = [size for size in sizes if 0.01 < abs(part.candidate.position(size) - at) < STEP + 0.01]
        yield from ((*rest, Part(part.candidate, size)) for size in near)


def _others(parts: tuple[Part, ...], choices: Sequence[Candidate]) -> list[Part]:
    """What may join a set."""
    return [
        Part(choice, size)
        for choice in choices
        if not any(choice.excludes(p.candidate) for p in parts)
        for size in _sizes(choice)
    ]


def _sizes(candidate: Candidate) -> list[float]:
    """Sizes that are looked at, weak to strong."""
    return [candidate.size(STEP * k) for k in range(1, round(len(candidate.sizes) / STEP) + 1)]
