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

from simgap.data.bag import is_bag, read_bag, topics
from simgap.data.channels import is_servo, model_names
from simgap.data.errors import GapInputError
from simgap.data.mapping import BAG_TIME, parse_map
from simgap.data.tables import load_table

Array = NDArray[np.float64]
Ask = Callable[[str, str], str]
"""Takes a question and a default, gives the answer."""
Obj = mujoco.mjtObj

_COMMAND = {"cmd", "command", "commands", "commanded", "goal", "target", "des", "desired", "action", "actions"} | {
    *("ctrl", "control", "setpoint", "reference", "ref", "u", "leader"),
}
_QUANTITIES = {
    "position": {"q", "pos", "position", "positions", "angle", "theta", "qpos"},
    "velocity": {"dq", "qd", "vel", "velocity", "velocities", "speed", "omega", "qvel"},
    "torque": {"tau", "torque", "torques", "effort", "efforts", "trq"},
}
_TIME = {"t", "time", "timestamp", "stamp", "seconds", "sec"}
_RUN = {"run", "episode", "segment", "trial"}
_ENABLED = {"enable", "enabled"}
_BESIDE = {
    "volts": "V",
    "voltage": "V",
    "battery": "V",
    "vin": "V",
    "current": "A",
    "temp": "degC",
    "temperature": "degC",
}
_GENERIC = {"joint", "joints", "state", "states", "observation", "measured", "present", "robot", "motor", "servo"} | {
    *("actuator", "points", "data", "input", "actual", "index", "controller", "feedback", "rad", "deg"),
}
_SURE = 0.8
"""Correlation from which a column moves with another."""
_MANY = 400
"""Fields of a bag that are looked at."""


@dataclass
class _Column:
    """A column or a field that a map may name: its row, its words, what they say it is, and its values."""

    name: str
    row: dict[str, Any]
    words: list[str]
    values: Array
    command: bool = False
    quantity: str = ""
    full: tuple[str, ...] = ()
    """Words of its name that say no role: the joint's, as the recording calls it."""
    key: tuple[str, ...] = ()
    """Of these, without those that any joint may have."""


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
                "# gains of the robot's own controller, which no log tells; fill in and take out the #:",
                "# gains:",
            ]
            lines += [f"#   {_scalar(name)}: {{kp: , kd: }}" for name in unknown]
        if self.segments is not None:
            lines.append(f"segments: {_flow(self.segments)}")
        if self.auxiliary:
            lines += ["auxiliary:", *(f"  - {_flow(row)}" for row in self.auxiliary)]
        if self.enabled is not None:
            lines.append(f"enabled: {_flow(self.enabled)}")
        lines += [f"# not used: {name} ({why})" for name, why in self.unused]
        return "\n".join(lines) + "\n"


def guess_map(recording: Path, model: mujoco.MjModel, ask: Ask | None = None) -> Guess:
    """Guess a map; ``ask`` is asked what nobody can know, where there is someone.

    Raises:
        GapInputError: the recording cannot be read, or nothing in it looks like an input or an output of the model.
    """
    columns, guess = _columns(recording), Guess()
    if is_bag(recording):
        columns = [c for c in columns if c.name != BAG_TIME]
    else:
        guess.time = _take_time(columns, recording)
    _take_beside(columns, guess)
    for column in columns:
        _read_words(column)
    joints = [j for j in range(model.njnt) if model.jnt_type[j] in (2, 3)]
    places = _match(columns, model, joints)
    _outputs(columns, places, model, joints, guess)
    _inputs(columns, places, model, joints, guess, ask)
    for column in columns:
        if column.name in guess.used:
            continue
        if not (column.command or column.quantity):
            why = "nothing says what it measures"
        else:
            why = "not needed" if column.name in places else "names no joint or actuator"
        guess.unused.append((column.name, why))
    if not guess.inputs or not guess.outputs:
        what = "input (a command or a torque)" if not guess.inputs else "output (a position or a rate)"
        raise GapInputError(
            f"{recording}: nothing looks like an {what} of the model's "
            f"{', '.join(model_names(model, Obj.mjOBJ_JOINT)[:8])}; columns: "
            f"{', '.join(c.name for c in columns[:12])}. Write the map by hand"
        )
    return guess


def _columns(recording: Path) -> list[_Column]:
    if not is_bag(recording):
        table = load_table(recording)
        return [_Column(name, {"column": name}, _words(name), values) for name, values in table.items()]
    rows: list[dict[str, Any]] = []
    for topic in topics(recording):
        for path, elements in topic.fields.items():
            base = {"topic": topic.name, "field": path}
            if isinstance(elements, list):
                rows += [{**base, "named": name} for name in elements]
            elif isinstance(elements, int):
                rows += [{**base, "index": i} for i in range(min(elements, 64))]
            else:
                rows.append(base)
    mapping = parse_map({"auxiliary": rows[:_MANY]})
    table, _ = read_bag(recording, mapping)
    found = []
    for row, auxiliary in zip(rows, mapping.auxiliary, strict=False):
        found.append(_Column(auxiliary.column, row, _words(auxiliary.column), table[auxiliary.column]))
    return found


