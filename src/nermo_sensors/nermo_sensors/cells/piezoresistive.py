"""A Velostat cell (C 4.2 and 4.3.2): laws from force to conductance and volts, for arrays or floats, and the cell."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from nermo_description.parameters import Finite, NonNegative, Positive
from nermo_sensors.cells.cell import CellParameters
from nermo_sensors.models.amplifier import NonInvertingAmplifier
from nermo_sensors.models.hysteresis import Creep, PlayHysteresis

_LARGEST_EXPONENT = 500.0


@dataclass(frozen=True, slots=True)
class LinearConductance:
    """Linear with saturation at both ends, C (4.4)."""

    sensitivity: float
    """a1 [S/N]."""
    base: float
    """a2 [S]; may be negative: then the cell needs some load before it conducts."""
    saturated: float
    """a3 [S]."""

    @property
    def saturation_force(self) -> float:
        """F_sat [N], (4.5)."""
        return (self.saturated - self.base) / self.sensitivity

    def conductance(self, force: Any) -> Any:
        """[S] under a force [N]."""
        return np.clip(self.sensitivity * force + self.base, 0.0, self.saturated)

    def force(self, conductance: Any) -> Any:
        """[N]; NaN where the cell is saturated at either end, so that only a bound is known."""
        inside = (np.asarray(conductance) > 0.0) & (np.asarray(conductance) < self.saturated)
        return np.where(inside, (conductance - self.base) / self.sensitivity, np.nan)


@dataclass(frozen=True, slots=True)
class SoftConductance:
    """(4.4) with a rounded upper corner: smooth, rising everywhere and therefore invertible.

    G(F) = a3 - a1 w log(1 + exp((F_sat - F) / w)): far below F_sat it is a1 F + a2, far above it is a3.
    """

    sensitivity: float
    """a1 [S/N]."""
    base: float
    """a2 [S]."""
    saturation_force: float
    """F_sat [N], where the two straight lines meet (4.5)."""
    rounding: float
    """w [N], how wide the corner is."""

    @property
    def saturated(self) -> float:
        """a3 [S]."""
        return self.base + self.sensitivity * self.saturation_force

    def conductance(self, force: Any) -> Any:
        """[S] under a force [N]."""
        below = np.logaddexp(0.0, (self.saturation_force - force) / self.rounding)
        return self.saturated - self.sensitivity * self.rounding * below

    def slope(self, force: Any) -> Any:
        """dG/dF [S/N] under a force [N]."""
        exponent = np.minimum((force - self.saturation_force) / self.rounding, _LARGEST_EXPONENT)
        return self.sensitivity / (1.0 + np.exp(exponent))

    def force(self, conductance: Any) -> Any:
        """[N] for a conductance [S]; infinite from a3 on."""
        below = (self.saturated - np.asarray(conductance)) / (self.sensitivity * self.rounding)
        with np.errstate(divide="ignore", over="ignore"):
            # log(expm1(x)) without its overflow
            inverse = below + np.log(-np.expm1(-np.maximum(below, 0.0)))
        return self.saturation_force - self.rounding * inverse


@dataclass(frozen=True, slots=True)
class Sigmoid:
    """S(x) = a / (1 + exp(b (x + c))) + d, C (4.20); rising in x where a b < 0."""

    a: float
    b: float
    c: float
    d: float

    def value(self, x: Any) -> Any:
        """S(x)."""
        return self.a / (1.0 + np.exp(self._exponent(x))) + self.d

    def slope(self, x: Any) -> Any:
        """dS/dx."""
        share = 1.0 / (1.0 + np.exp(self._exponent(x)))
        return -self.a * self.b * share * (1.0 - share)

    def inverse(self, value: Any) -> Any:
        """X with S(x) = value; infinite outside the range of S."""
        share = (np.asarray(value) - self.d) / self.a
        with np.errstate(divide="ignore"):
            odds = np.log1p(-np.clip(share, 0.0, 1.0)) - np.log(np.clip(share, 0.0, 1.0))
        return odds / self.b - self.c

    @property
    def upper(self) -> float:
        """The larger of the two values that S goes to."""
        return max(self.d, self.a + self.d)

    def _exponent(self, x: Any) -> Any:
        return np.clip(self.b * (x + self.c), -_LARGEST_EXPONENT, _LARGEST_EXPONENT)


@dataclass(frozen=True, slots=True)
class SigmoidPair:
    """Hysteresis as C has it: one sigmoid for rising and one for falling forces, mixed by the rate, (4.21)."""

    rising: Sigmoid
    falling: Sigmoid
    switch: float
    """b of the mixing sigmoid [s/N]; negative, so that it is 1 for rising forces."""

    def voltage(self, force: Any, rate: Any) -> Any:
        """[V] for a force [N] and its rate [N/s]."""
        share = self._mix.value(rate)
        return share * self.rising.value(force) + (1.0 - share) * self.falling.value(force)

    def gradient(self, force: Any, rate: Any) -> tuple[Any, Any]:
        """dV/dF [V/N] and dV/dF' [V s/N]."""
        share = self._mix.value(rate)
        by_force = share * self.rising.slope(force) + (1.0 - share) * self.falling.slope(force)
        return by_force, self._mix.slope(rate) * (self.rising.value(force) - self.falling.value(force))

    @property
    def _mix(self) -> Sigmoid:
        return Sigmoid(1.0, self.switch, 0.0, 0.0)


