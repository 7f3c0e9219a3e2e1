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

_SHARE = 0.5
"""Of a budget, for what was well."""


def learn(recordings: Sequence[Recording], plant: Plant, options: Options) -> Healthy:
    """What is constant about a robot: nominal numbers, causes, and what nothing explains.

    Raises:
        GapInputError: the recordings cannot be used.
    """
    budget = Budget(None if options.budget is None else _SHARE * options.budget)
    own = replace(
        options, reference=(), staged=None, progress=lambda stage, share: options.say(f"reference: {stage}", share)
    )
    found = search(recordings, plant, own, budget)
    best, scores = found.selection.best, found.selector.scores
    report = {
        "recordings": len(recordings),
        "duration_s": found.aligned.duration,
        "gap": {"before": found.selection.nominal_gap, "after": best.gap},
        "typical": scores.typical(best.fit.held),
        "constant": [effect.key for effect in best.fit.hypothesis.effects],
        "warnings": found.warnings,
    }
    made = healthy(found.fitter, best.fit, report)
    made.report["floors"] = {
        output.name: float(scale) for output, scale in zip(found.plant.outputs, made.scale, strict=True)
    }
    return made
