"""The map of a corrected model: the old one in its own text, with what the diagnosis says and no MJCF can."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml

from simgap.correction.changes import Signal
from simgap.data.corrected import from_folder, origin
from simgap.data.errors import GapInputError
from simgap.data.mapping import Map, load_map, parse_map
from simgap.data.plant import build_plant, load_spec


def write_map(source: Path, signals: Sequence[Signal], out: Path, model: Path, corrected: Path) -> None:
    """Write the map ``source`` to ``out`` with these signals for its own, and gains of the robot's controllers anew.

    It names model and map that diagnoses began with (`corrects`). Comments and layout of other keys stay.

    Raises:
        GapInputError: map or models cannot be read, are not those of the diagnosis, or ``out`` cannot be written.
    """
    mapping = load_map(source)
    signals = _as_told(mapping, signals, model, corrected)
    gains = {name: {"kp": row.kp, "kd": row.kd} for name, row in mapping.gains.items()}
    for signal in signals:
        if signal.where == "controller":
            if signal.name not in gains:
                raise GapInputError(f"{source}: gains: has no {signal.name!r}; is it the map of the diagnosis?")
            gains[signal.name][signal.quantity] = float(f"{signal.value:.8g}")
    rows = [
        {"where": s.where, "name": s.name, "quantity": s.quantity, "value": float(f"{s.value:.8g}")}
        for s in signals
        if s.where != "controller"
    ]
    text = source.read_text(encoding="utf-8")
    if any(gains[name] != {"kp": row.kp, "kd": row.kd} for name, row in mapping.gains.items()):
        text = _with(text, "gains", gains)
    text = _with(text, "signals", rows)
    first = {k: from_folder(p, out.parent) for k, p in zip(("model", "map"), origin(model, source), strict=True)}
    text = _with(text, "corrects", first)
    if not _means(text, mapping, gains, rows, first, source):
        # A map whose keys do not each begin a line.
        found = yaml.safe_load(source.read_text(encoding="utf-8"))
        text = yaml.safe_dump(
            {**found, **({"gains": gains} if gains else {}), "signals": rows, "corrects": first}, sort_keys=False
        )
    try:
        out.write_text(text, encoding="utf-8")
    except OSError as error:
        raise GapInputError(f"{out}: cannot be written ({error.strerror})") from error


def _as_told(mapping: Map, signals: Sequence[Signal], model: Path, corrected: Path) -> list[Signal]:
    """The signals with commands of forces scaled where a motor's constant was corrected.

    A map has them in newtons, and what stands in the log was meant for the motor as it was taken to be.
    """
    before, after = (build_plant(load_spec(path), mapping).inputs for path in (model, corrected))
    found = list(signals)
    for old, new in zip(before, after, strict=True):
        if old.scale == new.scale:
            continue
        known = [s for s in found if s.quantity == "scale" and s.name in (old.name, old.column)]
        scale = old.scale / new.scale * (known[0].value if known else 1.0)
        found = [s for s in found if s not in known]
        found.append(Signal("recording" if old.measured else "command", old.column, "scale", scale, "1"))
    return found


def _with(text: str, key: str, value: object) -> str:
    """The text of a map with a key of its own lines replaced, or put behind all others."""
    bare = re.sub(rf"^{key}:.*\n?(?:[ \t-].*\n?|\n)*", "", text, flags=re.MULTILINE)
    if not value:
        return bare
    lines = yaml.safe_dump({key: value}, sort_keys=False, default_flow_style=None, width=200)
    return bare.rstrip("\n") + "\n" + lines


def _means(
    text: str, old: Map, gains: dict[str, Any], rows: Sequence[dict[str, Any]], first: dict[str, str], source: Path
) -> bool:
    """Whether a text is the old map with these gains and signals, and from where."""
    try:
        new = parse_map(yaml.safe_load(text), str(source))
    except (yaml.YAMLError, GapInputError, TypeError):
        return False
    others = {"gains", "signals", "corrects"}
    return (
        new.model_dump(exclude=others) == old.model_dump(exclude=others)
        and new.corrects is not None
        and new.corrects.model_dump() == first
        and {name: {"kp": row.kp, "kd": row.kd} for name, row in new.gains.items()} == gains
        and [row.model_dump() for row in new.signals] == list(rows)
    )
