"""Free-running prediction: from the start of a run to its end, never put back to the measurement.

It is what a user of the corrected model gets. The windows of the fit are short and begin at the robot, so that chaos
does not pass for a gap; a steady error shows little in them, and all of it here.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simgap.analysis.errors import by_channel, measured_of
from simgap.data.align import Aligned, Run
from simgap.data.plant import Plant
from simgap.inference.fit import Fitter
from simgap.inference.hypothesis import Fit, Hypothesis
from simgap.inference.stretches import STRETCH
from simgap.simulation.replay import Replayer
from simgap.simulation.variant import Variant
from simgap.simulation.windows import Windows

Array = NDArray[np.float64]
Values = tuple[Array, Array]
"""Parameters of the effects and nuisances."""

MOST_RUNS = 4
"""Runs that are looked at where the map names none: the longest."""
LONGEST = 60.0
"""[s] of a run that are simulated: beyond it a longer simulation says the same again."""
_PILOT, _PASSES = 1.0, 4.0
"""[s] of the first run by which it is seen how long a simulation takes, where there is a limit; and how many times the
models' own runs all takes, with twins and stretches."""
_LOST = 0.2
"""Share of a channel's spread over the recording. A model whose start is off by no more than anybody can measure, and
whose run differs by more than this from that of its twin, says nothing about the robot any more."""
_TWINS = 4


@dataclass(frozen=True)
class Model:
    """A model to run: what was fitted, to all and without each fold.

    ``folds`` are the values of the fits that have not seen a fold. ``fitted`` is False of one that has seen nothing.
    """

    name: str
    hypothesis: Hypothesis
    common: Values
    folds: dict[int, Values] = field(default_factory=dict)
    fitted: bool = True

    @classmethod
    def nominal(cls, fitter: Fitter) -> Model:
        """The model as it was given."""
        return cls("nominal", Hypothesis(), (np.zeros(0), np.zeros(len(fitter.nuisances))), {}, False)

    @classmethod
    def of(cls, name: str, fit: Fit) -> Model:
        """That of a fit that was cross-validated by folds."""
        folds = {f: (x, z) for f, (x, z) in enumerate(zip(fit.fold_x, fit.fold_z, strict=True))}
        return cls(name, fit.hypothesis, (fit.x, fit.z), folds)

    @classmethod
    def everything(cls, fitter: Fitter, report: dict[str, Any]) -> Model:
        """That of the baseline that frees every number, which has not seen one fold."""
        z = np.array([report["parameters"].get(n.name, 0.0) for n in fitter.nuisances])
        values = (np.zeros(0), z)
        return cls("fit_everything", Hypothesis(), values, {int(str(report["held_out"]).split()[-1]): values})

    def values(self, fold: int | None) -> tuple[Values, bool]:
        """Values for a run, and whether their fit has seen it; ``fold`` is the run's, None of one in several."""
        if fold is not None and fold in self.folds:
            return self.folds[fold], False
        return self.common, self.fitted


@dataclass
class FreeRun:
    """One run, by every model.

    Attributes:
        label: the run's number in the recording.
        name: what the recording calls it.
        time: (nw, ns) [s] since the recording began; nw is 1 unless the run is cut into stretches.
        measured: (nw, ns, no), NaN where nothing was measured.
        simulated: {model: (nw, ns, no)}, NaN of a simulation that broke down.
        seen: {model: whether its fit has seen this run}.
        start_error: {channel: value}: how far the run of a model ends from its own, where its start is off by what the
            sensors leave open.
        whole: {model: {channel: error over the whole run}} where it is cut into stretches, else empty.
        cut_short: whether the run goes on after what was simulated.
    """

    label: float
    name: str
    time: Array
    measured: Array
    simulated: dict[str, Array]
    seen: dict[str, bool]
    start_error: dict[str, float]
    whole: dict[str, dict[str, float]]
    cut_short: bool

    @property
    def duration(self) -> float:
        """[s] that were simulated."""
        return float(self.time[-1, -1] - self.time[0, 0])

    @property
    def chaotic(self) -> bool:
        """Whether the run is cut into stretches."""
        return bool(self.whole)

    def error(self, plant: Plant, model: str) -> dict[str, float]:
        """Root mean square error {channel: value in its unit}."""
        return by_channel(plant, self.measured, self.simulated[model])

    def broke_down(self, model: str) -> bool:
        """Whether MuJoCo gave up somewhere in the run."""
        return bool(np.isnan(self.simulated[model]).any())


