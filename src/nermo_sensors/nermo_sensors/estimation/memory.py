"""Our model: both cells have a memory, and it is part of the state."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nermo_sensors.cells.piezoelectric import ChargeResponse, RateAccelerationResponse
from nermo_sensors.cells.piezoresistive import SoftConductance
from nermo_sensors.estimation.model import CellModel, Mask, Reading
from nermo_sensors.models.amplifier import NonInvertingAmplifier
from nermo_sensors.models.hysteresis import LoopPlays
from nermo_sensors.parameters import Calibration, MemoryNoise

Array = NDArray[np.float64]

LOAD, RATE, ACCELERATION, CREEP, LOAD_ERROR, BIAS, CHARGE = range(7)
PLAYS = slice(7, None)

PLAY_COUNT = 4
"""Plays of the static cell's hysteresis. On the bench, where it makes full loops, 3 are off by 0.004 N more than Dahl's
law that they stand for, 4 to 10 are not."""
BEND = 0.01
"""A load that moves by more than this share of the reversal force in one step has bent the hysteresis [1]."""
SATURATION_SHARE = 0.97
"""From this share of the conductance's range on, a reading bounds the load from below only."""


@dataclass(frozen=True, slots=True)
class _Prepared:
    period: float
    jacobian: Array
    """(1 or B, n, n), the plays left out."""
    variances: Array
    """(n,) or (B, n)"""


