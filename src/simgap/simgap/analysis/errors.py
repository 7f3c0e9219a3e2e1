"""Measured minus simulated, in each channel's own unit: what the waterfall and the free runs are told in."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from simgap.data.plant import Plant
from simgap.simulation.replay import Replayer

Array = NDArray[np.float64]


def measured_of(replayer: Replayer) -> Array:
    """What was measured in the replayer's windows, (nw, ns, no); NaN where it was not."""
    rows, aligned = replayer.windows.rows(), replayer.aligned
    found: Array = np.where(aligned.valid[rows] & aligned.live, aligned.outputs[rows], np.nan)
    return found


def difference(plant: Plant, measured: Array, simulated: Array) -> Array:
    """Measured minus simulated (..., no): angles on the shorter way round, quaternions with the sign that is nearer."""
    error: Array = measured - simulated
    for i, channel in enumerate(plant.outputs):
        if channel.wrapped:
            error[..., i] = (error[..., i] + np.pi) % (2 * np.pi) - np.pi
    quaternions: dict[str, list[int]] = {}
    for i, channel in enumerate(plant.outputs):
        if channel.sensor_type == mujoco.mjtSensor.mjSENS_FRAMEQUAT and channel.euler < 0:
            quaternions.setdefault(channel.sensor, []).append(i)
    for group in quaternions.values():
        away = np.nansum(measured[..., group] * simulated[..., group], axis=-1) < 0
        other = measured[..., group] + simulated[..., group]
        error[..., group] = np.where(away[..., None], other, error[..., group])
    return error


def by_channel(plant: Plant, measured: Array, simulated: Array) -> dict[str, float]:
    """Root mean square error {channel: value in its unit} over (..., no); without channels that were not measured.

    NaN (null in a file) where all of a channel's samples are lost, as those of a simulation that broke down are.
    """
    count = len(plant.outputs)
    told: NDArray[np.bool_] = np.asarray(np.isfinite(measured).reshape(-1, count).any(axis=0))
    error = difference(plant, measured, simulated).reshape(-1, count)
    ok: NDArray[np.bool_] = np.isfinite(error)
    square = np.where(ok, error, 0.0) ** 2
    root = np.sqrt(np.where(ok.any(axis=0), square.sum(axis=0) / np.maximum(ok.sum(axis=0), 1), np.nan))
    return {channel.name: float(root[i]) for i, channel in enumerate(plant.outputs) if told[i]}