class PiezoresistiveParameters(CellParameters):
    """A Velostat cell and its amplifier, as the twin and the simulated bench have it (C 4.2, 4.3.2, 4.3.3)."""

    sensitivity: Positive
    """a1 [S/N] of (4.4)."""
    base_conductance: Finite
    """a2 [S]."""
    saturation_force: Positive
    """F_sat [N], (4.5)."""
    rounding: Positive
    """Width of the corner before saturation [N]."""
    play_slacks: tuple[Positive, ...]
    """Of each play of the hysteresis [N]."""
    play_weights: tuple[NonNegative, ...]
    """Share of each play in what the cell feels [1]."""
    creep_gains: tuple[NonNegative, ...]
    """Relative gain of conductance that a constant load builds up [1/N], for each creep time."""
    creep_times: tuple[Positive, ...]
    """[s]"""
    temperature_coefficient: Finite
    """Relative gain of conductance [1/K]."""
    feedback_resistance: Positive
    """R_F [ohm] of (4.2)."""
    reference_voltage: Positive
    """V_REF [V] of (4.2)."""

    def make(self) -> PiezoresistiveCell:
        """As `CellParameters` says."""
        return PiezoresistiveCell(self)


class PiezoresistiveCell:
    """One Velostat cell with hysteresis, creep and temperature drift behind its amplifier."""

    def __init__(self, parameters: PiezoresistiveParameters) -> None:
        p = parameters
        self._law = SoftConductance(p.sensitivity, p.base_conductance, p.saturation_force, p.rounding)
        self._hysteresis = PlayHysteresis(p.play_slacks, p.play_weights)
        self._creep = Creep(p.creep_gains, p.creep_times)
        self._amplifier = NonInvertingAmplifier(p.feedback_resistance, p.reference_voltage)
        self._converter = p.converter.make()
        self._drift, self._reference = p.temperature_coefficient, p.reference_temperature

    def read(self, force: float, period: float, frequency: float, temperature: float, offset: float = 0.0) -> float:
        """As `Cell` says."""
        felt = self._hysteresis.step(force)
        gain = (1.0 + self._creep.step(force, period)) * (1.0 + self._drift * (temperature - self._reference))
        conductance = max(_soft(self._law, felt) * gain, 0.0)
        return self._converter.read(self._amplifier.voltage(conductance) + offset)

    def clear(self) -> None:
        """Forgets the past."""
        self._hysteresis.clear()
        self._creep.clear()


def _soft(law: SoftConductance, force: float) -> float:
    """`law.conductance` for one float: an order of magnitude faster than through NumPy."""
    x = (law.saturation_force - force) / law.rounding
    below = max(x, 0.0) + math.log1p(math.exp(-abs(x)))
    return law.saturated - law.sensitivity * law.rounding * below
