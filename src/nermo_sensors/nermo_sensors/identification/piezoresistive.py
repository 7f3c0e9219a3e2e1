"""Finds the piezoresistive cell's curve, hysteresis and creep from a bench recording (C 4.3.2.2, figure 4.11)."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from nermo_sensors.bench.table import BenchRecording
from nermo_sensors.cells.piezoresistive import LinearConductance, Sigmoid, SigmoidPair, SoftConductance
from nermo_sensors.identification.fit import Fit, UnidentifiableError, Unknown, fit
from nermo_sensors.models.amplifier import NonInvertingAmplifier
from nermo_sensors.parameters import MemoryCalibration, PairCalibration, SigmoidParameters

Array = NDArray[np.float64]

_BOTH_WAYS = "a loading and an unloading ramp over the same forces"
_SATURATION = "forces beyond saturation, where the voltage stops rising"
_LIGHT = "forces well below saturation"
_LONG = "minutes under load, and some without"
_CORRELATION = 0.5
"""For so long residuals may hang together [s]."""
_SLOW = 0.4
"""A sample counts in full while its load would take longer than this through the whole range [s]. Whatever lags behind
the cell (a bench's low-pass filter, say) smears the corner of saturation by rate times lag, and the curve's rounding
and hysteresis would take that for their own."""


def fit_pair(recording: BenchRecording) -> tuple[PairCalibration, Fit]:
    """The pair of sigmoids (4.21). Raises UnidentifiableError."""
    force, voltage = recording.force, recording.piezoresistive
    rate = force_rate(recording)
    _refuse_one_way(force, rate)
    low, high = float(np.min(voltage)), float(np.max(voltage))
    span, middle = high - low, float(np.interp(0.5 * (low + high), np.sort(voltage), np.sort(force)))
    force_span = float(np.ptp(force))
    unknowns: dict[str, Unknown] = {}
    for branch, shift in (("rising", 1.0), ("falling", -1.0)):
        unknowns |= {
            f"{branch}.a": Unknown(1.1 * span, 0.2 * span, 5.0 * span, _SATURATION),
            f"{branch}.b": Unknown(-10.0 / force_span, -200.0 / force_span, -0.5 / force_span, _LIGHT),
            f"{branch}.c": Unknown(-middle - shift * 0.03 * force_span, -force_span, force_span, _BOTH_WAYS),
            f"{branch}.d": Unknown(low, low - 3.0 * span, low + 0.5 * span, _LIGHT),
        }
    typical = float(np.std(rate))
    unknowns["switch"] = Unknown(-3.0 / typical, -100.0 / typical, -0.03 / typical, _BOTH_WAYS, open_ended=True)

    def pair(values: dict[str, float]) -> SigmoidPair:
        rising, falling = (Sigmoid(*(values[f"{branch}.{x}"] for x in "abcd")) for branch in ("rising", "falling"))
        return SigmoidPair(rising, falling, values["switch"])

    result = fit(unknowns, lambda values: pair(values).voltage(force, rate), voltage, _lags(recording))
    v = result.values
    return PairCalibration(
        rising=SigmoidParameters(**{x: v[f"rising.{x}"] for x in "abcd"}),
        falling=SigmoidParameters(**{x: v[f"falling.{x}"] for x in "abcd"}),
        switch=v["switch"],
    ), result


def fit_memory(recording: BenchRecording, amplifier: NonInvertingAmplifier) -> tuple[MemoryCalibration, Fit]:
    """Curve, reversal hysteresis and creep in one, from the slow samples above all. Raises UnidentifiableError."""
    force, voltage = recording.force, recording.piezoresistive
    rate = force_rate(recording)
    _refuse_one_way(force, rate)
    _refuse_short(recording)
    conductance = amplifier.conductance(voltage)
    low, high = (float(np.percentile(conductance, q)) for q in (1, 99))
    force_span = float(np.ptp(force))
    knee = float(np.interp(0.9 * high + 0.1 * low, np.sort(conductance), np.sort(force)))
    slope = (high - low) / knee
    unknowns = {
        "sensitivity": Unknown(slope, 0.1 * slope, 10.0 * slope, _LIGHT),
        "base_conductance": Unknown(low, low - 2.0 * (high - low), high, _LIGHT),
        "saturation_force": Unknown(knee, 0.05 * force_span, 2.0 * force_span, _SATURATION),
        "rounding": Unknown(0.1 * knee, 0.005 * knee, 2.0 * knee, _SATURATION),
        "hysteresis_width": Unknown(0.03 * force_span, 0.0, 0.5 * force_span, _BOTH_WAYS),
        "reversal_force": Unknown(0.1 * force_span, 1e-3 * force_span, force_span, _BOTH_WAYS),
        "creep_gain": Unknown(0.03 / force_span, 0.0, 10.0 / force_span, _LONG),
        "creep_time": Unknown(0.5 * _duration(recording), 1.0, 20.0 * _duration(recording), _LONG),
    }

    def predict(values: dict[str, float]) -> Array:
        law = SoftConductance(*(values[n] for n in ("sensitivity", "base_conductance", "saturation_force", "rounding")))
        felt = force + values["hysteresis_width"] * reversal(force, values["reversal_force"])
        creep = values["creep_gain"] * _lagged(force, recording.period, values["creep_time"])
        return np.asarray(amplifier.voltage(law.conductance(felt) * (1.0 + creep)))

    weight = 1.0 / np.hypot(1.0, rate * _SLOW / force_span)
    result = fit(unknowns, predict, voltage, _lags(recording), weight)
    calibration = MemoryCalibration(
        **result.values, feedback_resistance=amplifier.feedback_ohm, reference_voltage=amplifier.reference_v
    )
    return calibration, result


def fit_static(force: Array, conductance: Array) -> tuple[LinearConductance, Fit]:
    """Linear with saturation (4.4), from a static characteristic as in C appendix B; forces in N, conductances in S.

    Raises UnidentifiableError.
    """
    span = float(np.ptp(conductance))
    if not span > 0.0:
        raise UnidentifiableError("sensitivity: the conductance never changes")
    start = _best_broken_line(force, conductance)
    slope, top = span / float(np.ptp(force)), float(np.max(conductance))
    unknowns = {
        "sensitivity": Unknown(start.sensitivity, 0.01 * slope, 100.0 * slope, _LIGHT),
        "base": Unknown(start.base, top - 10.0 * span, top, _LIGHT),
        "saturated": Unknown(start.saturated, top - span, top + span, _SATURATION),
    }
    result = fit(unknowns, lambda v: LinearConductance(**v).conductance(force), conductance, 0)
    law = LinearConductance(**result.values)
    if np.count_nonzero(force > law.saturation_force) < 2:
        raise UnidentifiableError(f"saturated: the conductance never stops rising; it needs {_SATURATION}")
    return law, result


def _best_broken_line(force: Array, conductance: Array) -> LinearConductance:
    """A start from which a local search finds the corner: the best of a line up to a force and a constant beyond."""
    best, least = LinearConductance(1.0, 0.0, 1.0), np.inf
    for corner in np.quantile(force, np.linspace(0.2, 1.0, 17)):
        below = force <= corner
        slope, base = np.polyfit(force[below], conductance[below], 1)
        top = conductance[~below].mean() if np.any(~below) else slope * corner + base
        law = LinearConductance(float(slope), float(base), float(top))
        error = float(np.sum((law.conductance(force) - conductance) ** 2))
        if slope > 0.0 and error < least:
            best, least = law, error
    return best


def force_rate(recording: BenchRecording) -> Array:
    """Rate of the force [N/s], by central differences: the force is low-passed, so nothing needs smoothing."""
    return np.gradient(recording.force, recording.time)


def reversal(force: Array, reversal_force: float) -> Array:
    """Dahl's hysteresis along a force (n,) [N], from -1 at rest: to -1 while it rises, to +1 while it falls.

    dz/dF = -(1 + z) / reversal_force rising, -(1 - z) / reversal_force falling. On full loops, which a bench makes, it
    is what `LoopPlays` is, and one number to carry along.
    """
    changes = np.diff(force, prepend=force[0])
    signs = np.where(changes < 0.0, -1.0, 1.0).tolist()
    remains = np.exp(-np.abs(changes) / reversal_force).tolist()
    z, result = -1.0, []
    for sign, remain in zip(signs, remains, strict=True):
        z = (z + sign) * remain - sign
        result.append(z)
    return np.array(result)


def _lagged(force: Array, period: float, time: float) -> Array:
    remain = np.exp(-period / time)
    return np.asarray(lfilter([1.0 - remain], [1.0, -remain], force))


def _refuse_one_way(force: Array, rate: Array) -> None:
    """No hysteresis without forces that both rise and fall over the same range."""
    moving = 0.02 * float(np.max(np.abs(rate), initial=0.0))
    edges = np.quantile(force, [0.2, 0.4, 0.6, 0.8])
    both = 0
    for low, high in pairwise(edges):
        rates = rate[(force >= low) & (force <= high)]
        both += bool(np.any(rates > moving) and np.any(rates < -moving))
    if both < 2:
        raise UnidentifiableError(f"hysteresis_width: the recording says nothing about it; it needs {_BOTH_WAYS}")


def _refuse_short(recording: BenchRecording) -> None:
    if _duration(recording) < 20.0:
        raise UnidentifiableError(
            f"creep_time: {_duration(recording):.1f} s are too short to see creep; it needs {_LONG}"
        )


def _duration(recording: BenchRecording) -> float:
    return float(recording.time[-1] - recording.time[0])


def _lags(recording: BenchRecording) -> int:
    return round(_CORRELATION / recording.period)
