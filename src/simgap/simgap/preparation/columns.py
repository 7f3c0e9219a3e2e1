"""What a recording holds, as columns that a map may name, and what their names say."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simgap.data.bag import is_bag, read_bag, topics
from simgap.data.mapping import parse_map
from simgap.data.tables import load_table, numbered

Array = NDArray[np.float64]

COMMAND = {"cmd", "command", "commands", "commanded", "goal", "target", "des", "desired", "action", "actions"} | {
    *("ctrl", "control", "setpoint", "reference", "ref", "u", "leader"),
}
QUANTITIES = {
    "position": {"q", "pos", "position", "positions", "angle", "theta", "qpos"},
    "velocity": {"dq", "qd", "vel", "velocity", "velocities", "speed", "omega", "qvel"},
    "torque": {"tau", "torque", "torques", "effort", "efforts", "trq"},
}
TIME = {"t", "time", "timestamp", "stamp", "seconds", "sec"}
RUN = {"run", "episode", "segment", "trial"}
ENABLED = {"enable", "enabled"}
BESIDE = {
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
_MANY, _LONGEST = 400, 64
"""Fields of a bag, and elements of an array, that are looked at."""


@dataclass
class Column:
    """A column or a field that a map may name: its row, its words, what they say it is, and its values."""

    name: str
    row: dict[str, Any]
    words: list[str]
    values: Array = field(default_factory=lambda: np.zeros(0))
    command: bool = False
    quantity: str = ""
    full: tuple[str, ...] = ()
    """Words of its name that say no role: the joint's, as the recording calls it."""
    key: tuple[str, ...] = ()
    """Of these, without those that any joint may have."""
    size: int = 0
    """Length of the array that it is an element of by its index; 0 of others."""

    @property
    def own(self) -> list[str]:
        """Words of what it is; of a bag those of the field, which the topic's are not mixed with where that says it."""
        field_ = words_of(str(self.row.get("field", "")))
        return field_ if set(field_) - _GENERIC else self.words

    @property
    def beside(self) -> str:
        """Unit of a voltage, current or temperature; empty of all else."""
        return next((BESIDE[w] for w in reversed(self.own) if w in BESIDE), "")


def columns_of(recording: Path, likely: Callable[[Sequence[Column]], Iterable[str]]) -> list[Column]:
    """All columns of a table; of a bag those whose names tell something, without those that hold no number.

    ``likely``: names of columns whose values are worth reading, of all that the bag has; other columns stay without.
    """
    if not is_bag(recording):
        table = load_table(recording, lambda name: bool(set(words_of(name)) & RUN))
        table = {n: numbered(v)[0] if v.dtype.kind == "U" else v for n, v in table.items()}
        found = [Column(name, {"column": name}, words_of(name), values) for name, values in table.items()]
        for column in found:
            read_words(column)
        return found
    rows: list[dict[str, Any]] = []
    sizes: list[int] = []
    for topic in topics(recording):
        for path, elements in topic.fields.items():
            base = {"topic": topic.name, "field": path}
            if isinstance(elements, list):
                rows += [{**base, "named": name} for name in elements]
            elif isinstance(elements, int):
                rows += [{**base, "index": i} for i in range(min(elements, _LONGEST))]
            else:
                rows.append(base)
            sizes += [elements if isinstance(elements, int) else 0] * (len(rows) - len(sizes))
    names = [row.column for row in parse_map({"auxiliary": rows}).auxiliary]
    found = [Column(n, r, words_of(n), size=k) for n, r, k in zip(names, rows, sizes, strict=True)]
    for column in found:
        read_words(column)
    besides = {c.name for c in found if c.beside or set(c.own) & (RUN | ENABLED)}
    telling = [c for c in found if c.command or c.quantity or c.name in besides]
    wanted = set(likely(telling)) | besides
    read = [c for c in telling if c.name in wanted][:_MANY]
    values, _ = read_bag(recording, parse_map({"auxiliary": [c.row for c in read]}), hollow=True) if read else ({}, [])
    for column in read:
        column.values = values.get(column.name, column.values)
    return [c for c in telling if c.name in values or c.name not in wanted]


def words_of(name: str) -> list[str]:
    """The words and numbers of a name, in small letters."""
    parted = re.sub(r"(?<=[a-z])(?=[A-Z][a-z])|(?<=[A-Za-z])(?=\d)|(?<=\d)(?=[A-Za-z])", " ", name)
    return [w.lower() for w in re.split(r"[^A-Za-z0-9]+", parted) if w]


def read_words(column: Column) -> None:
    """Enter what a column's words say it is."""
    column.command = bool(set(column.words) & COMMAND)
    for quantity, names in QUANTITIES.items():
        if set(column.words) & names:
            column.quantity = quantity
    if not column.quantity and {"observation", "states", "state"} & set(column.words):
        column.quantity = "position"
    role = COMMAND | set().union(*QUANTITIES.values())
    # Of a message that names its elements, the topic says nothing about which one it is.
    words = words_of(column.row["named"]) if "named" in column.row else column.words
    column.full = tuple(w for w in words if w not in role)
    column.key = bare(column.full)


def bare(words: Sequence[str]) -> tuple[str, ...]:
    """Words without those that any joint may have."""
    return tuple(w for w in words if w not in _GENERIC)
