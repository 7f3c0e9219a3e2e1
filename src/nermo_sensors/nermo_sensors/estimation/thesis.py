"""C's two models: F1 with rate only (C (4.6)-(4.8)) and F2 with acceleration and frequency (C (4.14)-(4.16))."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nermo_sensors.cells.piezoelectric import RateAccelerationResponse, RateResponse
from nermo_sensors.cells.piezoresistive import Sigmoid, SigmoidPair
from nermo_sensors.estimation.model import CellModel, Mask, Reading
from nermo_sensors.parameters import (
    AccelerationNoise,
    PairCalibration,
    RateAccelerationCalibration,
    RateCalibration,
    RateNoise,
)

Array = NDArray[np.float64]

SATURATION_SHARE = 0.95
"""From this share of the pair's rise on, a reading only says that the load is at least so large."""


class _PairModel(ABC):
    """What F1 and F2 share: the static cell as a pair of sigmoids (4.21)."""

    states: tuple[str, ...]
    bend = math.inf

    def __init__(self, pair: PairCalibration, noise: RateNoise) -> None:
        self.cells = {
            "piezoresistive": CellModel(self.piezoresistive, noise.piezoresistive, self.saturation),
            "piezoelectric": CellModel(self.piezoelectric, noise.piezoelectric),
        }
        rising, falling = (Sigmoid(s.a, s.b, s.c, s.d) for s in (pair.rising, pair.falling))
        self._pair = SigmoidPair(rising, falling, pair.switch)
        top = min(rising.upper, falling.upper)
        bottom = max(rising.upper - abs(rising.a), falling.upper - abs(falling.a))
        self._saturated = bottom + SATURATION_SHARE * (top - bottom)
        # A falling force reads more than a rising one: only the falling branch bounds the load from below.
        self._proven = float(min(rising.inverse(self._saturated), falling.inverse(self._saturated)))

    @abstractmethod
    def piezoelectric(self, x: Array, voltage: Array) -> Reading:
        """What the dynamic cell reads."""

    def piezoresistive(self, x: Array, voltage: Array) -> Reading:
        """What the static cell reads."""
        gradient = np.zeros_like(x)
        gradient[:, 0], gradient[:, 1] = self._pair.gradient(x[:, 0], x[:, 1])
        return Reading(self._pair.voltage(x[:, 0], x[:, 1]), gradient)

    def saturation(self, voltage: Array, x: Array) -> tuple[Mask, Array]:
        """Which readings of the static cell are saturated, and the load that they prove."""
        return voltage > self._saturated, np.full(len(voltage), self._proven)


class RateModel(_PairModel):
    """F1: load, rate, and a bias D on the piezoelectric reading; x = (F, F', D)."""

    states: tuple[str, ...] = ("load", "rate", "bias")

    def __init__(self, pair: PairCalibration, rate: RateCalibration, noise: RateNoise) -> None:
        super().__init__(pair, noise)
        self._law = RateResponse(rate.gain, rate.offset)
        self._noise = noise

    def start(self, count: int) -> tuple[Array, Array]:
        return np.zeros((count, 3)), np.tile(np.diag([25.0, 1e3, 1e-2]), (count, 1, 1))

    def predict(self, x: Array, period: float, towards: Array | None = None) -> tuple[Array, Array]:
        transition = np.array([[1.0, period, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
        return x @ transition.T, transition

    def process(self, period: float) -> Array:
        return _stack(self._noise.force, self._noise.rate, self._noise.bias) * period

    def piezoelectric(self, x: Array, voltage: Array) -> Reading:
        """What the dynamic cell reads."""
        gradient = np.zeros_like(x)
        gradient[:, 1], gradient[:, 2] = self._law.gain, 1.0
        return Reading(self._law.voltage(x[:, 1]) + x[:, 2], gradient)

    def observe_frequency(self, frequency: float) -> tuple[Reading, float] | None:
        return None


class AccelerationModel(_PairModel):
    """F2: load, rate, acceleration, frequency w and bias; x = (F, F', F'', w, D)."""

    states: tuple[str, ...] = ("load", "rate", "acceleration", "frequency", "bias")

    def __init__(self, pair: PairCalibration, law: RateAccelerationCalibration, noise: AccelerationNoise) -> None:
        super().__init__(pair, noise)
        self._law = RateAccelerationResponse(
            law.rate_gain, law.rate_decay, law.acceleration_gain, law.acceleration_decay, law.offset
        )
        self._noise = noise

    def start(self, count: int) -> tuple[Array, Array]:
        x = np.zeros((count, 5))
        x[:, 3] = 2.0 * np.pi
        return x, np.tile(np.diag([25.0, 1e3, 1e4, 100.0, 1e-2]), (count, 1, 1))

    def predict(self, x: Array, period: float, towards: Array | None = None) -> tuple[Array, Array]:
        transition = np.eye(5)
        transition[0, 1] = transition[1, 2] = period
        transition[0, 2] = 0.5 * period * period
        return x @ transition.T, transition

    def process(self, period: float) -> Array:
        n = self._noise
        return _stack(n.force, n.rate, n.acceleration, n.frequency, n.bias) * period

    def piezoelectric(self, x: Array, voltage: Array) -> Reading:
        """What the dynamic cell reads."""
        by_rate, by_acceleration = self._law.gains(x[:, 3])
        gradient = np.zeros_like(x)
        gradient[:, 1], gradient[:, 2], gradient[:, 4] = by_rate, by_acceleration, 1.0
        gradient[:, 3] = np.where(
            x[:, 3] > 0.0,
            -by_rate / self._law.rate_decay * x[:, 1] - by_acceleration / self._law.acceleration_decay * x[:, 2],
            0.0,
        )
        return Reading(self._law.voltage(x[:, 1], x[:, 2], x[:, 3]) + x[:, 4], gradient)

    def observe_frequency(self, frequency: float) -> tuple[Reading, float] | None:
        return Reading(np.array([frequency]), np.array([[0.0, 0.0, 0.0, 1.0, 0.0]])), self._noise.frequency_reading


def _stack(*variances: Any) -> Array:
    """(n,) from numbers, (B, n) where one of them is (B,)."""
    return np.stack(np.broadcast_arrays(*variances), axis=-1).astype(np.float64)
