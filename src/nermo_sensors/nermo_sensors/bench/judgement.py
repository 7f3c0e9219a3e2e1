"""Estimators side by side on one bench run that none of them has seen."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nermo_sensors.bench.table import BENCH_CELLS, BenchRecording
from nermo_sensors.estimation.bank import FilterpyBank, KalmanBank
from nermo_sensors.estimation.consistency import Quality, find_bumps, judge
from nermo_sensors.estimation.load_filter import ESTIMATORS, LoadFilter, make_model
from nermo_sensors.estimation.offline import estimate, smooth
from nermo_sensors.parameters import TactileParameters

Array = NDArray[np.float64]

SETTLED = 1.0
"""Time from the start of a run that is not judged [s]."""


def judge_run(
    parameters: TactileParameters,
    recording: BenchRecording,
    estimators: tuple[str, ...] = (*ESTIMATORS, *BENCH_CELLS, "smoother"),
    progress: Callable[[int, int], None] | None = None,
) -> tuple[list[dict[str, Any]], dict[str, tuple[Array, Array]]]:
    """Rows by frequency and over all of them (frequency None), and load and variance (n,) of each estimator.

    `piezoresistive` and `piezoelectric` are the memory filter with one cell only, `smoother` is it with hindsight.
    """
    rows: list[dict[str, Any]] = []
    traces: dict[str, tuple[Array, Array]] = {}
    for number, name in enumerate(estimators):
        load, variance = _trace(name, parameters, recording)
        traces[name] = load, variance
        rows += _rows(name, recording, load, variance)
        if progress is not None:
            progress(number + 1, len(estimators))
    rows += best_single(rows)
    return rows, traces


def best_single(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Rows `best_single`: at each frequency the cell that does better alone, named under `cell`."""
    alone = [row for row in rows if row["estimator"] in BENCH_CELLS]
    frequencies = dict.fromkeys(row["frequency_hz"] for row in alone)
    best = [
        min((row for row in alone if row["frequency_hz"] == frequency), key=lambda row: float(row["rmse_n"]))
        for frequency in frequencies
    ]
    return [{**row, "estimator": "best_single", "cell": row["estimator"]} for row in best]


def update_times(parameters: TactileParameters, feet: int = 4, samples: int = 2000) -> dict[str, float]:
    """Time of one update of all feet [us]: the memory filter in NumPy, and the same model on filterpy. Medians."""
    random = np.random.default_rng(0)
    model = make_model("memory", parameters.calibration, parameters.noises)
    period = 1.0 / parameters.sampling_frequency
    result = {}
    for name, bank in (("update_us", KalmanBank), ("filterpy_update_us", FilterpyBank)):
        filters = LoadFilter(model, feet, bank)
        static = 1.2 + 0.01 * random.standard_normal((samples, feet))
        dynamic = 0.01 * random.standard_normal((samples, feet))
        readings = np.stack([static, dynamic], axis=1)
        times = np.empty(samples)
        for row in range(samples):
            begin = time.perf_counter_ns()
            filters.step(period, readings[row], 6.0)
            times[row] = time.perf_counter_ns() - begin
        result[name] = float(np.median(times)) * 1e-3
    return result


def _trace(name: str, parameters: TactileParameters, recording: BenchRecording) -> tuple[Array, Array]:
    model = make_model(name if name in ESTIMATORS else "memory", parameters.calibration, parameters.noises)
    if name == "smoother":
        smoothed = smooth(model, recording)
        return smoothed.load[:, 0], smoothed.variance[:, 0]
    with np.errstate(all="ignore"):
        found = estimate(
            model,
            recording,
            piezoresistive=name != "piezoelectric",
            piezoelectric=name != "piezoresistive",
        )
    return found.load[:, 0], found.variance[:, 0]


def _rows(name: str, recording: BenchRecording, load: Array, variance: Array) -> list[dict[str, Any]]:
    settled = recording.time >= recording.time[0] + SETTLED
    rows = []
    for frequency in (*np.unique(recording.frequency[settled]), None):
        part = settled if frequency is None else settled & (recording.frequency == frequency)
        force = recording.force[part]
        quality = judge(force, load[part], variance[part], find_bumps(force))
        rows.append(_row(name, None if frequency is None else round(float(frequency) / (2.0 * np.pi), 3), quality))
    return rows


def _row(name: str, frequency: float | None, quality: Quality) -> dict[str, Any]:
    return {
        "frequency_hz": frequency,
        "estimator": name,
        "rmse_n": quality.rmse,
        "peak_error_n": quality.peak_error,
        "within_3_sigma": quality.within_3_sigma,
        "nees": quality.nees,
    }
