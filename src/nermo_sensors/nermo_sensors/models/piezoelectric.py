"""From changes of force to volts: three laws of a PZT crystal behind its amplifier (C 4.3.2.2). Arrays or floats."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np


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
