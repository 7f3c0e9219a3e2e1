"""What can be wrong with sensors and the link."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from simgap.blind.faults.base import Scale, Values
from simgap.blind.truth import PERIOD, Truth

Array = NDArray[np.float64]


def bias(truth: Truth, scale: Scale, column: str, size: float) -> Values:
    """A sensor whose zero is off, in deviations of what it shows."""
    bias = size * scale.column[column][0]
    truth.sensors[column] = lambda t, y: y + bias
    return {"bias": bias}


def scaled(truth: Truth, scale: Scale, column: str, size: float) -> Values:
    """A sensor that shows so many times what there is."""
    truth.sensors[column] = lambda t, y: size * y
    return {"factor": size}


def late(truth: Truth, scale: Scale, column: str, size: float) -> Values:
    """A sensor that shows what was some seconds ago."""
    truth.sensors[column] = lambda t, y: np.interp(t - size, t, y)
    return {"delay": size}


def smoothed(truth: Truth, scale: Scale, column: str, size: float) -> Values:
    """Two equal filters one after the other, with the lag of one."""

    def smooth(t: Array, y: Array) -> Array:
        steps = 0.5 * size / float(t[1] - t[0])
        keep = steps / (1.0 + steps)
        for _ in range(2):
            y = lfilter([1.0 - keep], [1.0, -keep], y, zi=[keep * y[0]])[0]
        return y

    truth.sensors[column] = smooth
    return {"delay": size}


def saturated(truth: Truth, scale: Scale, column: str, size: float) -> Values:
    """A sensor that ends at a share of what it would show."""
    truth.sensors[column] = lambda t, y: np.clip(y, *_ends(y, size))
    return {}


def _ends(y: Array, size: float) -> tuple[float, float]:
    top = size * float(np.abs(y).max())
    return -top, top


def askew(truth: Truth, scale: Scale, column: str, size: float) -> Values:
    """``column`` is the first of three; the mounting is turned about the axis (1, 1, 1)."""
    row = next(r for r in truth.mapping["outputs"] if r["column"] == column)
    names = tuple(r["column"] for r in truth.mapping["outputs"] if r.get("sensor") == row["sensor"])
    if any(n == names for n, _ in truth.axes):
        return {}
    vector = np.full(3, size / np.sqrt(3.0))
    quaternion, matrix = np.zeros(4), np.zeros(9)
    mujoco.mju_axisAngle2Quat(quaternion, vector / np.linalg.norm(vector), float(np.linalg.norm(vector)))
    mujoco.mju_quat2Mat(matrix, quaternion)
    turn = matrix.reshape(3, 3).T
    truth.axes.append((names, lambda y: y @ turn.T))
    return {}


def latency(truth: Truth, scale: Scale, _: str, size: float) -> Values:
    """A link that takes so many seconds."""
    truth.link.latency = size
    # A robot takes up what has arrived at its next tick.
    return {"delay": float(np.ceil(size / PERIOD - 1e-9)) * PERIOD}


def jitter(truth: Truth, scale: Scale, _: str, size: float) -> Values:
    """A link whose time of travel is a matter of chance."""
    truth.link.jitter = size
    return {}


def loss(truth: Truth, scale: Scale, _: str, size: float) -> Values:
    """A link that drops a share of the commands."""
    truth.link.loss = size
    return {}
