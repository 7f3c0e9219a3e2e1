"""A map guessed from a recording and a model: from names, topics, ranges and how columns move together."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from simgap.data.bag import is_bag
from simgap.data.channels import is_servo, model_names
from simgap.data.errors import GapInputError
from simgap.data.known import KELVINS
from simgap.data.mapping import ALL
from simgap.preparation.columns import ENABLED, RUN, TIME, Column, bare, columns_of, words_of
from simgap.preparation.floating import body_rows

Array = NDArray[np.float64]
Ask = Callable[[str, str], str]
"""Takes a question and a default, gives the answer."""
Obj = mujoco.mjtObj

_SURE = 0.8
"""Correlation from which a column moves with another."""


@dataclass
class Guess:
    """A guessed map.

    Attributes:
        inputs, outputs: (row, why) each.
        gains: actuator -> {kp, kd}; None where nobody knows.
        unused: (name, why) of what the map leaves out.
        open: what the user has to look at.
        used: names of the columns that are in the map.
    """

    time: dict[str, Any] | None = None
    inputs: list[tuple[dict[str, Any], str]] = field(default_factory=list)
    outputs: list[tuple[dict[str, Any], str]] = field(default_factory=list)
    gains: dict[str, dict[str, float] | None] = field(default_factory=dict)
    segments: dict[str, Any] | None = None
    auxiliary: list[dict[str, Any]] = field(default_factory=list)
    enabled: dict[str, Any] | None = None
    unused: list[tuple[str, str]] = field(default_factory=list)
    open: list[str] = field(default_factory=list)
    used: set[str] = field(default_factory=set)

    def text(self, source: str) -> str:
        """The map as YAML with comments."""
        lines = [f"# Guessed by `simgap map` from {source}. Look at what a comment doubts; `simgap check` tries it."]
        if self.time is not None:
            lines.append(f"time: {_flow(self.time)}")
        for title, rows in (("inputs", self.inputs), ("outputs", self.outputs)):
            lines.append(f"{title}:" if rows else f"{title}: []")
            lines += [f"  - {_flow(row)}" + (f"  # {why}" if why else "") for row, why in rows]
        if known := {name: g for name, g in self.gains.items() if g is not None}:
            lines += ["gains:", *(f"  {_scalar(name)}: {_flow(dict(g))}" for name, g in known.items())]
        if unknown := [name for name, g in self.gains.items() if g is None]:
            lines += [
                "# gains of the robot's own controller, which no log tells; fill in and take out the #; those of one",
                f"# that has others go beside all, by its name ({', '.join(unknown)}):",
                f"# gains: {{{ALL}: {{kp: , kd: }}}}",
            ]
        if self.segments is not None:
            lines.append(f"segments: {_flow(self.segments)}")
        if self.auxiliary:
            lines += ["auxiliary:", *(f"  - {_flow(row)}" for row in self.auxiliary)]
        if self.enabled is not None:
            lines.append(f"enabled: {_flow(self.enabled)}")
        # Of arrays and lists of a bag once for all elements.
        left = dict.fromkeys((re.sub(r"\[[^\]]*\]$", "[...]", name), why) for name, why in self.unused)
        lines += [f"# not used: {name} ({why})" for name, why in left]
        return "\n".join(lines) + "\n"


def guess_map(recording: Path, model: mujoco.MjModel, ask: Ask | None = None) -> Guess:
    """Guess a map; ``ask`` is asked what nobody can know, where there is someone.

    Raises:
        GapInputError: the recording cannot be read, or nothing in it looks like an input or an output of the model.
    """
    joints, guess = [j for j in range(model.njnt) if model.jnt_type[j] in (2, 3)], Guess()
    columns = columns_of(recording, lambda telling: _match(telling, model, joints))
    if not is_bag(recording):
        guess.time = _take_time(columns, recording)
    _take_beside(columns, guess)
    places = _match(columns, model, joints)
    _outputs(columns, places, model, joints, guess)
    _inputs(columns, places, model, joints, guess, ask)
    _tell_thermometers(guess)
    if is_bag(recording):
        guess.outputs += body_rows(recording, model)
    seen = {row["topic"] for row, _ in guess.outputs if "topic" in row}
    for column in columns:
        if column.name in guess.used or (column.row.get("topic") in seen and column.name not in places):
            continue
        if not (column.command or column.quantity):
            why = "nothing says what it measures"
        else:
            why = "not needed" if column.name in places else "names no joint or actuator"
        guess.unused.append((column.name, why))
    if not guess.inputs or not guess.outputs:
        what = "input (a command or a torque)" if not guess.inputs else "output (a position or a rate)"
        raise GapInputError(
            f"{recording}: nothing looks like an {what} of the model's joints "
            f"({', '.join(model_names(model, Obj.mjOBJ_JOINT)[:8]) or 'it has none'}); columns: "
            f"{', '.join(c.name for c in columns[:12])}. Write the map by hand"
        )
    return guess


def _take_time(columns: list[Column], recording: Path) -> dict[str, Any]:
    """The time column, taken out of ``columns``."""
    for column in sorted(columns, key=lambda c: (not set(c.words) & TIME, len(c.words))):
        steps = np.diff(column.values)
        steps = steps[np.isfinite(steps)]
        if set(column.words) & TIME and len(steps) and np.mean(steps > 0) > 0.5:
            columns.remove(column)
            step = float(np.median(steps[steps > 0]))
            unit = "s" if step < 0.3 else "ms" if step < 300 else "us" if step < 3e5 else "ns"
            return {"column": column.name, "unit": unit}
    raise GapInputError(
        f"{recording}: no column looks like a time (names tried: {', '.join(sorted(TIME))}); write the map by hand"
    )


def _take_beside(columns: list[Column], guess: Guess) -> None:
    """Runs, torque switches, voltages and the like, taken out of ``columns``."""
    for column in list(columns):
        words, values = set(column.own), column.values[np.isfinite(column.values)]
        levels = np.unique(values)
        if words & RUN and guess.segments is None and 1 <= len(levels) < 0.1 * len(values) and (levels % 1 == 0).all():
            guess.segments = dict(column.row)
        elif words & ENABLED and set(levels.tolist()) <= {0.0, 1.0}:
            if guess.enabled is None and len(levels):
                guess.enabled = dict(column.row)
        elif column.beside:
            if len(levels) > 1:
                guess.auxiliary.append({**column.row, "unit": column.beside})
        else:
            continue
        columns.remove(column)


def _tell_thermometers(guess: Guess) -> None:
    """Say whose motor a temperature is, where its name says so or there is one motor alone."""
    motors = list(dict.fromkeys(str(row["actuator"]) for row, _ in guess.inputs if "actuator" in row))
    for row in guess.auxiliary:
        if row["unit"] not in KELVINS:
            continue
        told = set(words_of(" ".join(str(row[k]) for k in ("topic", "field", "column", "named") if k in row)))
        named = [m for m in motors if bare(words_of(m)) and set(bare(words_of(m))) <= told]
        whose = motors if len(motors) == 1 else named
        if len(whose) == 1:
            row["actuator"] = whose[0]


def _match(columns: Sequence[Column], model: mujoco.MjModel, joints: Sequence[int]) -> dict[str, int]:
    """Column name -> joint, from the words that are left."""
    names, driven = model_names(model, Obj.mjOBJ_JOINT), model_names(model, Obj.mjOBJ_ACTUATOR)
    own = {j: words_of(names[j]) for j in joints}
    told = {_joint_of(model, a): words_of(name) for a, name in enumerate(driven) if _joint_of(model, a) in own}
    candidates = [c for c in columns if c.command or c.quantity]
    numbered = [c.key for c in candidates if c.key and c.key[-1].isdigit()]
    first = 0 if any(int(key[-1]) == 0 for key in numbered) else 1
    # Numbers count joints only where they are all that tells the columns apart: tail_1 beside spine_1 counts parts.
    counted = len({key[:-1] for key in numbered}) == 1
    places: dict[str, int] = {}
    for column in candidates:
        order = (told, own) if column.command else (own, told)
        number = column.row.get("index", -1) if column.size in (len(joints), model.nu) else -1
        if "index" not in column.row and counted and column.key and column.key[-1].isdigit():
            number = int(column.key[-1]) - first
        found = (
            _only(j for known in (own, told) for j, words in known.items() if column.full == tuple(words))
            or _only(j for j, words in order[0].items() if column.key == bare(words))
            or _only(j for j, words in order[1].items() if column.key == bare(words))
            or _only(j for j, words in own.items() if bare(words) and set(bare(words)) <= set(column.key))
            or ([joints[number]] if 0 <= number < len(joints) else [])
            or (list(joints) if not column.key and len(joints) == 1 else [])
        )
        if found:
            places[column.name] = found[0]
    return places


def _only(found: Iterable[int]) -> list[int]:
    """The one that was found, or none where several were."""
    several = set(found)
    return list(several) if len(several) == 1 else []


def _joint_of(model: mujoco.MjModel, actuator: int) -> int:
    at_joint = model.actuator_trntype[actuator] == mujoco.mjtTrn.mjTRN_JOINT
    return int(model.actuator_trnid[actuator, 0]) if at_joint else -1


def _outputs(
    columns: Sequence[Column],
    places: dict[str, int],
    model: mujoco.MjModel,
    joints: Sequence[int],
    guess: Guess,
) -> None:
    names = model_names(model, Obj.mjOBJ_JOINT)
    for quantity in ("position", "velocity"):
        for joint in joints:
            found = [c for c in columns if not c.command and c.quantity == quantity and places.get(c.name) == joint]
            for column in found[:1]:
                guess.used.add(column.name)
                unit, why = _unit(column, quantity, joint, model, columns, places)
                if np.ptp(column.values[np.isfinite(column.values)]) == 0.0:
                    why = "never changes"
                guess.outputs.append(
                    (
                        {**_to_joint(column, names[joint]), "unit": unit, "joint": names[joint], "quantity": quantity},
                        why,
                    )
                )
                if why:
                    guess.open.append(f"{column.name}: {why}")


def _to_joint(column: Column, joint: str) -> dict[str, Any]:
    """A column's row, where a joint is named: what the message calls it is said only where it is called otherwise."""
    row = dict(column.row)
    if row.get("named") == joint:
        del row["named"]
    return row


