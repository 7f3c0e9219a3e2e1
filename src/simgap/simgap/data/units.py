"""Units at the door: every column is converted to SI (radians, metres, newtons...) when it is read."""

from __future__ import annotations

import functools
from typing import Any

import pint

from simgap.data.errors import GapInputError

#: Quantity -> its SI unit. Angles keep the radian, so that a plain number or a hertz does not pass for one.
SI_UNITS: dict[str, str] = {
    "time": "s",
    "angle": "rad",
    "angular_velocity": "rad/s",
    "angular_acceleration": "rad/s^2",
    "length": "m",
    "velocity": "m/s",
    "acceleration": "m/s^2",
    "torque": "N m",
    "force": "N",
    "voltage": "V",
    "current": "A",
    "energy": "J",
    "magnetic_field": "T",
    "dimensionless": "1",
}

# Spellings that people write and pint reads as something else (Nm: nano-something; g: gram).
_ALIASES = {"Nm": "N m", "mNm": "mN m", "Ncm": "N cm", "-": "1", "none": "1", "degree": "deg", "degrees": "deg"}
_ACCELERATION_ALIASES = {"g": "standard_gravity", "mg": "millistandard_gravity"}


@functools.cache
def _registry() -> pint.UnitRegistry[Any]:
    registry: pint.UnitRegistry[Any] = pint.UnitRegistry()
    return registry


def _parse(unit: str, where: str) -> Any:
    try:
        return _registry().parse_units(unit)
    except Exception as error:  # pint raises a dozen kinds of error on a malformed unit; each means the same here
        raise GapInputError(f"{where}: unit {unit!r} is not a unit ({error})") from error


def factor(unit: str | None, quantities: tuple[str, ...], where: str) -> tuple[float, str]:
    """The factor from ``unit`` to the SI unit of the first of ``quantities`` that it fits.

    Args:
        unit: as written in the map, or None where it is missing.
        quantities: what the channel may be (keys of SI_UNITS).
        where: the row of the map, for the message.

    Returns:
        (factor, quantity): value_SI = factor * value.

    Raises:
        GapInputError: the unit is missing, unknown, or fits none of the quantities.
    """
    fits = " or ".join(f"{q} [{SI_UNITS[q]}]" for q in quantities)
    if unit is None or not str(unit).strip():
        raise GapInputError(f"{where}: the unit is missing; it must be one of {fits}")
    text = _ALIASES.get(unit.strip(), unit.strip())
    for quantity in quantities:
        spelled = _ACCELERATION_ALIASES.get(text, text) if quantity == "acceleration" else text
        parsed, target = _parse(spelled, where), _parse(SI_UNITS[quantity], where)
        same_dimension = parsed.dimensionality == target.dimensionality
        angular = ("radian" in str(_root(parsed))) == ("radian" in str(_root(target)))
        if same_dimension and angular:
            return float(_registry().Quantity(1.0, parsed).to(target).magnitude), quantity
    raise GapInputError(f"{where}: unit {unit!r} does not fit; this channel is {fits}")


def _root(unit: Any) -> Any:
    return _registry().Quantity(1.0, unit).to_root_units().units