def _words(name: str) -> list[str]:
    parted = re.sub(r"(?<=[a-z])(?=[A-Z][a-z])|(?<=[A-Za-z])(?=\d)|(?<=\d)(?=[A-Za-z])", " ", name)
    return [w.lower() for w in re.split(r"[^A-Za-z0-9]+", parted) if w]


def _take_time(columns: list[_Column], recording: Path) -> dict[str, Any]:
    """The time column, taken out of ``columns``."""
    for column in sorted(columns, key=lambda c: (not set(c.words) & _TIME, len(c.words))):
        steps = np.diff(column.values)
        steps = steps[np.isfinite(steps)]
        if set(column.words) & _TIME and len(steps) and np.mean(steps > 0) > 0.5:
            columns.remove(column)
            step = float(np.median(steps[steps > 0]))
            unit = "s" if step < 0.3 else "ms" if step < 300 else "us" if step < 3e5 else "ns"
            return {"column": column.name, "unit": unit}
    raise GapInputError(
        f"{recording}: no column looks like a time (names tried: {', '.join(sorted(_TIME))}); write the map by hand"
    )


def _take_beside(columns: list[_Column], guess: Guess) -> None:
    """Runs, torque switches, voltages and the like, taken out of ``columns``."""
    for column in list(columns):
        words, values = set(column.words), column.values[np.isfinite(column.values)]
        levels = np.unique(values)
        if words & _RUN and guess.segments is None and 1 <= len(levels) < 0.1 * len(values) and (levels % 1 == 0).all():
            guess.segments = dict(column.row)
        elif words & _ENABLED and set(levels.tolist()) <= {0.0, 1.0}:
            if guess.enabled is None and len(levels):
                guess.enabled = dict(column.row)
        elif unit := next((_BESIDE[w] for w in column.words if w in _BESIDE), None):
            if len(levels) > 1:
                guess.auxiliary.append({**column.row, "unit": unit})
        else:
            continue
        columns.remove(column)


def _read_words(column: _Column) -> None:
    column.command = bool(set(column.words) & _COMMAND)
    for quantity, names in _QUANTITIES.items():
        if set(column.words) & names:
            column.quantity = quantity
    if not column.quantity and {"observation", "states", "state"} & set(column.words):
        column.quantity = "position"
    role = _COMMAND | set().union(*_QUANTITIES.values())
    # Of a message that names its elements, the topic says nothing about which one it is.
    words = _words(column.row["named"]) if "named" in column.row else column.words
    column.full = tuple(w for w in words if w not in role)
    column.key = _bare(column.full)


def _match(columns: Sequence[_Column], model: mujoco.MjModel, joints: Sequence[int]) -> dict[str, int]:
    """Column name -> joint, from the words that are left."""
    names, driven = model_names(model, Obj.mjOBJ_JOINT), model_names(model, Obj.mjOBJ_ACTUATOR)
    own = {j: _words(names[j]) for j in joints}
    told = {_joint_of(model, a): _words(name) for a, name in enumerate(driven) if _joint_of(model, a) in own}
    candidates = [c for c in columns if c.command or c.quantity]
    numbers = {int(c.key[-1]) for c in candidates if c.key and c.key[-1].isdigit()}
    first = 0 if 0 in numbers else 1
    places: dict[str, int] = {}
    for column in candidates:
        order = (told, own) if column.command else (own, told)
        number = int(column.key[-1]) - first if column.key and column.key[-1].isdigit() else column.row.get("index", -1)
        found = (
            _only(j for known in (own, told) for j, words in known.items() if column.full == tuple(words))
            or _only(j for j, words in order[0].items() if column.key == _bare(words))
            or _only(j for j, words in order[1].items() if column.key == _bare(words))
            or _only(j for j, words in own.items() if _bare(words) and set(_bare(words)) <= set(column.key))
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


def _bare(words: Sequence[str]) -> tuple[str, ...]:
    return tuple(w for w in words if w not in _GENERIC)


def _joint_of(model: mujoco.MjModel, actuator: int) -> int:
    at_joint = model.actuator_trntype[actuator] == mujoco.mjtTrn.mjTRN_JOINT
    return int(model.actuator_trnid[actuator, 0]) if at_joint else -1


def _outputs(
    columns: Sequence[_Column],
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


def _to_joint(column: _Column, joint: str) -> dict[str, Any]:
    """A column's row, where a joint is named: what the message calls it is said only where it is called otherwise."""
    row = dict(column.row)
    if row.get("named") == joint:
        del row["named"]
    return row


def _unit(
    column: _Column,
    quantity: str,
    joint: int,
    model: mujoco.MjModel,
    columns: Sequence[_Column],
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
    columns: Sequence[_Column],
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
    column: _Column,
    actuator: int,
    joint: int,
    model: mujoco.MjModel,
    columns: Sequence[_Column],
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
        if alike < -_SURE:
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
