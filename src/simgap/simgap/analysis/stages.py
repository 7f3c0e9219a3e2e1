"""What a diagnosis knows before it has ended, stage by stage, for whoever watches it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from simgap.analysis.localisation import Phases, locate
from simgap.data.align import Aligned
from simgap.data.plant import Plant
from simgap.inference.candidates import Hint
from simgap.inference.fit import Fitter
from simgap.inference.hypothesis import Fit, Hypothesis
from simgap.inference.scores import Scores
from simgap.inference.selection import Selection

_LEADERS = 6
"""Of those that lead, so many are told."""
_PROMISING = 4


@dataclass(frozen=True)
class Checked:
    """The recordings can be used; ``warnings`` in sentences, ``channels`` by name."""

    duration_s: float
    runs: int
    channels: tuple[str, ...]
    warnings: tuple[str, ...]

    @classmethod
    def of(cls, aligned: Aligned, plant: Plant, warnings: Sequence[str]) -> Checked:
        """What was aligned."""
        channels = tuple(output.name for output in plant.outputs)
        return cls(float(aligned.duration), len(aligned.runs), channels, tuple(warnings))


@dataclass(frozen=True)
class Located:
    """Where the gap of the nominal model lies, before anything was fitted.

    Attributes:
        shares: of the gap by subsystem, largest first; they add up to 1.
        candidates: effects that are looked at.
        spoken: effects for which single parts speak by themselves, as (name, site, value).
    """

    shares: dict[str, float]
    candidates: int
    spoken: tuple[Hint, ...]


@dataclass(frozen=True)
class Cause:
    """An effect with its values so far, {parameter: (value, unit)}."""

    effect: str
    site: str
    values: dict[str, tuple[float, str]]


@dataclass(frozen=True)
class Leader:
    """One explanation that was fitted, and what it gains over nominal numbers [nats], with its 90 % interval."""

    effects: str
    gain: float
    low: float
    high: float


@dataclass(frozen=True)
class Leading:
    """What would be answered if it ended now; no ``causes``: that none has earned its place.

    Attributes:
        before, after: held-out gap [noise floors] of the nominal model, and with ``causes``.
        promising: effects that promise most by a linear look at all, best first, before any was fitted.
        leaders: those that were fitted, best first.
    """

    causes: tuple[Cause, ...]
    before: float
    after: float
    promising: tuple[str, ...]
    leaders: tuple[Leader, ...]


@dataclass(frozen=True)
class Decided:
    """The verdict, before free runs have shown how far it carries; fields are as in diagnosis.json."""

    verdict: str
    reasons: tuple[str, ...]
    effects: tuple[dict[str, Any], ...]
    before: float
    after: float

    @classmethod
    def of(cls, report: dict[str, Any]) -> Decided:
        """What a report says of it."""
        gap = report["gap"]
        return cls(report["verdict"], tuple(report["reasons"]), tuple(report["effects"]), gap["before"], gap["after"])


Staged = Checked | Located | Leading | Decided
"""What is told, in this order; `Leading` each time that it changes."""


def located(fitter: Fitter, phases: Phases | None, candidates: int, spoken: Sequence[Hint]) -> Located:
    """Where the gap of the nominal model lies."""
    nominal = fitter.replay(Hypothesis(), [(np.zeros(0), np.zeros(len(fitter.nuisances)))])[0]
    shares: dict[str, float] = {}
    for row in locate(fitter.residuals, nominal, phases):
        name = str(row["subsystem"])
        shares[name] = shares.get(name, 0.0) + float(str(row["share"]))
    return Located(dict(sorted(shares.items(), key=lambda item: -item[1])), candidates, tuple(spoken))


def leading(scores: Scores, found: Selection) -> Leading:
    """What a selection that is not at its end says."""
    reference = found.reference
    leaders: dict[str, Leader] = {}
    contestants = [found.best, *found.rivals, *found.singles]
    for scored in sorted((s for s in contestants if s is not reference), key=lambda s: s.score):
        if scored.key not in leaders and len(leaders) < _LEADERS:
            leaders[scored.key] = Leader(scored.key, *scores.difference(reference.fit, scored.fit))
    screened = dict.fromkeys(Hypothesis((s.effect,)).key for s in found.screened)
    promising = tuple(screened)[:_PROMISING]
    causes = () if found.best is reference else _causes(found.best.fit)
    return Leading(causes, found.nominal_gap, found.best.gap, promising, tuple(leaders.values()))


def _causes(fit: Fit) -> tuple[Cause, ...]:
    values = iter(fit.x.tolist())
    return tuple(
        Cause(e.name, e.site.name, {p.name: (float(next(values)), p.unit) for p in e.parameters})
        for e in fit.hypothesis.effects
    )
