"""A diagnosis made into files: the corrected model, the wrapper for what no MJCF holds, and ranges to train on."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from simgap.correction import signals as signals_module
from simgap.correction.changes import Change, Correction, Signal, correction
from simgap.correction.known_map import write_map
from simgap.correction.mjcf import write_mjcf
from simgap.data.errors import GapInputError
from simgap.data.plant import load_model
from simgap.inference.fit import Fitter
from simgap.inference.hypothesis import Fit
from simgap.simulation.variant import Variant

NOTHING = 0.05
"""A nominal number that moved by less than this share of its tolerance stays as it is (diagnosis.json does not name it
either)."""


@dataclass(frozen=True)
class Applied:
    """What became of a correction.

    Attributes:
        written: changes that stand in the model.
        kept_text: whether the model's own text was kept.
        wrapped: signals that the wrapper holds.
        mapped: signals that the map alone holds.
        notes: what no file holds, each with its number and why.
        wrapper: the wrapper's file, or None where it would hold nothing.
        map: the corrected model's map, or None where none was asked for.
    """

    written: tuple[Change, ...]
    kept_text: bool
    wrapped: tuple[Signal, ...]
    mapped: tuple[Signal, ...]
    notes: tuple[str, ...]
    wrapper: Path | None
    map: Path | None = None


def diagnosed(fitter: Fitter, fit: Fit, intervals: list[dict[str, Any]]) -> Correction:
    """The correction of a fit. ``intervals`` are the diagnosis's `effects`, whose `ci90` give each number its range."""
    plant = fitter.residuals.replayer.plant
    z = np.where(np.abs(fit.z) > NOTHING, fit.z, 0.0)
    best = fitter.variant(fit.hypothesis, fit.x, z)
    spread: list[Variant] = []
    bounds = [p["ci90"] for effect in intervals for p in effect["parameters"].values()]
    if len(bounds) == len(fit.x):
        for i, ends in enumerate(bounds):
            for end in ends:
                x = np.array(fit.x, float)
                x[i] = end
                spread.append(fitter.variant(fit.hypothesis, x, z))
    return correction(plant, best, spread)


def read_diagnosis(path: Path, corrected: bool = True) -> dict[str, Any]:
    """A diagnosis.json, or that in a diagnosis's folder; ``corrected``: one that says what becomes of the model.

    Raises:
        GapInputError: it cannot be read, is no diagnosis, or was written without the correction that is asked for.
    """
    path = path / "diagnosis.json" if path.is_dir() else path
    try:
        report = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise GapInputError(f"{path}: cannot be read ({error.strerror})") from error
    except ValueError as error:
        raise GapInputError(f"{path}: is not JSON ({error}); give the diagnosis.json of `simgap diagnose`") from error
    if not isinstance(report, dict) or "diagnosis" not in str(report.get("schema", "")):
        raise GapInputError(f"{path}: schema: is no diagnosis.json of `simgap diagnose`")
    if corrected and "correction" not in report:
        raise GapInputError(
            f"{path}: correction: is missing, as in files of older versions; run `simgap diagnose` again"
        )
    if corrected:
        try:
            Correction.of(report["correction"])
        except (KeyError, TypeError, AttributeError) as error:
            raise GapInputError(
                f"{path}: correction: is not what `simgap diagnose` writes there; run it again"
            ) from error
    found: dict[str, Any] = report
    return found


def apply(
    report: dict[str, Any], model: Path, out: Path, wrapper: Path, map_: tuple[Path, Path] | None = None
) -> Applied:
    """Write the corrected model to ``out`` and, where it is needed, the wrapper.

    ``map_``: the map of the diagnosis, and where to write that of the corrected model.

    Raises:
        GapInputError: the model is not the one that was diagnosed, or a file cannot be written.
    """
    found = Correction.of(report["correction"])
    delays = _delays(found, load_model(model))
    changes = [*found.changes, *(change for change, _ in delays)]
    written = write_mjcf(model, changes, out)
    left = set(written.left_out)
    in_model = {signal for change, signal in delays if change not in left}
    notes = [
        f"{c.sentence} (the model's file did not take it)" for c in changes if c in left and c.attribute != "delay"
    ]
    notes += [
        f"{name} of the compiled model differs too, and no MJCF attribute is known for it" for name in found.unnamed
    ]
    reasons = {s: why for s in found.signals if s not in in_model and (why := _of_the_log(s))}
    wrapped = tuple(s for s in found.signals if s not in in_model and s not in reasons)
    if map_ is None:
        notes += [f"{signal.sentence} ({why})" for signal, why in reasons.items()]
    if wrapped:
        _write_wrapper(wrapper, wrapped, out)
    if map_ is not None:
        write_map(map_[0], [s for s in found.signals if s not in in_model], map_[1], model, out)
    kept = tuple(c for c in changes if c not in left)
    made = wrapper if wrapped else None
    mapped = tuple(reasons) if map_ is not None else ()
    return Applied(kept, written.kept_text, wrapped, mapped, tuple(notes), made, map_[1] if map_ else None)


def _of_the_log(signal: Signal) -> str:
    """Why a signal is nothing that a wrapper could do; empty where it could."""
    if signal.where == "recording":
        return "of what was measured, not of the robot"
    if signal.quantity == "delay" and signal.value < 0:
        return "it acts before its stamp: nothing can do that, shift the log"
    if signal.quantity == "lead":
        return "the time step's own error"
    if signal.quantity.startswith("turned"):
        return "turn the sensor's site"
    return ""


def _delays(found: Correction, model: mujoco.MjModel) -> list[tuple[Change, Signal]]:
    """Delays that MJCF can hold: of an actuator that the command reaches as it was sent, and by no controller."""
    chance = {s.name for s in found.signals if s.quantity in ("loss", "jitter")}
    controlled = {s.name for s in found.signals if s.where == "controller"}
    made = []
    for signal in found.signals:
        if signal.where != "command" or signal.quantity != "delay" or signal.value <= 0:
            continue
        if signal.name in chance | controlled or not 0 <= signal.index < model.nu:
            continue
        before = float(model.actuator_delay[signal.index])
        if before + signal.value < model.opt.timestep:
            continue  # MuJoCo makes a whole step of it
        span = {"low": (before + signal.low,), "high": (before + float(signal.high or 0.0),)} if signal.low else {}
        value = (before + signal.value,)
        change = Change("actuator", signal.name, signal.index, "delay", (before,), value, "s")
        made.append((replace(change, **span), signal))  # type: ignore[arg-type]
    return made


def _write_wrapper(path: Path, signals: Sequence[Signal], model: Path) -> None:
    source = Path(str(signals_module.__file__)).read_text(encoding="utf-8")
    own = '"""What happens to commands and readings that MJCF has no words for. Needs NumPy and MuJoCo only.\n'
    heading = (
        f'"""What {model.name} cannot say about the robot: `Signals(model, SIGNALS).step(data, command)`.\n\n'
        "Needs NumPy and MuJoCo only.\n"
    )
    keys = ("where", "name", "quantity", "value")
    rows = "".join(f"    { ({k: getattr(s, k) for k in keys})!r},  # {s.unit}\n" for s in signals)
    text = source.replace(own, heading) + f"\n\nSIGNALS: list[dict[str, Any]] = [\n{rows}]\n"
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise GapInputError(f"{path}: cannot be written ({error.strerror})") from error
