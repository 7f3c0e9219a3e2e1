"""Filters run over a recording: estimates for every sample, and a smoother that also knows the future."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nermo_sensors.bench.table import BenchRecording
from nermo_sensors.estimation.load_filter import LoadFilter
from nermo_sensors.estimation.model import LoadModel

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Estimates:
    """Of B filters over n samples."""

    states: Array
    """(n, B, states)"""
    variance: Array
    """(n, B), of the load [N^2]."""

    @property
    def load(self) -> Array:
        """(n, B) [N]"""
        return self.states[:, :, 0]


def estimate(
    model: LoadModel,
    recording: BenchRecording,
    count: int = 1,
    piezoresistive: bool = True,
    piezoelectric: bool = True,
) -> Estimates:
    """Runs `count` filters over one recording; without a cell, as if its readings were missing."""
    filters = LoadFilter(model, count)
    rows = len(recording.time)
    states, variance = np.empty((rows, count, len(model.states))), np.empty((rows, count))
    readings = np.repeat(recording.readings[:, :, None], count, axis=2)
    readings[:, [not piezoresistive, not piezoelectric]] = np.nan
    period = recording.period
    for row, frequency in enumerate(recording.frequency.tolist()):
        filters.step(period, readings[row], frequency)
        states[row], variance[row] = filters.bank.x, filters.variance
    return Estimates(states, variance)


def smooth(model: LoadModel, recording: BenchRecording) -> Estimates:
    """Rauch, Tung and Striebel's smoother over one recording: every estimate knows all readings, before and after."""
    filters, period = LoadFilter(model, 1), recording.period
    rows, size, readings = len(recording.time), len(model.states), recording.readings
    x, P = np.empty((rows, size)), np.empty((rows, size, size))
    ahead_x, ahead_P, transitions = np.empty_like(x), np.empty_like(P), np.empty_like(P)
    for row in range(rows):
        before = filters.bank.P[0]
        filters.step(period, readings[row, :, None], float(recording.frequency[row]))
        assert filters.prediction is not None, "it has made a step"
        after, transition = filters.prediction
        F = np.broadcast_to(transition, (1, size, size))[0]
        transitions[row], ahead_x[row] = F, after[0]
        ahead_P[row] = F @ before @ F.T + np.diag(np.reshape(model.process(period), size))
        x[row], P[row] = filters.bank.x[0], filters.bank.P[0]
    for row in range(rows - 2, -1, -1):
        G = np.linalg.lstsq(ahead_P[row + 1], transitions[row + 1] @ P[row], rcond=None)[0].T
        x[row] += G @ (x[row + 1] - ahead_x[row + 1])
        P[row] += G @ (P[row + 1] - ahead_P[row + 1]) @ G.T
        P[row] = 0.5 * (P[row] + P[row].T)
    return Estimates(x[:, None, :], P[:, None, 0, 0])
