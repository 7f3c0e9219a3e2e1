"""The graded part of the report: how far each step goes, in every measure, and what is left."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from simgap.analysis.agreement import agreement
from simgap.analysis.free_running import FreeRun, Model, free_runs, told
from simgap.analysis.recalibration import calibration
from simgap.analysis.remainder import describe
from simgap.analysis.waterfall import RECALIBRATED, models, steps, waterfall
from simgap.inference.fit import Fitter
from simgap.inference.long_windows import LongWindows
from simgap.inference.scores import Scores
from simgap.inference.selection import Selection

NAMES = ("nominal", RECALIBRATED, "diagnosed", "fit_everything")
"""Models whose free runs are told, as far as they were computed."""


def explain(
    fitter: Fitter,
    scores: Scores,
    selection: Selection,
    report: dict[str, Any],
    seed: int = 0,
    longer: LongWindows | None = None,
    seconds: float | None = None,
    say: Callable[[float], None] = lambda share: None,
) -> tuple[dict[str, Any], list[FreeRun]]:
    """Keys `waterfall`, `calibration`, `agreement`, `remainder` and `free_running` of a report, and the runs drawn.

    ``longer``: the winner's numbers where long windows tell them better; free runs and corrections take those.
    ``seconds`` that the free runs may take, ``say`` is told how far they are.
    ``report`` holds the keys `gap`, `baselines` and `unexplained_predictable_share` of the same selection.
    """
    plant, gap = fitter.residuals.replayer.plant, report["gap"]
    found = steps(fitter, scores, selection, gap["before"], longer)
    run = models(found)
    if everything := report["baselines"].get("fit_everything"):
        run.insert(0, Model.everything(fitter, everything))
    runs = free_runs(fitter, run, seed, seconds, say)
    best = selection.best.fit
    numbers = longer.fit if longer else best
    diagnosed = fitter.variant(best.hypothesis, numbers.x, numbers.z)
    predictable = report["unexplained_predictable_share"]
    keys = {
        "waterfall": waterfall(fitter, found, runs),
        "calibration": calibration(fitter, best, longer),
        "agreement": agreement(fitter, best),
        "remainder": describe(fitter.residuals, diagnosed, best.residual, gap, predictable),
        "free_running": told(runs, plant, [n for n in NAMES if any(m.name == n for m in run)]),
    }
    return keys, runs