def free_runs(
    fitter: Fitter,
    models: Sequence[Model],
    seed: int = 0,
    seconds: float | None = None,
    say: Callable[[float], None] = lambda share: None,
) -> list[FreeRun]:
    """Run ``models`` free over the runs that are held out, else over the longest that were scored.

    The last model judges whether a run is longer than the robot remembers its start.

    Args:
        fitter: of the diagnosis.
        models: what is run.
        seed: of the twins' starts.
        seconds: that this may take; of longer runs the beginning is simulated. None: no limit.
        say: is told how far it is.
    """
    runs = chosen_runs(fitter.residuals.replayer.aligned)
    longest = LONGEST if seconds is None else _affordable(fitter, models, runs, seconds)
    found = []
    for i, run in enumerate(runs):
        say(i / len(runs))
        found.append(_free_run(fitter, models, run, seed, longest))
    return found


def _affordable(fitter: Fitter, models: Sequence[Model], runs: Sequence[Run], seconds: float) -> float:
    """[s] of each run that can be simulated in so many seconds, at least _PILOT."""
    base = fitter.residuals.replayer
    first = max(runs, key=lambda r: r.stop - r.start)
    begin, stop = _ends(base, first, _PILOT)
    started = time.monotonic()
    pilot = _replayer(base, begin, stop, stop - begin)
    pilot.run([fitter.variant(m.hypothesis, *m.common) for m in models])
    price = (time.monotonic() - started) / ((stop - begin) * base.aligned.period)
    return float(np.clip(seconds / (_PASSES * len(runs) * price), _PILOT, LONGEST))


def _ends(base: Replayer, run: Run, longest: float) -> tuple[int, int]:
    """First row of a run that is scored, and the row after the last, of at most ``longest`` seconds."""
    begin = run.start + base.windows.warm_up
    return begin, min(run.stop, begin + round(longest / base.aligned.period))


def chosen_runs(aligned: Aligned) -> list[Run]:
    """The runs that the map keeps for scoring; where it names none the longest, in their order."""
    held = [run for run in aligned.runs if run.label in aligned.held_out]
    if held:
        return held
    longest = sorted(aligned.runs, key=lambda r: r.start - r.stop)[:MOST_RUNS]
    return sorted(longest, key=lambda r: r.start)


def fold_of(windows: Windows, run: Run) -> int | None:
    """The fold of all windows of a run; None where they lie in several, or are only fitted."""
    inside = (windows.start >= run.start) & (windows.start < run.stop)
    folds = {int(f) for f in windows.fold[inside]}
    return next(iter(folds)) if len(folds) == 1 and folds != {-1} else None


def _free_run(fitter: Fitter, models: Sequence[Model], run: Run, seed: int, longest: float) -> FreeRun:
    base = fitter.residuals.replayer
    period, plant, fold = base.aligned.period, base.plant, fold_of(base.windows, run)
    begin, stop = _ends(base, run, longest)
    variants, seen = [], {}
    for model in models:
        (x, z), seen[model.name] = model.values(fold)
        variants.append(fitter.variant(model.hypothesis, x, z, _moment(base.windows, period, begin, stop)))
    whole = _replayer(base, begin, stop, stop - begin)
    measured, simulated = measured_of(whole), whole.run(variants)
    start_error = _start_error(whole, variants[-1], simulated[-1], seed)
    spread = dict(zip((c.name for c in plant.outputs), base.aligned.outputs.std(axis=0), strict=True))
    told = by_channel(plant, measured, simulated[-1])
    start_error = {name: start_error.get(name, float("nan")) for name in told}
    lost = bool(np.isnan(simulated[-1]).any()) or any(e > _LOST * spread[name] for name, e in start_error.items())
    replayer, errors = whole, {}
    if lost and stop - begin > 1.5 * STRETCH / period:
        replayer = _replayer(base, begin, stop, round(STRETCH / period))
        for model, outputs in zip(models, simulated, strict=True):
            errors[model.name] = by_channel(plant, measured, outputs)
        measured, simulated = measured_of(replayer), replayer.run(variants)
    return FreeRun(
        run.label,
        run.name,
        base.aligned.time[replayer.windows.rows()],
        measured,
        {m.name: s for m, s in zip(models, simulated, strict=True)},
        seen,
        start_error,
        errors,
        run.stop > stop,
    )


