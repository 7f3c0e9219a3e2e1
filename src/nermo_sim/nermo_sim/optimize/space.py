"""What is searched: the numbers of the gait knowledge-base that shape one gait, each with its range."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nermo_control.gait.knowledge_base import GaitParameters

Array = NDArray[np.float64]
PHASE_LAG = "phase_lag"


@dataclass(frozen=True, slots=True)
class Variable:
    """One number and the range in which it is searched. `paths`: its places in `GaitParameters`, with dots."""

    name: str
    low: float
    high: float
    unit: str
    paths: tuple[str, ...]


def variables(gait: str, spine: bool) -> tuple[Variable, ...]:
    """The search space of a gait; the spine's flexion is searched where it is used.

    The ranges lie inside those of the knowledge-base and, for heights and strides, inside the legs' workspace. The gait
    frequency is not among them: stepping faster is the one way to walk faster that needs no search.
    """
    found = [
        Variable(f"{pair}.{name}", low, high, "m", (f"{pair}.{name}",))
        for pair, neutral in (("front", (-0.045, 0.005)), ("rear", (-0.050, 0.0)))
        for name, low, high in (
            ("swing_amplitude", 0.004, 0.020),
            ("stance_amplitude", 0.0, 0.008),
            ("neutral_stance_height", neutral[0] - 0.006, neutral[0] + 0.006),
            ("neutral_stride_position", neutral[1] - 0.010, neutral[1] + 0.010),
        )
    ]
    found.append(Variable("max_stride_length", 0.04, 0.075, "m", ("front.max_stride_length", "rear.max_stride_length")))
    found.append(Variable("duty_factor", 0.45, 0.75, "1", (f"gaits.{gait}.duty_factor",)))
    found.append(Variable(PHASE_LAG, -0.08, 0.08, "1", ()))
    if spine:
        found.append(Variable("max_spine_flexion", 0.0, 0.1, "rad", ("max_spine_flexion",)))
    return tuple(found)


class Space:
    """Points in [0, 1]^n and the gait parameters that they stand for."""

    def __init__(self, base: GaitParameters, gait: str, spine: bool) -> None:
        self.variables = variables(gait, spine)
        self._base, self._gait = base, gait
        self._low = np.array([variable.low for variable in self.variables])
        self._high = np.array([variable.high for variable in self.variables])

    def __len__(self) -> int:
        return len(self.variables)

    def parameters(self, point: Sequence[float] | Array) -> GaitParameters:
        """The base set with the values of a point (n,), which is held to [0, 1]; values are rounded to six digits."""
        share = np.clip(np.asarray(point, dtype=np.float64), 0.0, 1.0)
        values = [float(f"{value:.6g}") for value in self._low + share * (self._high - self._low)]
        data = self._base.model_dump(mode="json")
        for variable, value in zip(self.variables, values, strict=True):
            for path in variable.paths:
                *folders, name = path.split(".")
                _inside(data, folders)[name] = value
            if variable.name == PHASE_LAG:
                gait = data["gaits"][self._gait]
                front_left, front_right, *rear = gait["phase_offsets"]
                gait["phase_offsets"] = [
                    front_left,
                    front_right,
                    *(round((offset + value) % 1.0, 6) % 1.0 for offset in rear),
                ]
        return GaitParameters.model_validate(data)

    def point(self, parameters: GaitParameters) -> Array:
        """The point (n,) of a set, held to [0, 1]; its phase lag is taken as that of the base."""
        data = parameters.model_dump(mode="json")
        values = []
        for variable in self.variables:
            *folders, name = variable.paths[0].split(".") if variable.paths else ("",)
            values.append(_inside(data, folders)[name] if variable.paths else 0.0)
        return np.clip((np.array(values) - self._low) / (self._high - self._low), 0.0, 1.0)

    def values(self, parameters: GaitParameters) -> dict[str, float]:
        """The searched numbers of a set by name, with units in the names."""
        data = parameters.model_dump(mode="json")
        found: dict[str, float] = {}
        for variable in self.variables:
            if variable.paths:
                *folders, name = variable.paths[0].split(".")
                value = _inside(data, folders)[name]
            else:
                offsets, base = (one.gaits[self._gait].phase_offsets for one in (parameters, self._base))
                value = round((offsets[2] - base[2] + 0.5) % 1.0 - 0.5, 6)
            found[f"{variable.name}{'' if variable.unit == '1' else f'_{variable.unit}'}"] = value
        return found


def _inside(data: Mapping[str, Any], folders: Sequence[str]) -> Any:
    found: Any = data
    for name in folders:
        found = found[name]
    return found
