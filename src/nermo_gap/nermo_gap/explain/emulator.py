"""What experiments would give of effects together, from those of each alone."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from nermo_gap.explain.evaluate import Results
from nermo_gap.explain.sets import Part
from nermo_gap.explain.summary import Run

_LOST = 5.0
"""Stands for an infinite time in logarithms: farther than any arc that was walked."""


class Emulator:
    """Results of sets of effects at any sizes, from one-at-a-time runs ``alone`` at each candidate's sizes."""

    def __init__(self, runs: Sequence[Run], nominal: Results, alone: dict[str, list[Results]]) -> None:
        self._keys = [run.key for run in runs]
        self._passes = [run.experiment == "balance" for run in runs]
        self._nominal, self._alone = nominal, alone
        self._kept: dict[tuple[str, float], list[float]] = {}

    def __call__(self, parts: Sequence[Part], known: Sequence[Part] = (), results: Results | None = None) -> Results:
        """Results of a set, on from the ``results`` that experiments gave of a ``known`` one, or of the twin.

        A lift fails where one of the effects makes it fail; what it takes to pass must pass with all.
        """
        start = self._nominal if results is None else results
        now, before = ([self._changes(p) for p in some] for some in (parts, known))
        found: Results = {}
        for i, key in enumerate(self._keys):
            if self._passes[i]:
                state, was = (next((c[i] for c in some if c[i]), 0.0) for some in (now, before))
                found[key] = start[key] if state == was else self._nominal[key] + state
                continue
            total = _log(start[key]) + sum(c[i] for c in now) - sum(c[i] for c in before)
            found[key] = math.inf if total > _LOST - 0.5 else math.exp(total)
        return found

    def _changes(self, part: Part) -> list[float]:
        """What an effect changes alone in each run: in the logarithm, and of lifts 1 or -1."""
        key = (part.candidate.key, part.size)
        if key not in self._kept:
            place = part.candidate.position(part.size)
            changes = []
            for run, passes in zip(self._keys, self._passes, strict=True):
                levels = [self._nominal[run], *(r[run] for r in self._alone[part.candidate.key])]
                if passes:
                    changes.append(levels[round(place)] - levels[0])
                    continue
                values = [_log(level) for level in levels]
                changes.append(float(np.interp(place, np.arange(len(values)), values)) - values[0])
            self._kept[key] = changes
        return self._kept[key]


def _log(value: float) -> float:
    return _LOST if not math.isfinite(value) else math.log(max(value, 1e-4))