def _unit(
    column: Column,
    quantity: str,
    joint: int,
    model: mujoco.MjModel,
    columns: Sequence[Column],
    places: dict[str, int],
) -> tuple[str, str]:
    """(unit, doubt) of a position or a rate, from the range of its joint or the slope of its position."""
    slide = model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE
    size = float(np.nanpercentile(np.abs(column.values), 99))
    if quantity == "position":
        if slide:
            return ("mm", "the values are large for metres") if size > 5.0 else ("m", "")
        reach = float(np.abs(model.jnt_range[joint]).max()) if model.jnt_limited[joint] else 2 * np.pi
        if size > 2.0 * reach and size > 7.0:
            return (
                "deg",
                "degrees, by the joint's range" if size <= 400 else "too large for degrees: counts of an encoder?",
            )
        return "rad", ""
    position = next(
        (c for c in columns if not c.command and c.quantity == "position" and places.get(c.name) == joint), None
    )
    if slide:
        return "m/s", ""
    if position is not None:
        base = _unit(position, "position", joint, model, columns, places)[0]
        return ("deg/s", "") if base == "deg" else ("rad/s", "")
    return ("deg/s", "degrees, by their size") if size > 60.0 else ("rad/s", "")


def _inputs(
    columns: Sequence[Column],
    places: dict[str, int],
    model: mujoco.MjModel,
    joints: Sequence[int],
    guess: Guess,
    ask: Ask | None,
) -> None:
    names, actuators = model_names(model, Obj.mjOBJ_JOINT), model_names(model, Obj.mjOBJ_ACTUATOR)
    told: set[int] = set()
    by_joint = {_joint_of(model, a): a for a in range(model.nu) if _joint_of(model, a) >= 0}
    for joint in joints:
        if joint not in by_joint:
            continue
        a = by_joint[joint]
        for column in [c for c in columns if c.command and places.get(c.name) == joint]:
            row, why = _command(column, a, joint, model, columns, places)
            if any(r.get("actuator") == actuators[a] and r["kind"] == row["kind"] for r, _ in guess.inputs):
                continue
            guess.inputs.append((row, why))
            guess.used.add(column.name)
            told.add(joint)
            if why and "moves with" not in why:
                guess.open.append(f"{column.name}: {why}")
            if row["kind"] == "position" and not is_servo(model, a, 1):
                guess.gains[actuators[a]] = None
    for joint in joints:
        if joint in told:
            continue
        torque = next((c for c in columns if c.quantity == "torque" and places.get(c.name) == joint), None)
        if torque is not None:
            unit = "N" if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE else "N m"
            row = {**_to_joint(torque, names[joint]), "unit": unit, "joint": names[joint], "kind": "torque"}
            guess.inputs.append(({**row, "measured": not torque.command}, ""))
            guess.used.add(torque.name)
    if guess.gains and ask is not None:
        answer = ask("kp and kd of the robot's own controller (torque = kp (u - q) - kd dq/dt), as `kp kd`", "")
        numbers = [
            float(w) for w in re.findall(r"[-+.\deE]+", answer) if re.fullmatch(r"[-+]?\d*\.?\d+(?:[eE][-+]?\d+)?", w)
        ]
        if numbers:
            kd = numbers[1] if len(numbers) > 1 else 0.0
            guess.gains = {name: {"kp": numbers[0], "kd": kd} for name in guess.gains}
    if unknown := [name for name, g in guess.gains.items() if g is None]:
        guess.open.append(
            f"gains of {', '.join(unknown)}: the model has motors and the log has positions; fill them in"
        )


