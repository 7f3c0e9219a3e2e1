"""Finds how the piezoelectric cell answers to rate and acceleration, by three laws (C 4.3.2.2, figure 4.13)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from nermo_sensors.bench.table import BenchRecording
from nermo_sensors.cells.piezoelectric import ChargeResponse, RateAccelerationResponse, RateResponse
from nermo_sensors.identification.fit import Fit, UnidentifiableError, Unknown, fit
from nermo_sensors.identification.piezoresistive import force_rate
from nermo_sensors.parameters import ChargeCalibration, RateAccelerationCalibration, RateCalibration

Array = NDArray[np.float64]

_MOVING = "a force that changes"
_SPREAD = "loads at several frequencies"
_CORRELATION = 0.5
"""For so long residuals may hang together [s]."""


def fit_rate(recording: BenchRecording) -> tuple[RateCalibration, Fit]:
    """V = gain F' + offset, for F1. Raises UnidentifiableError."""
    rate, voltage = force_rate(recording), recording.piezoelectric
    gain, offset = _guess(rate, voltage)
    unknowns = {"gain": _around(gain, _MOVING), "offset": _offset(offset, voltage)}
    result = fit(unknowns, lambda v: RateResponse(**v).voltage(rate), voltage, _lags(recording))
    return RateCalibration(**result.values), result


def fit_rate_acceleration(recording: BenchRecording) -> tuple[RateAccelerationCalibration, Fit]:
    """Rate and acceleration with gains that fall with the frequency, for F2. Raises UnidentifiableError."""
    frequency = recording.frequency
    if not np.all(np.isfinite(frequency)):
        raise UnidentifiableError("rate_decay: the recording has no frequency; it needs the column frequency_hz")
    if np.ptp(frequency) < 0.2 * np.mean(frequency):
        raise UnidentifiableError(f"rate_decay: the frequency hardly changes; it needs {_SPREAD}")
    rate, voltage = force_rate(recording), recording.piezoelectric
    acceleration = np.gradient(rate, recording.time)
    columns = np.column_stack([rate, acceleration, np.ones_like(rate)])
    (by_rate, by_acceleration, offset), *_ = np.linalg.lstsq(columns, voltage, rcond=None)
    middle = float(np.mean(frequency))
    unknowns = {
        "rate_gain": _around(2.0 * float(by_rate), _MOVING),
        "rate_decay": Unknown(2.0 * middle, 0.05 * middle, 100.0 * middle, _SPREAD),
        "acceleration_gain": _around(2.0 * float(by_acceleration), _SPREAD),
        "acceleration_decay": Unknown(2.0 * middle, 0.05 * middle, 100.0 * middle, _SPREAD),
        "offset": _offset(float(offset), voltage),
    }
    result = fit(
        unknowns,
        lambda v: RateAccelerationResponse(**v).voltage(rate, acceleration, frequency),
        voltage,
        _lags(recording),
    )
    return RateAccelerationCalibration(**result.values), result


def fit_charge(recording: BenchRecording) -> tuple[ChargeCalibration, Fit]:
    """Charge amplifier with leak and lag, for the memory filter. Raises UnidentifiableError."""
    rate, voltage = force_rate(recording), recording.piezoelectric
    changes, period = np.diff(recording.force, prepend=recording.force[0]), recording.period
    gain, offset = _guess(rate, voltage)
    leak = 0.1
    unknowns = {
        "gain": _around(gain / leak, _MOVING),
        "leak": Unknown(leak, 2.0 * period, 20.0, _SPREAD),
        "lag": Unknown(0.0, -0.05, 0.05, _SPREAD),
        "offset": _offset(offset, voltage),
    }

    def predict(values: dict[str, float]) -> Array:
        law = ChargeResponse(**values)
        remain, share = law.transition(period)
        charge = np.asarray(lfilter([share], [1.0, -remain], changes))
        return np.asarray(law.voltage(charge, rate))

    result = fit(unknowns, predict, voltage, _lags(recording))
    return ChargeCalibration(**result.values), result


def _guess(rate: Array, voltage: Array) -> tuple[float, float]:
    if not np.std(rate) > 1e-6:  # N/s; less is rounding
        raise UnidentifiableError(f"gain: the force never changes; it needs {_MOVING}")
    gain, offset = np.polyfit(rate, voltage, 1)
    if gain == 0.0:
        raise UnidentifiableError(f"gain: the voltage never changes; it needs {_MOVING}")
    return float(gain), float(offset)


def _around(guess: float, needs: str) -> Unknown:
    return Unknown(guess, -50.0 * abs(guess), 50.0 * abs(guess), needs)


def _offset(guess: float, voltage: Array) -> Unknown:
    reach = float(np.ptp(voltage))
    return Unknown(guess, guess - reach, guess + reach, _MOVING)


def _lags(recording: BenchRecording) -> int:
    return round(_CORRELATION / recording.period)
