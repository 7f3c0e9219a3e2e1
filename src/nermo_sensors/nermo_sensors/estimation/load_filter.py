"""One step of B leg-load filters: predict, then take in whatever readings there are."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from nermo_sensors.estimation.bank import FilterBank, KalmanBank
from nermo_sensors.estimation.memory import MemoryModel
from nermo_sensors.estimation.model import LoadModel, Reading
from nermo_sensors.estimation.thesis import AccelerationModel, RateModel
from nermo_sensors.parameters import Calibration, Noises

Array = NDArray[np.float64]

ESTIMATORS = ("f1", "f2", "memory")
"""F1 and F2 of C 4.3.1.1, and ours."""


def make_model(estimator: str, calibration: Calibration, noises: Noises) -> LoadModel:
    """A model by its name. Raises ValueError for an unknown one."""
    if estimator == "f1":
        return RateModel(calibration.pair, calibration.rate, noises.f1)
    if estimator == "f2":
        return AccelerationModel(calibration.pair, calibration.rate_acceleration, noises.f2)
    if estimator == "memory":
        return MemoryModel(calibration, noises.memory)
    raise ValueError(f"estimator: {estimator!r} is not one of {', '.join(ESTIMATORS)}")


class LoadFilter:
    """B filters of one model. Readings may be missing (NaN), in any combination."""

    def __init__(self, model: LoadModel, count: int, bank: Callable[[Array, Array], FilterBank] = KalmanBank) -> None:
        self.model, self._count, self._bank = model, count, bank
        self.clear()

    def clear(self) -> None:
        """Forgets all readings."""
        self.bank = self._bank(*self.model.start(self._count))
        self.surprise = np.full((2, self._count), np.nan)
        """Squared residual of the last reading over its expected variance, for each cell; about 1 where all is well."""

    @property
    def load(self) -> Array:
        """(B,) [N]"""
        return self.bank.x[:, 0]

    @property
    def variance(self) -> Array:
        """(B,) of the load [N^2]"""
        return self.bank.P[:, 0, 0]

    def step(
        self,
        period: float,
        piezoresistive: Array,
        piezoelectric: Array,
        frequency: float | None = None,
        trusted: NDArray[np.bool_] | None = None,
    ) -> None:
        """Goes on by a period [s] and takes in the voltages (B,) [V] and the load's frequency [rad/s], where known.

        `trusted` (2, B) says which cells to believe; the others are only compared with what is expected of them.

        Raises ValueError for a period that is not positive.
        """
        if not (period > 0.0 and math.isfinite(period)):
            raise ValueError(f"period = {period} s: must be finite and above 0")
        model, bank = self.model, self.bank
        bank.predict(*model.predict(bank.x, period), model.process(period))
        if frequency is not None and math.isfinite(frequency):
            answer = model.observe_frequency(frequency)
            if answer is not None:
                reading, variance = answer
                where = int(np.argmax(reading.gradient[0]))
                gradient = np.repeat(reading.gradient, self._count, axis=0)
                bank.update(reading.value - bank.x[:, where], gradient, variance, np.ones(self._count, dtype=bool))
        believed = np.ones((2, self._count), dtype=bool) if trusted is None else trusted
        present = np.isfinite(piezoresistive)
        if present.any():
            voltage = np.where(present, piezoresistive, 0.0)
            saturated, bound = model.saturation(voltage, bank.x)
            plain = present & believed[0] & ~saturated
            self._take(0, voltage, model.piezoresistive(bank.x, voltage), model.piezoresistive_variance, plain)
            if saturated.any():
                below = saturated & present & believed[0] & (bank.x[:, 0] < bound)
                bank.raise_to(0, bound, below, model.bound_variance)
                self.surprise[0, saturated] = np.nan
        else:
            self.surprise[0] = np.nan
        present = np.isfinite(piezoelectric)
        if present.any():
            voltage = np.where(present, piezoelectric, 0.0)
            use = present & believed[1]
            self._take(1, voltage, model.piezoelectric(bank.x), model.piezoelectric_variance, use)
        else:
            self.surprise[1] = np.nan

    def _take(self, cell: int, voltage: Array, reading: Reading, variance: object, use: NDArray[np.bool_]) -> None:
        residual = voltage - reading.value
        expected = self.bank.update(residual, reading.gradient, variance, use)
        self.surprise[cell] = residual * residual / expected
