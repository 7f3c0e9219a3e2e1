"""The whole diagnosis: from recordings and a nominal model to a verdict and its evidence."""

from __future__ import annotations

import json
import platform
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

import simgap
from simgap.analysis.experiment import GenericMenu, Menu
from simgap.analysis.explanation import explain
from simgap.analysis.free_running import LONGEST, FreeRun
from simgap.analysis.isolability import confusion, isolability
from simgap.analysis.localisation import bands, locate
from simgap.analysis.next_experiment import Proposal, propose
from simgap.analysis.options import Options
from simgap.analysis.reference import learn
from simgap.analysis.search import search
from simgap.analysis.stages import Decided
from simgap.data.align import Aligned
from simgap.data.excitation import NOTHING_MOVED, ONE_POSE, excited
from simgap.data.plant import Plant
from simgap.data.recording import Recording
from simgap.inference.baselines import best_in_sample, fit_everything
from simgap.inference.budget import LONG_WINDOWS, PROPOSAL, Budget, OutOfTimeError
from simgap.inference.decision import names
from simgap.inference.deviations import NORMAL_90, parameter_deviation
from simgap.inference.fit import Fitter
from simgap.inference.hypothesis import Fit, Hypothesis
from simgap.inference.long_windows import LongWindows, refit
from simgap.inference.nuisance import BOX
from simgap.inference.select import Selector
from simgap.inference.selection import Selection
from simgap.inference.stochastic_link import PATTERN
from simgap.inference.structure import REPEATS, predictable_share, repeating_share
from simgap.inference.verdict import Verdict, judge, written

Array = NDArray[np.float64]

SCHEMA = "nermo_gap/diagnosis/1"


@dataclass
class Diagnosis:
    """Everything that was found; ``report`` is diagnosis.json; ``proposal`` is None where nothing is open or safe."""

    verdict: Verdict
    selection: Selection
    selector: Selector
    aligned: Aligned
    report: dict[str, Any]
    proposal: Proposal | None = None
    menu: Menu | None = None
    """Where the proposal comes from."""
    runs: list[FreeRun] = field(default_factory=list)
    """Free runs of the models of the waterfall."""
    longer: LongWindows | None = None
    """The winner's numbers, where long windows tell them better."""

    @property
    def numbers(self) -> Fit:
        """The winner with the numbers that are reported."""
        return self.longer.fit if self.longer else self.selection.best.fit

    @property
    def plant(self) -> Plant:
        """What was diagnosed, as it was replayed."""
        return self.selector.fitter.residuals.replayer.plant


