"""Messages of recordings that are older than the present definitions, made what they would be today."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nermo_description.feet import named_readings


@dataclass(frozen=True, slots=True)
class Tactile:
    """nermo_interfaces/msg/Tactile."""

    header: Any
    name: list[str]
    voltage: NDArray[np.float64]


def _tactile(message: Any) -> Any:
    """Before readings had names there was a field of four voltages for each of two cells."""
    if not hasattr(message, "piezoresistive"):
        return message
    cells = {cell: getattr(message, cell) for cell in ("piezoresistive", "piezoelectric")}
    names, voltages = named_readings(cells)
    return Tactile(message.header, names, np.array(voltages))


_OLDER: dict[str, Callable[[Any], Any]] = {"nermo_interfaces/msg/Tactile": _tactile}


def as_today(kind: str, message: Any) -> Any:
    """A message of a kind, with the fields that its definition has today."""
    return _OLDER[kind](message) if kind in _OLDER else message
