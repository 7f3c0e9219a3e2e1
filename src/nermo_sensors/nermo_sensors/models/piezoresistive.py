"""From force to conductance and volts: the static laws of a Velostat cell (C 4.2 and 4.3.2). NumPy arrays or floats."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

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