def diagnose(recordings: Sequence[Recording], plant: Plant, options: Options | None = None) -> Diagnosis:
    """Diagnose the gap between recordings and the nominal model.

    Raises:
        GapInputError: the recordings cannot be used, or contradict the map.
    """
    options = options or Options()
    started = time.monotonic()
    budget = Budget(options.budget, started, hurry=options.hurry)
    options.say("align", 0.0)
    well = []
    if options.reference:
        well = learn(options.reference, plant, options)
        budget = budget.rest()
    found = search(recordings, plant, options, budget, well)
    plant, aligned, fitter, selector, selection = (
        found.plant,
        found.aligned,
        found.fitter,
        found.selector,
        found.selection,
    )
    floor, residuals, warnings = found.floor, fitter.residuals, found.warnings
    options.say("decision", 0.0)
    verdict = judge(selector, selection)
    if found.beside and found.beside.unlike and verdict.kind in ("effect", "ambiguous", "partial"):
        verdict.kind = "unknown"
        verdict.reasons = [f"{found.beside.unlike}, so what shows there may always have been so", *verdict.reasons]
    structure = predictable_share(residuals, selection.best.fit.residual, options.seed)
    if verdict.kind != "unknown" and not excited(plant, aligned, floor):
        quiet = verdict.kind in ("no_gap", "calibration")
        verdict.kind, verdict.reasons = "unknown", [NOTHING_MOVED if quiet else ONE_POSE]
        verdict.open = [*(s.fit for s in selection.singles[:2]), selection.reference.fit]
    if verdict.kind in ("unknown", "partial"):
        share, frequency = repeating_share(residuals, selection.best.fit.residual)
        # A gait repeats too, and with it whatever is wrong with it; commands and motion predict that.
        if share > REPEATS and structure < PATTERN:
            verdict.reasons.append(
                f"{100 * share:.0f} % of what is left comes back about {frequency:.2g} times a second, and commands "
                "and motion do not predict it: look for a fan, a gear, a belt or a neighbour"
            )
    watched = budget.watch(options.progress)
    proposal = None
    try:
        with budget.until(PROPOSAL):
            watched("next experiment", 0.0)
            proposal = propose(
                fitter, verdict.open, options.menu, options.seed, lambda share: watched("next experiment", share)
            )
    except OutOfTimeError as spent:
        budget.ended(str(spent))
    longer = None
    # Where no effect acts, nominal numbers within their tolerances are the answer: it is not told with others.
    told = selection.best is not selection.reference and verdict.kind != "unknown"
    if told:
        try:
            with budget.until(LONG_WINDOWS):
                longer = refit(fitter, selection.best.fit, lambda share: watched("long windows", share))
        except OutOfTimeError as spent:
            budget.ended(str(spent))
    report = _report(aligned, floor, selector, selection, verdict, structure, options, longer)
    options.tell(Decided.of(report))
    keys, runs = explain(
        fitter,
        selector.scores,
        selection,
        report,
        options.seed,
        longer,
        budget.remaining(),
        lambda share: options.say("free runs", share),
    )
    report |= keys
    if budget.limited and any(r.cut_short and r.duration < 0.9 * LONGEST for r in runs):
        budget.left_out.append("of whole runs only the beginning was simulated")
    report["borders"] = [*(b.told() for b in found.near), *(r.told() for r in found.rates)]
    report["torque_balance"] = [b.told() for b in found.balances]
    report["reference"] = found.beside.healthy.report if found.beside else None
    report["next_experiment"] = proposal.report() if proposal else None
    report["warnings"] = warnings + [
        w for w in (timing_at_its_limit(selection.best.fit, fitter), odd_timing(longer, fitter), budget.warning()) if w
    ]
    report["unfinished"] = budget.warning()
    report["time_step_s"] = float(plant.model.opt.timestep)
    report["replayed_s"] = residuals.replayer.simulated_seconds
    report["wall_s"] = time.monotonic() - started
    return Diagnosis(verdict, selection, selector, aligned, report, proposal, options.menu, runs, longer)


def timing_at_its_limit(fit: Fit, fitter: Fitter) -> str:
    """A word on inputs whose timing sits where its tolerance ends; empty where it does not."""
    for nuisance, z in zip(fitter.nuisances, fit.z, strict=True):
        if nuisance.name == "timing of inputs" and abs(z) > 0.999 * BOX:
            late = nuisance.described().value(float(z))
            return (
                f"the timing of inputs sits at its limit ({1e3 * late:+.0f} ms): commands may act "
                f"{'later' if late > 0 else 'earlier'} than their stamps by more than that; look at the clocks, and at "
                "link_latency and servo_delay"
            )
    return ""


def odd_timing(longer: LongWindows | None, fitter: Fitter) -> str:
    """A word on inputs whose timing long windows put beyond any tolerance; empty where they do not."""
    if longer is None:
        return ""
    for nuisance, z in zip(fitter.nuisances, longer.fit.z, strict=True):
        if nuisance.name == "timing of inputs" and abs(z) > BOX:
            late = nuisance.described().value(float(z))
            return (
                f"whole runs are followed best where inputs act {1e3 * abs(late):.0f} ms "
                f"{'after' if late > 0 else 'before'} their stamps: that may stand for something that is missing in "
                "the model (a command that is smoothed on its way); look at the clocks before you use it"
            )
    return ""


