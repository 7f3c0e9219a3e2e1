"""The numbers that are fitted: those that N does not print. Each has bounds, and a reason for them.

What N prints stays as printed, the spine's and the knees' stiffness too (table A.1).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nermo_description.parameters import RobotParameters

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Number:
    """One number, which may stand at several places of a robot's file."""

    name: str
    unit: str
    low: float
    high: float
    reason: str
    """For the bounds."""
    places: tuple[str, ...]
    """Where it stands, with dots between the fields."""
    log: bool = False
    """Searched on a logarithmic scale."""

    def share(self, value: float) -> float:
        """Where a value lies between the bounds, in [0, 1]."""
        low, high, value = (self._scaled(each) for each in (self.low, self.high, value))
        return min(max((value - low) / (high - low), 0.0), 1.0)

    def value(self, share: float) -> float:
        """The value at a share of the way between the bounds."""
        low, high = self._scaled(self.low), self._scaled(self.high)
        value = low + min(max(share, 0.0), 1.0) * (high - low)
        return float(f"{math.exp(value) if self.log else value:.6g}")

    def _scaled(self, value: float) -> float:
        return math.log(value) if self.log else value


NUMBERS = (
    Number(
        *("front_knee_rest", "rad", 0.32, 1.30),
        "from the form stop to 10 deg below the neutral stance (85 deg), where a tendon still pulls",
        ("front_leg_dynamics.knee.rest",),
    ),
    Number(
        *("rear_knee_rest", "rad", 1.15, 2.00),
        "from the form stop to 8 deg below the neutral stance (123 deg)",
        ("rear_leg_dynamics.knee.rest",),
    ),
    Number(
        *("ankle_stiffness", "N m/rad", 0.13, 1.2),
        "from that of the forelimb's knee (table A.1) to 1 deg under the whole weight on a foot: N's rigid ankle",
        ("front_leg_dynamics.ankle.stiffness", "rear_leg_dynamics.ankle.stiffness"),
        log=True,
    ),
    Number(
        *("leg_damping", "N m s/rad", 3e-4, 4e-3),
        "a twentieth of critical to nearly critical for a quarter of the mouse on a leg",
        tuple(f"{pair}_leg_dynamics.{joint}.damping" for pair in ("front", "rear") for joint in ("knee", "ankle")),
        log=True,
    ),
    Number(
        *("servo_gain", "N m/rad", 0.5, 3.0),
        "full torque at 18 to 3 deg of error: the softest and the stiffest of small servos",
        ("servo_type.proportional_gain",),
        log=True,
    ),
    Number(
        *("spine_damping", "N m s/rad", 2e-3, 3e-2),
        "a twentieth of critical to nearly critical for the rear torso on the chain",
        ("spine_dynamics.lateral.damping",),
        log=True,
    ),
    Number(
        *("front_com", "m", 0.0219, 0.0327),
        "the interval over which the balance table comes out (`nermo experiment balance`)",
        ("masses.front_com.0",),
    ),
    Number(
        *("friction", "1", 0.6, 2.5),
        "smooth plastic to rubber on a rubberised mat: N 6.1.3 has `high contact friction`",
        ("contact.friction",),
    ),
    Number(
        *("contact_time", "s", 2e-3, 1.5e-2),
        "two steps of the physics to a sole that sinks in by a millimetre",
        ("contact.solref_contact",),
        log=True,
    ),
)


def values_of(robot: RobotParameters, numbers: Sequence[Number] = NUMBERS) -> dict[str, float]:
    """The robot's own numbers; of a number that stands at several places, the first."""
    data = robot.model_dump()
    return {number.name: float(_at(data, number.places[0])) for number in numbers}


def point_of(robot: RobotParameters, numbers: Sequence[Number] = NUMBERS) -> Array:
    """The robot as a point of the unit cube, (n,)."""
    own = values_of(robot, numbers)
    return np.array([number.share(own[number.name]) for number in numbers])


def variant(
    robot: RobotParameters, values: Mapping[str, float], numbers: Sequence[Number] = NUMBERS
) -> RobotParameters:
    """The robot with other numbers. Raises ValueError where they do not fit together."""
    data = robot.model_dump()
    for number in numbers:
        for place in number.places if number.name in values else ():
            *way, last = place.split(".")
            inner = _at(data, ".".join(way))
            if isinstance(inner, tuple):  # of a vector one component is set, and the vector anew
                outer = _at(data, ".".join(way[:-1]))
                outer[way[-1]] = (*inner[: int(last)], values[number.name], *inner[int(last) + 1 :])
            else:
                inner[last] = values[number.name]
    return RobotParameters.model_validate(data)


def differences(values: Mapping[str, float], robot: RobotParameters) -> dict[str, Any]:
    """What a robot's file says of these numbers, as nested mappings."""
    data = variant(robot, values).model_dump(mode="json")
    result: dict[str, Any] = {}
    for number in NUMBERS:
        for place in number.places:
            way = [field for field in place.split(".") if not field.isdigit()]
            inner = result
            for field in way[:-1]:
                inner = inner.setdefault(field, {})
            inner[way[-1]] = _at(data, ".".join(way))
    return result


def _at(data: Any, place: str) -> Any:
    for field in place.split(".") if place else ():
        data = data[int(field)] if isinstance(data, list | tuple) else data[field]
    return data