class MemoryModel:
    """x = (F, F', F'', c, e, D, q, p1, p2, ...).

    c is the creep's relative gain, e [N] what the static cell's model gets wrong for a while, D [V] likewise for the
    dynamic cell, q [N] the charge left in its amplifier, p [N] the places of the hysteresis' plays (`LoopPlays`). The
    static cell reads amplifier((1 + c) G(elastic F + weight (p1 + p2 + ...) + e)).
    """

    states: tuple[str, ...] = (
        *("load", "rate", "acceleration", "creep", "load_error", "bias", "charge"),
        *(f"play_{number}" for number in range(PLAY_COUNT)),
    )

    def __init__(self, calibration: Calibration, noise: MemoryNoise) -> None:
        m = calibration.memory
        self._memory = m
        self._law = SoftConductance(m.sensitivity, m.base_conductance, m.saturation_force, m.rounding)
        self._plays = LoopPlays.of_loop(m.hysteresis_width, m.reversal_force, PLAY_COUNT)
        self.bend = BEND * m.reversal_force
        self._amplifier = NonInvertingAmplifier(m.feedback_resistance, m.reference_voltage)
        self._volts = m.feedback_resistance * m.reference_voltage
        saturated = m.base_conductance + SATURATION_SHARE * (self._law.saturated - m.base_conductance)
        self._saturated = float(self._amplifier.voltage(saturated))
        self._highest = float(self._law.conductance(m.saturation_force + 5.0 * m.rounding))
        self._proven = float(self._law.force(saturated)) - m.hysteresis_width
        self._charge = ChargeResponse(
            calibration.charge.gain, calibration.charge.leak, calibration.charge.lag, calibration.charge.offset
        )
        r = calibration.rate_acceleration
        self._thesis_law = RateAccelerationResponse(
            r.rate_gain, r.rate_decay, r.acceleration_gain, r.acceleration_decay, r.offset
        )
        self._by_charge = calibration.law == "charge"
        self._gains = self._thesis_law.gains(2.0 * math.pi)
        self._noise = noise
        # The threshold is a reading like any other, and where the curve is flat it says little about the load.
        slope = self._volts * float(self._law.slope(self._law.force(saturated)))
        self.cells = {
            "piezoresistive": CellModel(
                self.piezoresistive, noise.piezoresistive, self.saturation, noise.piezoresistive / slope**2
            ),
            "piezoelectric": CellModel(self.piezoelectric, noise.piezoelectric),
        }
        self._prepared: _Prepared | None = None

    def start(self, count: int) -> tuple[Array, Array]:
        F = self._memory.saturation_force
        n = self._noise
        size = len(self.states)
        variances = [F * F, 100.0 * F * F, 1e4 * F * F, 1e-3, n.load_error, n.bias, 0.01 * F * F]
        P = np.zeros((count, size, size))
        for state, variance in enumerate((*variances, *self._plays.slacks**2)):
            P[:, state, state] = variance
        return np.zeros((count, size)), P

    def predict(self, x: Array, period: float, towards: Array | None = None) -> tuple[Array, Array]:
        prepared, plays = self._for(period), self._plays
        # All but the plays is linear.
        after = (prepared.jacobian @ x[:, :, None])[:, :, 0]
        load, before = after[:, LOAD], x[:, PLAYS]
        after[:, PLAYS] = plays.step(before, load)
        there = load if towards is None else towards
        drags = plays.drags(before, there)
        apart = (there - load)[:, None]
        far = np.abs(apart) > 1e-9
        by_load = np.where(far, (plays.step(before, there) - after[:, PLAYS]) / np.where(far, apart, 1.0), drags)
        jacobian = np.empty((len(x), x.shape[1], x.shape[1]))
        jacobian[:] = prepared.jacobian
        jacobian[:, PLAYS, : ACCELERATION + 1] = (
            by_load[:, :, None] * prepared.jacobian[:, None, LOAD, : ACCELERATION + 1]
        )
        numbers = np.arange(PLAYS.start, x.shape[1])
        jacobian[:, numbers, numbers] = ~drags
        return after, jacobian

    def process(self, period: float) -> Array:
        return self._for(period).variances

    def piezoresistive(self, x: Array, voltage: Array) -> Reading:
        """What the static cell reads; the slope is taken towards `voltage`."""
        plays = self._plays
        felt = plays.elastic * x[:, LOAD] + plays.weight * x[:, PLAYS].sum(axis=1) + x[:, LOAD_ERROR]
        gain = 1.0 + x[:, CREEP]
        conductance = self._law.conductance(felt)
        # The slope is taken as the secant to where the reading says that the cell is: a filter that believes the cell
        # saturated would otherwise be deaf to a reading that is not.
        told = np.minimum((voltage - self._amplifier.reference_v) / (self._volts * gain), self._highest)
        there = self._law.force(told)
        apart = there - felt
        far = np.abs(apart) > 1e-3 * self._memory.saturation_force
        slope = np.where(far, (told - conductance) / np.where(far, apart, 1.0), self._law.slope(felt))
        gradient = np.zeros_like(x)
        by_felt = self._volts * gain * slope
        gradient[:, LOAD], gradient[:, LOAD_ERROR] = plays.elastic * by_felt, by_felt
        gradient[:, PLAYS] = plays.weight * by_felt[:, None]
        gradient[:, CREEP] = self._volts * conductance
        return Reading(self._amplifier.reference_v + self._volts * gain * conductance, gradient)

    def piezoelectric(self, x: Array, voltage: Array) -> Reading:
        """What the dynamic cell reads."""
        gradient = np.zeros_like(x)
        gradient[:, BIAS] = 1.0
        if self._by_charge:
            law = self._charge
            gradient[:, CHARGE] = law.gain * (1.0 + law.lag / law.leak)
            gradient[:, RATE] = -law.gain * law.lag
            return Reading(law.voltage(x[:, CHARGE], x[:, RATE]) + x[:, BIAS], gradient)
        gradient[:, RATE], gradient[:, ACCELERATION] = self._gains
        value = self._gains[0] * x[:, RATE] + self._gains[1] * x[:, ACCELERATION] + self._thesis_law.offset
        return Reading(value + x[:, BIAS], gradient)

    def saturation(self, voltage: Array, x: Array) -> tuple[Mask, Array]:
        """Which readings of the static cell are saturated, and the load that they prove."""
        # Beyond its bound the load is free, but the reading still tells the creep.
        proven = np.full(len(voltage), self._proven)
        return (voltage > self._saturated * (1.0 + x[:, CREEP])) & (x[:, LOAD] < proven), proven

    def observe_frequency(self, frequency: float) -> tuple[Reading, float] | None:
        self._gains = self._thesis_law.gains(frequency)
        return None

    def _for(self, period: float) -> _Prepared:
        """What depends on the period only; it seldom changes."""
        if self._prepared is None or self._prepared.period != period:
            self._prepared = self._prepare(period)
        return self._prepared

    def _prepare(self, period: float) -> _Prepared:
        m, n = self._memory, self._noise
        remain, share = self._charge.transition(period)
        creep_remain = math.exp(-period / m.creep_time)
        load_error_remain = np.exp(-period / np.asarray(n.load_error_time))
        bias_remain = np.exp(-period / np.asarray(n.bias_time))
        half = 0.5 * period * period
        constant = np.eye(len(self.states))
        constant[PLAYS, PLAYS] = 0.0
        constant[LOAD, RATE] = constant[RATE, ACCELERATION] = period
        constant[LOAD, ACCELERATION] = half
        constant[CREEP, CREEP] = creep_remain
        constant[CREEP, LOAD] = (1.0 - creep_remain) * m.creep_gain
        constant[CHARGE, [RATE, ACCELERATION, CHARGE]] = share * period, share * half, remain
        count = max(np.size(n.load_error_time), np.size(n.bias_time))
        jacobian = np.tile(constant, (count, 1, 1)) if count > 1 else constant[None]
        jacobian[:, LOAD_ERROR, LOAD_ERROR] = load_error_remain
        jacobian[:, BIAS, BIAS] = bias_remain
        variances = np.broadcast_arrays(
            0.0,
            n.rate * period,
            n.acceleration * period,
            n.creep * period,
            n.load_error * (1.0 - load_error_remain**2),
            n.bias * (1.0 - bias_remain**2),
            0.0,
            *(n.hysteresis * period * slack**2 for slack in self._plays.slacks),
        )
        noise = np.stack(variances, axis=-1).astype(np.float64)
        return _Prepared(period, jacobian, noise)