def _report(
    aligned: Aligned,
    floor: Array,
    selector: Selector,
    selection: Selection,
    verdict: Verdict,
    structure: float,
    options: Options,
    longer: LongWindows | None,
) -> dict[str, Any]:
    fitter, best = selector.fitter, selection.best
    residuals, plant = fitter.residuals, fitter.residuals.replayer.plant
    nominal = fitter.replay(Hypothesis(), [(np.zeros(0), np.zeros(len(fitter.nuisances)))])[0]
    windows = fitter.windows
    contenders = [best.fit, *(s.fit for s in [*selection.rivals, *selection.singles]), selection.reference.fit]
    return {
        "schema": SCHEMA,
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "seed": options.seed,
        "robot": mujoco.mj_id2name(plant.model, mujoco.mjtObj.mjOBJ_MODEL, 0) or _model_name(plant),
        "versions": {"simgap": simgap.__version__, "mujoco": mujoco.__version__, "python": platform.python_version()},
        "verdict": verdict.kind,
        "reasons": verdict.reasons,
        "probabilities": _probabilities(verdict),
        "evidence": _evidence(verdict),
        "gap": _gap(selector, selection, fitter.mean_square(nominal)),
        "where": locate(residuals, nominal, options.phases),
        "left": locate(residuals, best.fit.residual, options.phases),
        "frequency": bands(residuals, nominal),
        "effects": _effects(selector, selection, longer),
        "long_windows": longer.told() if longer else None,
        "ranking": [
            {"hypothesis": s.key, "score": s.score, "gap": s.gap, "prior": s.fit.prior} for s in selection.singles
        ],
        "rejected": _rejected(selection, selector.scores.unit),
        "equivalent": verdict.equivalent,
        "isolability": isolability(selection.screened, [e.key for e in best.fit.hypothesis.effects])
        | {"rivals_deg": verdict.angles, "confusion": confusion(fitter, contenders, options.seed)},
        "unexplained_predictable_share": structure,
        "nuisances": {n.name: float(z) for n, z in zip(fitter.nuisances, best.fit.z, strict=True) if abs(z) > 0.05},
        "corrects": _corrects(selector, selection),
        "baselines": _baselines(fitter, selector, selection, options),
        "next_experiment": None,
        "heldout": {
            "folds": windows.folds,
            "windows": len(windows),
            "blocks": len(np.unique(windows.block)),
            "horizon_s": windows.length * aligned.period,
            "warm_up_s": windows.warm_up * aligned.period,
            "runs": len(aligned.runs),
            "given": list(aligned.held_out),
        },
        "noise_floor": {plant.outputs[i].name: float(floor[i]) for i in range(len(floor))},
    }


def _corrects(selector: Selector, selection: Selection) -> dict[str, Any] | None:
    """What the model before its correction leaves of this recording, its numbers fitted; None of one that has none."""
    before, scores = selection.before, selector.scores
    if before is None:
        return None
    typical = {
        "before": scores.typical(before.fit.held),
        "nuisances_only": scores.typical(selection.reference.fit.held),
    }
    return {
        "gap": {"before": before.gap, "nuisances_only": selection.reference.gap},
        "typical": typical,
        "explained": written(scores, selection),
        "gain": scores.written,
        "gain_unit": scores.unit,
    }


def _rejected(selection: Selection, unit: str) -> dict[str, Any] | None:
    """The best further effect that did not earn its place; None where none was looked for."""
    if selection.rejected is None:
        return None
    names, gain, asked = selection.rejected
    return {"effects": names.split(" + "), "gap_gain": gain, "asked": asked, "unit": unit}


def _probabilities(verdict: Verdict) -> dict[str, float]:
    """Of the verdict, and of every set of causes that was kept."""
    sets = {" + ".join(sorted(c.names)) or "nominal numbers": c.probability for c in verdict.classes}
    return {verdict.kind: verdict.sure, **{key: p for key, p in sets.items() if p > 1e-4}}


def _evidence(verdict: Verdict) -> dict[str, Any] | None:
    """What the probabilities rest on, with the effects that each answer names."""
    if verdict.evidence is None:
        return None
    return verdict.evidence.told() | {"effects": [[sorted(names(f)) for f in c.fits] for c in verdict.classes]}


