"""From the nominal model to what remains, step by step: nominal numbers, then one cause after the other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simgap.analysis.errors import by_channel, measured_of
from simgap.analysis.free_running import FreeRun, Model, pooled
from simgap.inference.fit import Fitter
from simgap.inference.hypothesis import Fit, Hypothesis
from simgap.inference.long_windows import LongWindows
from simgap.inference.scores import Scores
from simgap.inference.selection import Selection

Array = NDArray[np.float64]

RECALIBRATED, DIAGNOSED = "recalibrated", "diagnosed"


@dataclass(frozen=True)
class Step:
    """One bar: its name, its held-out gap in noise floors, and the model that leaves it."""

    name: str
    gap: float
    model: Model


def steps(
    fitter: Fitter, scores: Scores, selection: Selection, nominal_gap: float, longer: LongWindows | None = None
) -> list[Step]:
    """Nominal, recalibrated, and the causes in the order in which they were found; the last leaves `gap.after`.

    The last has the numbers of long windows, where they tell them better.

    Causes before it are fitted without those that follow, with all nominal numbers anew.
    """
    found = [Step("nominal", nominal_gap, Model.nominal(fitter))]
    reference, best = selection.reference.fit, selection.best.fit
    found.append(Step(RECALIBRATED, float(scores.gaps(reference.held)[0]), Model.of(RECALIBRATED, reference)))
    effects = best.hypothesis.effects
    for count in range(1, len(effects) + 1):
        last = count == len(effects)
        fit = best if last else _without_later(fitter, selection, count)
        key = f"{effects[count - 1].name}@{effects[count - 1].site.name}"
        numbers = longer.fit if last and longer else fit
        found.append(Step(key, float(scores.gaps(fit.held)[0]), Model.of(DIAGNOSED if last else key, numbers)))
    return found


def _without_later(fitter: Fitter, selection: Selection, count: int) -> Fit:
    """The first ``count`` effects of the best hypothesis alone."""
    best = selection.best.fit
    hypothesis = Hypothesis(best.hypothesis.effects[:count])
    known = {scored.key: scored.fit for scored in [*selection.rivals, *selection.singles]}
    if (fit := known.get(hypothesis.key)) is not None and len(fit.held):
        return fit
    fit = fitter.fit(hypothesis, best.x[: hypothesis.size], best.z)
    return fitter.cross_validate(fit)


def models(found: Sequence[Step]) -> list[Model]:
    """The models of all steps, once each; the last is the diagnosed one (the recalibrated, where there is no cause)."""
    last = found[-1].model
    return [s.model for s in found] if last.name == DIAGNOSED else [*(s.model for s in found), _renamed(last)]


def _renamed(model: Model) -> Model:
    return Model(DIAGNOSED, model.hypothesis, model.common, model.folds, model.fitted)


def waterfall(fitter: Fitter, found: Sequence[Step], runs: Sequence[FreeRun]) -> list[dict[str, Any]]:
    """``waterfall`` of the report: each step's gap [noise floors], window and free-running error [channel's unit]."""
    plant = fitter.residuals.replayer.plant
    rows: list[dict[str, Any]] = []
    for step in found:
        error, broken = _in_windows(fitter, step.model)
        rows.append(
            {
                "step": step.name,
                "gap": step.gap,
                "rmse": error,
                "free_running": pooled(runs, plant, step.model.name),
                "windows_broken": broken,
            }
        )
    # What the last step leaves has a bar of its own.
    return [*rows, rows[-1] | {"step": "remainder"}]


def _in_windows(fitter: Fitter, model: Model) -> tuple[dict[str, float], int]:
    """Error by channel in the held-out windows, each by the fit that has not seen it; how many of them broke down."""
    replayer, fold = fitter.residuals.replayer, fitter.windows.fold
    held = np.flatnonzero(fold >= 0)
    folds = sorted(set(fold[held].tolist()))
    which = np.searchsorted(folds, fold[held])
    values = [model.values(f)[0] for f in folds]
    if model.hypothesis.grows:
        # The model of every window is that of its moment.
        middle = fitter.windows.start[held] + 0.5 * fitter.windows.length
        moments = (middle - 0.5 * (middle.min() + middle.max())) * replayer.aligned.period
        each = [(*values[w], float(m)) for w, m in zip(which, moments, strict=True)]
        variants = [fitter.variant(model.hypothesis, x, z, moment) for x, z, moment in each]
        which = np.arange(len(held))
    else:
        variants = [fitter.variant(model.hypothesis, x, z) for x, z in values]
    simulated = replayer.run(variants, held, which[None, :])[0]
    broken = np.isnan(simulated).all(axis=(1, 2))
    return by_channel(replayer.plant, measured_of(replayer)[held], simulated), int(broken.sum())
