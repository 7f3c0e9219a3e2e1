"""Learning from recordings of the robot when it was well."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from simgap.analysis.options import Options
from simgap.analysis.search import search
from simgap.data.plant import Plant
from simgap.data.recording import Recording
from simgap.inference.budget import Budget
from simgap.inference.healthy import Healthy, healthy
from simgap.inference.scores import Scored
from simgap.inference.selection import Selection
from simgap.simulation.windows import light

_SHARE = 0.5
"""Of a budget, for what was well."""
_BASES, _OF_HEAVY = 5, 2
"""Explanations of the healthy robot among which a new recording may choose, at most; of a model that is heavy."""
_NEAR = 0.25
"""Share of what the best of them gains over nominal numbers alone, by which another may do worse; `_NATS` at least."""
_NATS = 10.0


def learn(recordings: Sequence[Recording], plant: Plant, options: Options) -> list[Healthy]:
    """What is constant about a robot: nominal numbers, causes, and what nothing explains.

    The best explanation first, then those that are nearly as good: what a reference cannot tell apart a new recording
    may, and then it is not the robot that has changed.

    Raises:
        GapInputError: the recordings cannot be used.
    """
    seconds = None if options.budget is None else _SHARE * options.budget
    budget = Budget(seconds, hurry=options.hurry)
    own = replace(
        options, reference=(), staged=None, progress=lambda stage, share: options.say(f"reference: {stage}", share)
    )
    found = search(recordings, plant, own, budget)
    made = []
    for scored in _nearly_as_good(found.selection)[: _BASES if light(plant.model) else _OF_HEAVY]:
        report = {
            "recordings": len(recordings),
            "duration_s": found.aligned.duration,
            "gap": {"before": found.selection.nominal_gap, "after": scored.gap},
            "typical": found.selector.scores.typical(scored.fit.held),
            "constant": [effect.key for effect in scored.fit.hypothesis.effects],
            "warnings": found.warnings,
        }
        made.append(healthy(found.fitter, scored, report))
        made[-1].report["floors"] = {
            output.name: float(scale) for output, scale in zip(found.plant.outputs, made[-1].scale, strict=True)
        }
    return made


def _nearly_as_good(selection: Selection) -> list[Scored]:
    """The winner, and what comes near it, by name once."""
    best = selection.best
    most = best.score + max(_NATS, _NEAR * (selection.reference.score - best.score))
    others = sorted([*selection.rivals, *selection.singles, selection.reference], key=lambda s: s.score)
    known = {s.key: s for s in reversed([best, *others]) if s.fit.likelihood is None and s.score <= most}
    return sorted(known.values(), key=lambda s: (s is not best, s.score))
