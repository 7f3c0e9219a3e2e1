"""C figure 4.8 again: F1 with both cells and with each alone, on a 2 Hz bump with hysteresis, saturation and bias."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nermo_sensors.bench.rig import smooth_bump
from nermo_sensors.cells.piezoresistive import Sigmoid, SigmoidPair
from nermo_sensors.estimation.load_filter import LoadFilter
from nermo_sensors.estimation.thesis import RateModel
from nermo_sensors.parameters import PairCalibration, RateCalibration, RateNoise, SigmoidParameters

Array = NDArray[np.float64]

PAIR = PairCalibration(
    rising=SigmoidParameters(a=4.0, b=-0.6, c=-6.0, d=0.9),
    falling=SigmoidParameters(a=4.0, b=-0.6, c=-4.0, d=0.9),
    switch=-0.1,
)
"""As figure 4.7a: about 1 V to 4.9 V, saturated from about 10 N on, 2 N of hysteresis."""

PEAK, FREQUENCY, BIAS_SHARE = 15.0, 2.0, 0.005
"""Of the bump [N] (1.4 body weights, C 4.2.3), its frequency [Hz], and the rate's bias over its largest value."""
STATIC_NOISE, DYNAMIC_NOISE = 0.05, 2.0
"""Standard deviations [V] and [N/s]; C gives none. The second is 1 % of the largest rate."""
SAMPLING = 1000.0
"""[Hz]"""
DRIFT = 0.5
"""An offset that grows by more between the second second and the last is a drift [N]; the bump has 15 N."""


@dataclass(frozen=True, slots=True)
class FigureRow:
    """One variant over all seeds."""

    cells: str
    rmse_n: float
    """Mean over the seeds."""
    rmse_sd_n: float
    """From seed to seed."""
    offset_start_n: float
    """Absolute error of the mean load over the second second, mean over the seeds."""
    offset_end_n: float
    """The same of the last second."""
    drifts: bool
    """Whether that grew by more than `DRIFT`."""


def figure_rows(seeds: int = 20, seconds: float = 60.0, seed: int = 0) -> list[FigureRow]:
    """Fused, piezoresistive only and piezoelectric only; every seed is one filter of a bank."""
    samples = round(seconds * SAMPLING)
    turn = (np.arange(samples) / SAMPLING * FREQUENCY) % 1.0
    force = PEAK * smooth_bump(2.0 * turn - 1.0)
    rate = np.gradient(force, 1.0 / SAMPLING)
    pair = SigmoidPair(
        Sigmoid(PAIR.rising.a, PAIR.rising.b, PAIR.rising.c, PAIR.rising.d),
        Sigmoid(PAIR.falling.a, PAIR.falling.b, PAIR.falling.c, PAIR.falling.d),
        PAIR.switch,
    )
    random = np.random.default_rng(seed)
    static = np.asarray(pair.voltage(force, rate))
    dynamic = rate + BIAS_SHARE * float(np.max(np.abs(rate)))
    # (4.18) is per step, (0.0001, 0.1, 0.0001); the measurement covariance is twice the engineered noise (C 4.3.1.2).
    noise = RateNoise(
        force=1e-4 * SAMPLING,
        rate=1e-1 * SAMPLING,
        bias=1e-4 * SAMPLING,
        piezoresistive=2.0 * STATIC_NOISE**2,
        piezoelectric=2.0 * DYNAMIC_NOISE**2,
    )
    model = RateModel(PAIR, RateCalibration(gain=1.0), noise)
    banks = {name: LoadFilter(model, seeds) for name in ("fused", "piezoresistive", "piezoelectric")}
    errors = {name: np.empty((samples, seeds)) for name in banks}
    for row in range(samples):
        both = np.array(
            [
                static[row] + STATIC_NOISE * random.standard_normal(seeds),
                dynamic[row] + DYNAMIC_NOISE * random.standard_normal(seeds),
            ]
        )
        for name, filters in banks.items():
            read = np.array([[name != "piezoelectric"], [name != "piezoresistive"]])
            filters.step(1.0 / SAMPLING, np.where(read, both, np.nan))
            errors[name][row] = filters.load - force[row]
    return [_row(name, error) for name, error in errors.items()]


def figure_facts(seeds: int = 20, seconds: float = 60.0, seed: int = 0) -> list[dict[str, Any]]:
    """The rows as plain data."""
    return [asdict(row) for row in figure_rows(seeds, seconds, seed)]


def _row(name: str, error: Array) -> FigureRow:
    rmse = np.sqrt(np.mean(error**2, axis=0))
    second = round(SAMPLING)
    begin, end = (float(np.abs(part.mean(axis=0)).mean()) for part in (error[second : 2 * second], error[-second:]))
    return FigureRow(name, float(rmse.mean()), float(rmse.std()), begin, end, end - begin > DRIFT)
