"""What is known of the ways of signals: `signals` of a map, as `simgap apply` writes it, resolved in a model."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from simgap.data.channels import InputChannel, OutputChannel, model_names
from simgap.data.errors import GapInputError, nearest
from simgap.data.mapping import SIGNALS, Map, SignalRow

Array = NDArray[np.float64]
Obj = mujoco.mjtObj
_PATHS = {
    "command": "inputs",
    "recording": "inputs",
    "servo": "servos",
    "joint": "friction",
    "mount": "mounts",
    "sensor": "outputs",
}
KELVINS = {
    **dict.fromkeys(("K", "kelvin", "degC", "°C", "celsius"), 1.0),
    **dict.fromkeys(("degF", "°F", "fahrenheit"), 5.0 / 9.0),
}
"""Kelvins in a step of one unit: only differences matter."""


@dataclass(frozen=True)
class Known:
    """A number of one of a variant's paths; of ``rows``, or the path's one number where there are none."""

    path: str
    field: str
    rows: tuple[int, ...]
    value: Any

    def enter(self, variant: Any) -> None:
        """Set it in a `simgap.simulation.variant.Variant`, in place."""
        path = getattr(variant, self.path)
        if self.rows:
            getattr(path, self.field)[list(self.rows)] = self.value
        else:
            setattr(path, self.field, self.value)


def known_signals(
    model: mujoco.MjModel, inputs: Sequence[InputChannel], outputs: Sequence[OutputChannel], mapping: Map
) -> tuple[Known, ...]:
    """The rows of a map's `signals`.

    Raises:
        GapInputError: a name that model or map lack, or a link with chance whose `update` is not given.
    """
    names = {
        "servo": model_names(model, Obj.mjOBJ_ACTUATOR),
        "joint": model_names(model, Obj.mjOBJ_JOINT),
        "mount": model_names(model, Obj.mjOBJ_BODY),
        "sensor": [c.name for c in outputs],
    }
    found: list[Known] = []
    turns: dict[str, Array] = {}
    for i, row in enumerate(mapping.signals):
        where = f"{mapping.source}: signals[{i}]"
        if row.quantity.startswith("turned"):
            axis = "xyz".index(row.quantity[-1])
            turns.setdefault(row.name, np.zeros(3))[axis] = row.value
            _place(row.name, [c.sensor for c in outputs], where)
            continue
        field = SIGNALS[row.where][row.quantity].field
        if row.where in ("command", "recording"):
            rows = _channels(row, inputs, where)
        elif row.quantity in ("sag", "sag_reference", "follows_voltage"):
            rows = ()
        else:
            place = _place(row.name, names[row.where], where)
            rows = (int(model.jnt_dofadr[place]),) if row.where == "joint" else (place,)
        found.append(Known(_PATHS[row.where], field, rows, row.value))
        if row.quantity.startswith("dead_band"):
            found.append(Known("servos", "hard", rows, row.quantity == "dead_band"))
    _check_updates(mapping)
    if turns:
        found.append(Known("outputs", "turns", (), tuple(_turn(name, s, outputs) for name, s in turns.items())))
    return tuple(found)


def thermometers(model: mujoco.MjModel, mapping: Map) -> dict[int, tuple[str, float]]:
    """{actuator: (column, kelvins in its unit)} of the map's `auxiliary` rows that name an actuator.

    Raises:
        GapInputError: a row names an actuator that the model lacks, or has no unit of temperature.
    """
    names, found = model_names(model, mujoco.mjtObj.mjOBJ_ACTUATOR), {}
    for i, row in enumerate(mapping.auxiliary):
        if row.actuator is None:
            continue
        where = f"{mapping.source}: auxiliary[{i}]"
        if row.actuator not in names:
            raise GapInputError(
                f"{where}.actuator: {row.actuator!r} is not there; {nearest(row.actuator, names, 'name')}"
            )
        if row.unit not in KELVINS:
            raise GapInputError(
                f"{where}: unit {row.unit!r} does not fit; of an actuator it is a temperature, {', '.join(KELVINS)}"
            )
        found[names.index(row.actuator)] = row.column, KELVINS[row.unit]
    return found


def _channels(row: SignalRow, inputs: Sequence[InputChannel], where: str) -> tuple[int, ...]:
    """The inputs that a row means: of an actuator by its name, else by the column."""
    rows = tuple(i for i, c in enumerate(inputs) if row.name in (c.name, c.column))
    if not rows:
        _place(row.name, [c.name for c in inputs], where)
    return rows


def _place(name: str, names: Sequence[str], where: str) -> int:
    if name not in names:
        raise GapInputError(f"{where}.name: {name!r} is not there; {nearest(name, list(names), 'name')}")
    return names.index(name)


def _check_updates(mapping: Map) -> None:
    told = {row.name for row in mapping.signals if row.quantity == "update"}
    for i, row in enumerate(mapping.signals):
        if row.quantity in ("loss", "jitter") and row.name not in told:
            raise GapInputError(
                f"{mapping.source}: signals[{i}]: {row.quantity} of {row.name!r} needs a row with its update, the time "
                "[s] between two commands"
            )


def _turn(name: str, sine: Array, outputs: Sequence[OutputChannel]) -> tuple[tuple[int, ...], Array]:
    """A sensor's channels x, y, z and their rotation, from the sine of its angle along its axis."""
    channels = sorted((c.component, i) for i, c in enumerate(outputs) if c.sensor == name)
    size = float(np.linalg.norm(sine))
    angle = math.asin(min(size, 1.0)) / size if size > 0.0 else 0.0
    return tuple(i for _, i in channels), Rotation.from_rotvec(angle * sine).as_matrix()
