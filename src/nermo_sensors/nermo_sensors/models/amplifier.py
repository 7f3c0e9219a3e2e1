"""From conductance to volts to counts: the non-inverting amplifier (C (4.2), figure 4.3) and its converter."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, slots=True)
class NonInvertingAmplifier:
    """V_O = (1 + R_F / R_PZR) V_REF, C (4.2)."""

    feedback_ohm: float = 75e3
    """R_F [ohm] (C 4.2.3)."""
    reference_v: float = 0.25
    """V_REF [V] (C 4.2.3)."""

    def voltage(self, conductance: Any) -> Any:
        """Output [V] for the cell's conductance [S]."""
        return (1.0 + self.feedback_ohm * conductance) * self.reference_v

    def conductance(self, voltage: Any) -> Any:
        """The cell's conductance [S] for an output [V]; the inverse of `voltage`."""
        return (voltage / self.reference_v - 1.0) / self.feedback_ohm


@dataclass(frozen=True, slots=True)
class Converter:
    """Analog to digital converter: range and resolution."""

    lower_v: float
    upper_v: float
    bits: int

    @property
    def step_v(self) -> float:
        """One count [V]."""
        return (self.upper_v - self.lower_v) / (2**self.bits - 1)

    def read(self, voltage: float) -> float:
        """The voltage [V] that the converter reports: clipped to its range and rounded to a count."""
        clipped = min(max(voltage, self.lower_v), self.upper_v)
        return self.lower_v + round((clipped - self.lower_v) / self.step_v) * self.step_v

    def is_saturated(self, voltage: float) -> bool:
        """Whether a reported voltage stands at an end of the range, so that only a bound is known."""
        return voltage >= self.upper_v - 0.5 * self.step_v or voltage <= self.lower_v + 0.5 * self.step_v