def _model_name(plant: Plant) -> str:
    return plant.model.names[: plant.model.names.index(b"\0")].decode() or "unnamed"


def _interval(values: Array) -> list[float]:
    low, high = np.percentile(values, [5, 95])
    return [float(low), float(high)]


def _gap(selector: Selector, selection: Selection, nominal: Array) -> dict[str, Any]:
    before = selector.scores.gaps(nominal)
    after = selector.scores.gaps(selection.best.fit.held)
    reference = selector.scores.gaps(selection.reference.fit.held)
    by_channel = {}
    for c, name in enumerate(selector.fitter.residuals.channels):
        weight = selector.scores.draws[0] * selector.fitter.recorded[:, c]
        square = np.nan_to_num(np.stack([nominal[:, c], selection.best.fit.held[:, c]])) @ weight
        # A channel that no held-out window recorded has no gap.
        earlier, later = np.sqrt(square / max(weight.sum(), 1.0))
        by_channel[name] = {"before": float(earlier), "after": float(later)}
    return {
        "before": float(before[0]),
        "after": float(after[0]),
        "shrink": float(1.0 - after[0] / before[0]),
        "ci90": _interval(1.0 - after[1:] / before[1:]),
        "nuisances_only": float(reference[0]),
        "typical": {
            "before": selector.scores.typical(nominal),
            "nuisances_only": selector.scores.typical(selection.reference.fit.held),
            "after": selector.scores.typical(selection.best.fit.held),
        },
        "by_channel": by_channel,
    }


def _effects(selector: Selector, selection: Selection, longer: LongWindows | None) -> list[dict[str, Any]]:
    best, reference = selection.best, selection.reference
    if best is reference:
        return []
    found, position = [], 0
    plant = selector.fitter.residuals.replayer.plant
    fit = longer.fit if longer else best.fit
    deviation = parameter_deviation(fit, float(plant.model.opt.timestep), selector.scores.roughness)
    for i, effect in enumerate(best.fit.hypothesis.effects):
        parameters = {}
        for parameter in effect.parameters:
            value, sd = float(fit.x[position]), float(deviation[position])
            parameters[parameter.name] = {
                "value": value,
                "unit": parameter.unit,
                "ci90": [max(value - NORMAL_90 * sd, parameter.low), min(value + NORMAL_90 * sd, parameter.high)],
            } | ({"part": parameter.part} if parameter.part else {})
            position += 1
        mean, low, high = selection.gains[min(i, len(selection.gains) - 1)]
        entry: dict[str, Any] = {
            "name": effect.name,
            "site": effect.site.name,
            "parameters": parameters,
            "gap_gain": mean,
            "ci90": [low, high],
            "gap_gain_unit": selector.scores.unit,
        }
        if effect.form:
            entry["form"] = effect.form
        found.append(entry)
    return found


def _baselines(fitter: Fitter, selector: Selector, selection: Selection, options: Options) -> dict[str, Any]:
    found: dict[str, Any] = {
        "nominal": {"gap": selection.nominal_gap, "ci90": _interval(selector.scores.gaps(selector.nominal_square)[1:])},
        "best_in_sample": best_in_sample(selector, selection.singles, selection.reference),
        "fit_everything": None,
    }
    if options.baselines and not selector.budget.spent(LONG_WINDOWS):
        found["fit_everything"] = fit_everything(fitter, seed=options.seed)
    return found


def write_experiment(found: Diagnosis, folder: str | Path, menu: Menu | None = None) -> Path | None:
    """Write the command file of the proposed experiment into a folder, and its name into the report."""
    if found.proposal is None:
        return None
    path = (menu or GenericMenu()).write(found.proposal.experiment, found.plant, Path(folder) / "next_experiment")
    found.report["next_experiment"]["file"] = path.name
    return path


def write_report(report: dict[str, Any], path: str | Path) -> None:
    """Write diagnosis.json; a number that could not be computed is null, so that minutes of work are not lost."""
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    Path(path).write_text(json.dumps(_finite(report), indent=2, allow_nan=False) + "\n", encoding="utf-8")


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _finite(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(v) for v in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value
