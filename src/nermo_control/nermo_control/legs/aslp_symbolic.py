"""The passive forces of the pantograph leg, derived by sympy from the places of its joints (C 2.2, 2.7, appendix A).

Angles as in `aslp`: `knee` k, `opening` o, and `toe` t, the direction of the toe from l3. In the frame of l1, whose
first axis points down along it and whose second points forward, K is the origin, P = (-l_delta, 0),
A = l2 (cos k, -sin k), Q = A - l_delta (cos o, sin o).
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import sympy

from nermo_description.pantograph import PantographLeg

Scalars = tuple[float, ...]


@dataclass(frozen=True, slots=True)
class MinimalFunctions:
    """A leg of which knee, opening and toe are the coordinates (C 2.2)."""

    lengths: Callable[[float, float], Scalars]
    """(k, o) to l_d and l_p [m]."""
    energy: Callable[[float, float, float], float]
    """(k, o, t) to the energy in the three springs [J]."""
    torques: Callable[[float, float, float, float, float, float], Scalars]
    """(k, o, t, k', o', t') to the generalised torques of springs and friction [N m] on k, o and t."""
    bound: Callable[[float], Scalars]
    """k to the largest opening B of (2.13) [rad] and its first two derivatives by k."""


@dataclass(frozen=True, slots=True)
class MasslessFunctions:
    """A leg without mass between hip and foot, of which only length L and foot angle theta are seen (C 2.7)."""

    closed: Callable[[float], float]
    """k to the length L of the closed leg [m]."""
    opening: Callable[[float, float], float]
    """(k, L) to the opening [rad] (NaN or ValueError where there is none)."""
    forces: Callable[[float, float, float], Scalars]
    """(k, L, theta) to the energy E, its derivatives by k, L and theta, and dl_d/dk, dl_p/dk, dl_p/dL, dt/dk, dt/dL."""
    ahead: Callable[[float, float], float]
    """(k, L) to the angle at the hip between l1 and the line to the foot [rad], positive where l1 is ahead."""


@functools.lru_cache(maxsize=16)
def minimal_functions(leg: PantographLeg) -> MinimalFunctions:
    """Derived and turned into functions of numbers once for each leg."""
    k, o, t, dk, do, dt = sympy.symbols("k o t dk do dt", real=True)
    diagonal, parallel = _struts(leg, k, o)
    energy = _energy(leg, diagonal, parallel, t)
    coordinates, rates = (k, o, t), (dk, do, dt)
    power = sum(
        sympy.Rational(1, 2) * damping * _rate(length, coordinates, rates) ** 2
        for damping, length in (
            (leg.diagonal_damping, diagonal),
            (leg.parallel_damping, parallel),
            (leg.toe_damping, t),
        )
    )
    torques = [-sympy.diff(energy, one) - sympy.diff(power, rate) for one, rate in zip(coordinates, rates, strict=True)]
    at_ankle = sympy.sqrt(leg.middle_length**2 + leg.spacing**2 + 2 * leg.middle_length * leg.spacing * sympy.cos(k))

    def beta(slider: float) -> Any:
        return sympy.acos((at_ankle**2 + leg.spacing**2 - slider**2) / (2 * at_ankle * leg.spacing))

    bound = beta(leg.middle_length + leg.parallel_travel) - beta(leg.middle_length)
    return MinimalFunctions(
        _function((k, o), (diagonal, parallel)),
        _function((k, o, t), energy),
        _function((k, o, t, dk, do, dt), torques),
        _function((k,), (bound, sympy.diff(bound, k), sympy.diff(bound, k, 2))),
    )


@functools.lru_cache(maxsize=16)
def massless_functions(leg: PantographLeg) -> MasslessFunctions:
    """Derived and turned into functions of numbers once for each leg."""
    k, length, theta = sympy.symbols("k L theta", real=True)
    l1, l2, b = leg.upper_length, leg.middle_length, leg.lower_length - leg.spacing
    # The cable's length and direction from the hip to A; l3 turns about A until the foot is L away.
    ankle = (l1 + l2 * sympy.cos(k), -l2 * sympy.sin(k))
    cable = sympy.sqrt(ankle[0] ** 2 + ankle[1] ** 2)
    opening = sympy.atan2(ankle[1], ankle[0]) + sympy.acos((length**2 - cable**2 - b**2) / (2 * cable * b))
    foot = (ankle[0] + b * sympy.cos(opening), ankle[1] + b * sympy.sin(opening))
    behind = sympy.atan2(foot[1], foot[0])
    toe = theta + behind - opening
    diagonal, parallel = _struts(leg, k, opening)
    energy = _energy(leg, diagonal, parallel, toe)
    arm = l1 + b
    closed = sympy.sqrt(arm**2 + l2**2 + 2 * arm * l2 * sympy.cos(k))
    facts = (
        energy,
        sympy.diff(energy, k),
        sympy.diff(energy, length),
        sympy.diff(energy, theta),
        sympy.diff(diagonal, k),
        sympy.diff(parallel, k),
        sympy.diff(parallel, length),
        sympy.diff(toe, k),
        sympy.diff(toe, length),
    )
    return MasslessFunctions(
        _function((k,), closed),
        _function((k, length), opening),
        _function((k, length, theta), facts),
        _function((k, length), -behind),
    )


def _struts(leg: PantographLeg, k: Any, o: Any) -> tuple[Any, Any]:
    """l_d and l_p as distances between the joints."""
    ankle = (leg.middle_length * sympy.cos(k), -leg.middle_length * sympy.sin(k))
    lower = (ankle[0] - leg.spacing * sympy.cos(o), ankle[1] - leg.spacing * sympy.sin(o))
    upper = (-leg.spacing, 0)
    return tuple(sympy.sqrt((one[0] - upper[0]) ** 2 + (one[1] - upper[1]) ** 2) for one in (ankle, lower))


def _energy(leg: PantographLeg, diagonal: Any, parallel: Any, toe: Any) -> Any:
    """(2.21), with the springs' free lengths."""
    return (
        leg.diagonal_stiffness * (diagonal - leg.diagonal_max - leg.diagonal_precompression) ** 2
        + leg.parallel_stiffness * (parallel - leg.middle_length + leg.parallel_precompression) ** 2
        + leg.toe_stiffness * (toe - leg.toe_rest) ** 2
    ) / 2


def _rate(length: Any, coordinates: tuple[Any, ...], rates: tuple[Any, ...]) -> Any:
    return sum(sympy.diff(length, one) * rate for one, rate in zip(coordinates, rates, strict=True))


def _function(arguments: tuple[Any, ...], expression: Any) -> Callable[..., Any]:
    """With plain floats: for one leg, math is ten times as fast as NumPy."""
    return sympy.lambdify(arguments, expression, modules="math", cse=True)