def _replayer(base: Replayer, begin: int, stop: int, length: int) -> Replayer:
    """One that runs from row ``begin`` up to ``stop`` in stretches of ``length`` rows."""
    start = np.arange(begin, stop - length + 1, length, dtype=np.int64)
    none = np.zeros(len(start), np.int64)
    windows = Windows(start, base.windows.warm_up, length, np.arange(length, dtype=np.int64), none, none)
    return Replayer(base.plant, base.aligned, windows, base.floor, base.threads)


def _moment(windows: Windows, period: float, begin: int, stop: int) -> float:
    """[s] of the middle of a run after that of what was fitted, for effects that grow."""
    middle = windows.start + 0.5 * windows.length
    return float((0.5 * (begin + stop) - 0.5 * (middle.min() + middle.max())) * period)


def _start_error(replayer: Replayer, variant: Variant, outputs: Array, seed: int) -> dict[str, float]:
    """How far twins of a run that begin where the sensors would have it as well go away from it, by channel."""
    plant, state = replayer.plant, replayer.state
    if not state.size:
        return {c.name: 0.0 for c in plant.outputs}
    rng, none = np.random.default_rng(seed), np.zeros(_TWINS, np.int64)
    shift, rate = (sd * rng.standard_normal((_TWINS, state.size)) for sd in state.start_sd)
    twins = replayer.run_pairs([variant], none, none, shift, rate)  # (twins, ns, no); outputs (1, ns, no)
    return by_channel(plant, outputs, twins)


# -- what is told ------------------------------------------------------------------------------------------------------


def pooled(runs: Sequence[FreeRun], plant: Plant, model: str) -> dict[str, float]:
    """Error {channel: value in its unit} of a model over all runs."""
    if not runs:
        return {}
    count = len(plant.outputs)
    measured, simulated = (
        np.concatenate([a.reshape(-1, count) for a in arrays])
        for arrays in ([r.measured for r in runs], [r.simulated[model] for r in runs])
    )
    return by_channel(plant, measured, simulated)


def told(runs: Sequence[FreeRun], plant: Plant, names: Sequence[str]) -> list[dict[str, Any]]:
    """``free_running`` of the report: one row for each run and model."""
    units = {c.name: c.unit for c in plant.outputs}
    rows: list[dict[str, Any]] = []
    for run in runs:
        for name in names:
            row: dict[str, Any] = {
                "run": run.label,
                "name": run.name,
                "model": name,
                "rmse": run.error(plant, name),
                "unit": units,
                "duration_s": run.duration,
                "cut_short": run.cut_short,
                "fitted_on_it": run.seen[name],
                "broke_down": run.broke_down(name),
                "start_error": run.start_error,
                "stretch_s": None,
            }
            if run.chaotic:
                row |= {"stretch_s": STRETCH, "rmse_whole_run": run.whole[name]}
            if notes := _notes(run, name):
                row["note"] = "; ".join(notes)
            rows.append(row)
    return rows


def _notes(run: FreeRun, name: str) -> list[str]:
    notes = []
    if run.chaotic:
        notes.append(
            "an error of the start that no sensor shows grows to a good part of the motion, or the model breaks down "
            f"on the way: the run is begun anew at the measurement every {STRETCH:g} s"
        )
    if run.cut_short:
        notes.append(f"the first {run.duration:.3g} s of the run")
    if run.broke_down(name):
        notes.append("the simulation broke down; its error is that of what it left, or null")
    return notes
