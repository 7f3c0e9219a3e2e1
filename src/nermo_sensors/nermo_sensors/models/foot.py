"""Forward model of tactile feet: from the force on each to the volts that the robot reads (C 4.2 and 4.3)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from nermo_sensors.models.amplifier import Converter, NonInvertingAmplifier
from nermo_sensors.models.memory import Creep, PlayHysteresis
from nermo_sensors.models.piezoelectric import ChargeResponse, RateAccelerationResponse
from nermo_sensors.models.piezoresistive import SoftConductance
from nermo_sensors.parameters import (
    ConverterParameters,
    PiezoelectricParameters,
    PiezoresistiveParameters,
    TactileParameters,
    load_tactile,
)


class PiezoresistiveCell:
    """One Velostat cell with hysteresis, creep and temperature drift behind its amplifier."""

    def __init__(self, parameters: PiezoresistiveParameters, converter: ConverterParameters) -> None:
        p = parameters
        self._law = SoftConductance(p.sensitivity, p.base_conductance, p.saturation_force, p.rounding)
        self._hysteresis = PlayHysteresis(p.play_slacks, p.play_weights)
        self._creep = Creep(p.creep_gains, p.creep_times)
        self._amplifier = NonInvertingAmplifier(p.feedback_resistance, p.reference_voltage)
        self._converter = _converter(converter)
        self._drift, self._reference = p.temperature_coefficient, p.reference_temperature

    def read(self, force: float, period: float, temperature: float, noise: float = 0.0) -> float:
        """[V] after `period` [s] in which the force went to `force` [N], at a temperature [degC]."""
        felt = self._hysteresis.step(force)
        gain = (1.0 + self._creep.step(force, period)) * (1.0 + self._drift * (temperature - self._reference))
        conductance = max(_soft(self._law, felt) * gain, 0.0)
        return self._converter.read(self._amplifier.voltage(conductance) + noise)

    def clear(self) -> None:
        """Forgets the past."""
        self._hysteresis.clear()
        self._creep.clear()


class PiezoelectricCell:
    """One PZT crystal with preload, lag, and leak of its charge amplifier."""

    def __init__(self, parameters: PiezoelectricParameters, converter: ConverterParameters) -> None:
        self._parameters = p = parameters
        self._charge_law = ChargeResponse(p.gain, p.leak)
        self._thesis_law = RateAccelerationResponse(
            p.rate_gain, p.rate_decay, p.acceleration_gain, p.acceleration_decay
        )
        self._converter = _converter(converter)
        self._felt = self._lagged = math.nan
        self._charge = self._rate = 0.0

    def read(self, force: float, period: float, frequency: float, offset: float = 0.0) -> float:
        """[V] after `period` [s] in which the force went to `force` [N].

        `frequency` [rad/s] of the load matters to the rate and acceleration response only; `offset` [V] is added.
        """
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


class TactileFeet:
    """The two cells of each foot, sampled together, with noise."""

    def __init__(self, parameters: TactileParameters | None = None, feet: int = 4, seed: int = 0) -> None:
        self.parameters = parameters or load_tactile("nermo_lite")
        p = self.parameters
        self._static = [PiezoresistiveCell(p.piezoresistive, p.piezoresistive_converter) for _ in range(feet)]
        self._dynamic = [PiezoelectricCell(p.piezoelectric, p.piezoelectric_converter) for _ in range(feet)]
        self._seed = seed
        self.temperature = p.piezoresistive.reference_temperature
        """[degC]"""
        self.clear()

    def read(self, forces: Sequence[float], period: float, frequency: float = 0.0) -> tuple[list[float], list[float]]:
        """Voltages [V] of the piezoresistive and of the piezoelectric cells.

        `forces`: normal force on each foot [N]; `period`: time since the last call [s]; `frequency`: of the load
        [rad/s]. The first call after the start or after `clear` knows no rate.

        Raises ValueError where the period is not positive or a force is not finite.
        """
        if not period > 0.0:
            raise ValueError(f"period = {period} s: must be above 0")
        if len(forces) != len(self._static) or not all(map(math.isfinite, forces)):
            raise ValueError(f"forces = {list(forces)} N: must be {len(self._static)} finite numbers")
        noise = self._random.standard_normal((2, len(forces)))
        static_noise = (noise[0] * self.parameters.piezoresistive.noise).tolist()
        dynamic_noise = (noise[1] * self.parameters.piezoelectric.noise + self._biases).tolist()
        return (
            [
                cell.read(force, period, self.temperature, error)
                for cell, force, error in zip(self._static, forces, static_noise, strict=True)
            ],
            [
                cell.read(force, period, frequency, error)
                for cell, force, error in zip(self._dynamic, forces, dynamic_noise, strict=True)
            ],
        )

    def clear(self) -> None:
        """Starts anew, as after a reset: the past is forgotten, biases are drawn."""
        self._random: Any = np.random.default_rng(self._seed)
        self._biases = self._random.standard_normal(len(self._static)) * self.parameters.piezoelectric.bias
        for static, dynamic in zip(self._static, self._dynamic, strict=True):
            static.clear()
            dynamic.clear()


def _converter(parameters: ConverterParameters) -> Converter:
    return Converter(parameters.lower, parameters.upper, parameters.bits)


def _soft(law: SoftConductance, force: float) -> float:
    """`law.conductance` for one float: an order of magnitude faster than through NumPy."""
    x = (law.saturation_force - force) / law.rounding
    below = max(x, 0.0) + math.log1p(math.exp(-abs(x)))
    return law.saturated - law.sensitivity * law.rounding * below
