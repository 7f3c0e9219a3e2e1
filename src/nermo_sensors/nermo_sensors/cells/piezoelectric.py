"""A PZT crystal and its amplifier (C 4.3.2.2): three laws from changes of force to volts, and the cell."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from nermo_description.parameters import Finite, NonNegative, Positive
from nermo_sensors.cells.cell import CellParameters


@dataclass(frozen=True, slots=True)
class RateResponse:
    """V = gain F': the ideal stress-rate sensor, as F1 assumes (C 4.3.1.1)."""

    gain: float
    """[V s/N]"""
    offset: float = 0.0
    """[V]"""

    def voltage(self, rate: Any) -> Any:
        """[V] for a rate [N/s]."""
        return self.gain * rate + self.offset

    def rate(self, voltage: Any) -> Any:
        """[N/s] for a voltage [V]; the inverse of `voltage`."""
        return (voltage - self.offset) / self.gain


@dataclass(frozen=True, slots=True)
class RateAccelerationResponse:
    """V = k_r exp(-w / w_r) F' + k_a exp(-w / w_a) F'': what C finds on its bench, w being the cam's frequency.

    Both gains fall exponentially with the frequency (C 4.3.2.2). A law of the period as a whole, not of the instant.
    """

    rate_gain: float
    """k_r [V s/N]"""
    rate_decay: float
    """w_r [rad/s]"""
    acceleration_gain: float
    """k_a [V s^2/N]"""
    acceleration_decay: float
    """w_a [rad/s]"""
    offset: float = 0.0
    """[V]"""

    def gains(self, frequency: Any) -> tuple[Any, Any]:
        """Gains of the rate [V s/N] and of the acceleration [V s^2/N] at a frequency [rad/s]."""
        frequency = np.maximum(frequency, 0.0)
        return (
            self.rate_gain * np.exp(-frequency / self.rate_decay),
            self.acceleration_gain * np.exp(-frequency / self.acceleration_decay),
        )

    def voltage(self, rate: Any, acceleration: Any, frequency: Any) -> Any:
        """[V] for a rate [N/s], an acceleration of the force [N/s^2] and a frequency [rad/s]."""
        by_rate, by_acceleration = self.gains(frequency)
        return by_rate * rate + by_acceleration * acceleration + self.offset


@dataclass(frozen=True, slots=True)
class ChargeResponse:
    """A charge amplifier whose charge leaks: what C's circuit (figure 4.6b) does, with the silicone's lag.

    V = gain (q - lag q'), q' = F' - q / leak. For a sine of frequency w this is rate and acceleration with gains that
    fall as 1 / (1 + w^2 leak^2): the observation that C puts into `RateAccelerationResponse`.
    """

    gain: float
    """[V/N]"""
    leak: float
    """Time constant R_F C_F of the amplifier [s]."""
    lag: float = 0.0
    """Delay of the silicone in front of the crystal [s]."""
    offset: float = 0.0
    """[V]"""

    def advance(self, charge: Any, change: Any, period: float) -> Any:
        """Charge [N] a period [s] later, while the force changed by `change` [N] at a constant rate."""
        remain, share = self.transition(period)
        return remain * charge + share * change

    def transition(self, period: float) -> tuple[float, float]:
        """What remains of the charge after a period [s], and what a change of force adds to it."""
        remain = math.exp(-period / self.leak)
        return remain, -math.expm1(-period / self.leak) * self.leak / period

    def voltage(self, charge: Any, rate: Any) -> Any:
        """[V] for a charge [N] and the force's rate [N/s]."""
        return self.gain * ((1.0 + self.lag / self.leak) * charge - self.lag * rate) + self.offset


class PiezoelectricParameters(CellParameters):
    """A PZT crystal and its charge amplifier, as the twin and the simulated bench have it (C 4.3.2)."""

    feels_rest = False

    response: Literal["charge_amplifier", "rate_and_acceleration"]
    """Which of the two laws above it follows."""
    gain: Positive
    """[V/N], of the charge amplifier."""
    leak: Positive
    """Time constant of the charge amplifier [s]."""
    lag: NonNegative
    """Of the silicone [s]."""
    rate_gain: Finite
    """k_r [V s/N]"""
    rate_decay: Positive
    """[rad/s]"""
    acceleration_gain: Finite
    """k_a [V s^2/N]"""
    acceleration_decay: Positive
    """[rad/s]"""
    preload: NonNegative
    """Force that the cell is mounted with [N] (C 4.3.2.2)."""
    seating_force: NonNegative
    """Below this total force [N] air gaps hide changes from the crystal; a larger preload cures it."""

    def make(self) -> PiezoelectricCell:
        """As `CellParameters` says."""
        return PiezoelectricCell(self)


class PiezoelectricCell:
    """One PZT crystal with preload, lag, and leak of its charge amplifier."""

    def __init__(self, parameters: PiezoelectricParameters) -> None:
        self._parameters = p = parameters
        self._charge_law = ChargeResponse(p.gain, p.leak)
        self._thesis_law = RateAccelerationResponse(
            p.rate_gain, p.rate_decay, p.acceleration_gain, p.acceleration_decay
        )
        self._converter = p.converter.make()
        self._felt = self._lagged = math.nan
        self._charge = self._rate = 0.0

    def read(self, force: float, period: float, frequency: float, temperature: float, offset: float = 0.0) -> float:
        """As `Cell` says; the frequency matters to the rate and acceleration response only."""
        p = self._parameters
        felt = max(force + p.preload - p.seating_force, 0.0)
        if math.isnan(self._felt):
            self._felt = self._lagged = felt
        rate = (felt - self._felt) / period
        self._felt = felt
        if p.response == "rate_and_acceleration":
            acceleration, self._rate = (rate - self._rate) / period, rate
            by_rate, by_acceleration = self._thesis_law.gains(frequency)
            voltage = float(by_rate * rate + by_acceleration * acceleration)
        else:
            before = self._lagged
            self._lagged += (felt - before) * (-math.expm1(-period / p.lag) if p.lag > 0.0 else 1.0)
            self._charge = self._charge_law.advance(self._charge, self._lagged - before, period)
            voltage = p.gain * self._charge
        return self._converter.read(voltage + offset)

    def clear(self) -> None:
        """Forgets the past; the next force is taken to have rested on the foot for long."""
        self._felt = self._lagged = math.nan
        self._charge = self._rate = 0.0
