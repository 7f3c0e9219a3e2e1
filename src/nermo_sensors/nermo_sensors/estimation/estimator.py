"""The leg-load estimator as the robot runs it: four feet, health, contact, and the four loads as one weight."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nermo_sensors.cells.piezoresistive import SoftConductance
from nermo_sensors.estimation.bank import FilterpyBank, KalmanBank
from nermo_sensors.estimation.contact import ContactDetector
from nermo_sensors.estimation.health import Expected, Fault, HealthLimits, HealthMonitor
from nermo_sensors.estimation.load_filter import LoadFilter, cell_models, make_model
from nermo_sensors.estimation.weight import share_weight
from nermo_sensors.models.amplifier import NonInvertingAmplifier
from nermo_sensors.parameters import Noises, TactileParameters

Array = NDArray[np.float64]

LONGEST_GAP = 0.1
"""A gap between samples that is longer is bridged in one step of this length, with the rest forgotten [s]."""
WEIGHT_ERROR = 0.29
"""Standard deviation of mass times the IMU's acceleration from what the feet bear, over the weight [1]. Measured on the
walking twin; on stiff knees it is 0.15. The IMU sits in one of two bodies, and knees that comply let them swing."""
WEIGHT_ERROR_AT_REST = 0.05
"""The same of a robot that does not walk: what its mass is known to (chosen: a battery or a cable more or less)."""
WEIGHT_FLOOR = 1e-2
"""Least variance of that [N^2]."""
LATE = 100_000_000
"""A sample older than the last by less is late and ignored; by more, the clock was set back [ns]."""


@dataclass(frozen=True, slots=True)
class LegLoads:
    """Estimates for one stamp, in the order of the feet."""

    stamp: int
    """[ns]"""
    load: Array
    """[N], 0 or more."""
    variance: Array
    """[N^2]"""
    contact_probability: Array
    contact: NDArray[np.bool_]
    since: NDArray[np.int64]
    """Stamp of the last touch-down or lift-off [ns]."""


class LegLoadEstimator:
    """Loads on the feet from their tactile cells.

    `estimator`: f1, f2 or memory. F1 and F2 run on filterpy, the memory filter in NumPy for all feet at once.
    """

    def __init__(
        self,
        parameters: TactileParameters,
        estimator: str = "memory",
        feet: int = 4,
        limits: HealthLimits | None = None,
        contact_force: float | None = None,
        contact_certainty: float = 0.9,
    ) -> None:
        self._parameters, self._estimator, self._feet = parameters, estimator, feet
        self.cells = tuple(parameters.cells.present)
        """Names of a foot's cells."""
        self._filters = self._make(parameters.noises)
        self.health = HealthMonitor(_expected(parameters), feet, limits)
        self.set_contact(contact_force or parameters.contact_force, contact_certainty)
        self._stamp: int | None = None
        self._loads: LegLoads | None = None
        self.restarts = 0
        """How often time ran backwards or a filter lost its covariance, and estimates began anew."""
        self.ignored = 0
        """Late or repeated samples."""

    def set_noises(self, noises: Noises) -> None:
        """Other covariances from now on; the estimates go on from where they are."""
        before = self._filters
        self._filters = self._make(noises)
        if self._stamp is not None:
            self._filters.bank = before.bank

    def set_contact(self, force: float, certainty: float) -> None:
        """Another threshold of contact [N] and certainty of its events. Raises ValueError."""
        self._contact = ContactDetector(self._feet, force, certainty)

    def clear(self) -> None:
        """Starts anew, as after a reset."""
        self._filters.clear()
        self.health.clear()
        self._stamp = self._loads = None

    def step(
        self,
        stamp: int,
        readings: Mapping[str, Sequence[float] | Array],
        frequency: float | None = None,
        swing: Sequence[bool] | None = None,
        weight: float | None = None,
    ) -> LegLoads | None:
        """Takes the readings [V] of a stamp [ns] by cell, one a foot; NaN where there is none.

        A cell that is not named has no reading; one that the feet do not have is not used. `frequency` of the gait
        [rad/s], None where the robot does not walk; `swing` says which legs are in the air by intention, None where
        nobody says: a foot without a cell that feels a resting load is set to no load there, so that the others do not
        drift. `weight` [N] is what
        all feet bear together, as the IMU says (`weight.felt_weight`), where that is known. Returns None before the
        second sample, and the last estimate for a sample that is late or repeated.

        Raises ValueError where a channel has a wrong number of readings.
        """
        voltages = self._in_order(readings)
        if self._stamp is not None and stamp <= self._stamp:
            if self._stamp - stamp < LATE:
                self.ignored += 1
                return self._loads
            self.clear()
            self.restarts += 1
        if self._stamp is None:
            self._stamp = stamp
            return None
        period = min((stamp - self._stamp) * 1e-9, LONGEST_GAP)
        self._stamp = stamp
        trusted = self.health.trusted
        self._filters.step(period, voltages, frequency, trusted)
        air = None if swing is None else np.asarray(swing, dtype=bool)
        # A robot that stopped mid-step may stand with a foot in the air, which says nothing about its cell.
        self.health.watch(period, voltages, self._filters.surprise, air if frequency else None)
        feels_rest = trusted[self.health.feels_rest].any(axis=0)
        if air is not None and not feels_rest.all():
            self._rest(air & ~feels_rest)
        self._repair()
        rests = swing is not None and not frequency
        self._loads = self._answer(stamp, weight, WEIGHT_ERROR_AT_REST if rests else WEIGHT_ERROR)
        return self._loads

    def broken(self) -> list[tuple[int, int, Fault]]:
        """Foot, cell (its place in `cells`) and fault of each cell that is not believed."""
        return [
            (foot, cell, fault)
            for cell, faults in enumerate(self.health.faults)
            for foot, fault in enumerate(faults)
            if fault is not Fault.NONE
        ]

    def _make(self, noises: Noises) -> LoadFilter:
        model = make_model(self._estimator, self._parameters.calibration, noises)
        bank = KalmanBank if self._estimator == "memory" else FilterpyBank
        return LoadFilter(model, self._feet, bank, cell_models(model, self._parameters.cells.present))

    def _in_order(self, readings: Mapping[str, Sequence[float] | Array]) -> Array:
        """(cells, feet) [V]; NaN where there is no number."""
        voltages = np.full((len(self.cells), self._feet), np.nan)
        for row, cell in zip(voltages, self.cells, strict=True):
            if cell in readings:
                if len(readings[cell]) != self._feet:
                    raise ValueError(f"{cell}: {len(readings[cell])} of them for {self._feet} feet")
                row[:] = readings[cell]
        voltages[~np.isfinite(voltages)] = np.nan
        return voltages

    def _rest(self, use: NDArray[np.bool_]) -> None:
        bank = self._filters.bank
        gradient = np.zeros_like(bank.x)
        gradient[:, 0] = 1.0
        bank.update(-bank.x[:, 0], gradient, (0.5 * self._parameters.contact_force) ** 2, use)

    def _repair(self) -> None:
        """A filter that is no longer finite, or whose covariance is none, starts anew; alone where it can."""
        bank = self._filters.bank
        variances = np.diagonal(bank.P, axis1=1, axis2=2)
        sound = np.isfinite(bank.x).all(axis=1) & np.isfinite(bank.P).all(axis=(1, 2)) & (variances >= 0.0).all(axis=1)
        sound &= bank.P[:, 0, 0] > 0.0
        if not sound.all():
            self._filters.clear()
            self.restarts += 1

    def _answer(self, stamp: int, weight: float | None, weight_error: float) -> LegLoads:
        load, variance = self._filters.load, self._filters.variance
        if weight is not None and math.isfinite(weight):
            load, variance = share_weight(load, variance, weight, (weight_error * weight) ** 2 + WEIGHT_FLOOR)
        probability = self._contact.step(stamp, load, variance)
        return LegLoads(
            stamp,
            np.maximum(load, 0.0),
            variance.copy(),
            probability,
            self._contact.contact.copy(),
            self._contact.since.copy(),
        )


def _expected(parameters: TactileParameters) -> list[Expected]:
    """Of each cell of the feet."""
    known = {"piezoresistive": _plausible(parameters)}
    return [Expected(cell.feels_rest, *known.get(name, ())) for name, cell in parameters.cells.present.items()]


def _plausible(parameters: TactileParameters) -> tuple[float, float]:
    """Less than the calibrated static cell ever reads, by a tenth of its range, and that range [V]."""
    m = parameters.calibration.memory
    law = SoftConductance(m.sensitivity, m.base_conductance, m.saturation_force, m.rounding)
    amplifier = NonInvertingAmplifier(m.feedback_resistance, m.reference_voltage)
    rest, top = (float(amplifier.voltage(float(law.conductance(force)))) for force in (-m.hysteresis_width, math.inf))
    return rest - 0.1 * (top - rest), top - rest