def _command(
    column: Column,
    actuator: int,
    joint: int,
    model: mujoco.MjModel,
    columns: Sequence[Column],
    places: dict[str, int],
) -> tuple[dict[str, Any], str]:
    """(row, why or doubt) of a command to an actuator."""
    names, actuators = model_names(model, Obj.mjOBJ_JOINT), model_names(model, Obj.mjOBJ_ACTUATOR)
    position = next(
        (c for c in columns if not c.command and c.quantity == "position" and places.get(c.name) == joint), None
    )
    alike = _correlation(column.values, position.values) if position is not None else 0.0
    kind = column.quantity
    if not kind:
        servo = is_servo(model, actuator, 1) or alike > _SURE
        kind = "position" if servo else "velocity" if is_servo(model, actuator, 2) else "torque"
    row = _to_joint(column, names[joint])
    if "topic" in row and "index" not in row and "named" not in row:
        row["joint"] = names[joint]
    slide = model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE
    if kind == "position":
        unit = _unit(column, "position", joint, model, columns, places)[0]
    else:
        unit = {"velocity": ("rad/s", "m/s"), "torque": ("N m", "N")}[kind][slide]
    why = ""
    if kind == "position" and position is not None:
        if np.ptp(_filled(column.values)) == 0.0:
            why = "never changes"
        elif alike < -_SURE:
            why = f"moves against {position.name} ({alike:.2f}): is a sign wrong (`sign: -1`)?"
        elif alike < 0.3:
            why = f"hardly moves with {position.name} ({alike:.2f}): is it this joint's?"
        else:
            why = f"moves with {position.name} ({alike:.2f})"
    return {**row, "unit": unit, "actuator": actuators[actuator], "kind": kind}, why


def _correlation(a: Array, b: Array) -> float:
    """Of two columns, each held where it was not sampled."""
    a, b = _filled(a), _filled(b)
    if np.std(a) == 0 or np.std(b) == 0:
        return 0.0
    return float(np.corrcoef(a, b)[0, 1])


def _filled(values: Array) -> Array:
    rows = np.arange(len(values))
    ok = np.isfinite(values)
    return np.interp(rows, rows[ok], values[ok]) if ok.any() else np.zeros(len(values))


def _flow(row: dict[str, Any]) -> str:
    return "{" + ", ".join(f"{k}: {_scalar(v)}" for k, v in row.items()) + "}"


def _scalar(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int | float):
        return f"{value:g}"
    plain = re.fullmatch(r"[A-Za-z_/][\w ./-]*", str(value)) and str(value).lower() not in ("y", "n", "yes", "no", "on")
    return str(value) if plain else "'" + str(value).replace("'", "''") + "'"
