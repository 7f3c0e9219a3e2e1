"""One step of B leg-load filters: predict, then take in whatever readings there are."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from nermo_sensors.cells.cell import CellParameters
from nermo_sensors.estimation.bank import FilterBank, KalmanBank
from nermo_sensors.estimation.memory import MemoryModel
from nermo_sensors.estimation.model import CellModel, LoadModel, Reading
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


def cell_models(model: LoadModel, cells: Mapping[str, CellParameters]) -> dict[str, CellModel]:
    """Of a foot's cells: as the filter's model has them, or else as a law of the present load."""
    return {name: model.cells.get(name) or _law_of_load(cell) for name, cell in cells.items()}


def _law_of_load(cell: CellParameters) -> CellModel:
    def read(x: Array, voltage: Array) -> Reading:
        gradient = np.zeros_like(x)
        value, gradient[:, 0] = cell.expected(x[:, 0])
        return Reading(np.asarray(value), gradient)

    return CellModel(read, cell.variance)


class LoadFilter:
    """B filters of one model. Readings may be missing (NaN), in any combination.

    cells: what there is to read; by default the cells that the model has.
    """

    def __init__(
        self,
        model: LoadModel,
        count: int,
        bank: Callable[[Array, Array], FilterBank] = KalmanBank,
        cells: Mapping[str, CellModel] | None = None,
    ) -> None:
        self.model, self._count, self._bank = model, count, bank
        self._cells = tuple((model.cells if cells is None else cells).values())
        self.clear()

    def clear(self) -> None:
        """Forgets all readings."""
        self.bank = self._bank(*self.model.start(self._count))
        self.prediction: tuple[Array, Array] | None = None
        """States that the last step began with, before its readings, and the Jacobian that led there."""
        self.surprise = np.full((len(self._cells), self._count), np.nan)
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
        readings: Array,
        frequency: float | None = None,
        trusted: NDArray[np.bool_] | None = None,
    ) -> None:
        """Goes on by a period [s] and takes in voltages (cells, B) [V] and the load's frequency [rad/s], where known.

        `trusted` (cells, B) says which cells to believe; the others are only compared with what is expected of them.

        Raises ValueError for a period that is not positive.
        """
        if not (period > 0.0 and math.isfinite(period)):
            raise ValueError(f"period = {period} s: must be finite and above 0")
        model, bank = self.model, self.bank
        x, P = bank.x, bank.P
        self.prediction = model.predict(x, period)
        bank.predict(*self.prediction, model.process(period))
        expected = bank.x[:, 0]
        believed = np.ones(self.surprise.shape, dtype=bool) if trusted is None else trusted
        self._take_all(readings, frequency, believed)
        moved = np.abs(bank.x[:, 0] - expected) > model.bend
        if moved.any():
            # A foot that lands goes through the whole hysteresis within a tick: once more, with slopes as far as that.
            towards = np.where(moved, bank.x[:, 0], expected)
            bank.restore(x, P)
            self.prediction = model.predict(x, period, towards)
            bank.predict(*self.prediction, model.process(period))
            self._take_all(readings, frequency, believed)

    def _take_all(self, readings: Array, frequency: float | None, believed: NDArray[np.bool_]) -> None:
        bank = self.bank
        if frequency is not None and math.isfinite(frequency):
            answer = self.model.observe_frequency(frequency)
            if answer is not None:
                reading, variance = answer
                where = int(np.argmax(reading.gradient[0]))
                gradient = np.repeat(reading.gradient, self._count, axis=0)
                bank.update(reading.value - bank.x[:, where], gradient, variance, np.ones(self._count, dtype=bool))
        for number, cell in enumerate(self._cells):
            self._take(number, cell, readings[number], believed[number])

    def _take(self, number: int, cell: CellModel, voltage: Array, believed: NDArray[np.bool_]) -> None:
        present = np.isfinite(voltage)
        if not present.any():
            self.surprise[number] = np.nan
            return
        bank, use = self.bank, present & believed
        voltage = np.where(present, voltage, 0.0)
        saturated, bound = (None, None) if cell.saturation is None else cell.saturation(voltage, bank.x)
        reading = cell.read(bank.x, voltage)
        residual = voltage - reading.value
        plain = use if saturated is None else use & ~saturated
        expected = bank.update(residual, reading.gradient, cell.variance, plain)
        self.surprise[number] = residual * residual / expected
        if saturated is not None and bound is not None and saturated.any():
            bank.raise_to(0, bound, saturated & use & (bank.x[:, 0] < bound), cell.bound_variance)
            self.surprise[number, saturated] = np.nan
