"""Is there structure in what a model leaves? A flexible regression that has not seen a block tries to predict it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from simgap.inference.residual import Residuals

Array = NDArray[np.float64]

_FEATURES = 24
_RIDGE = (0.1, 1.0, 10.0, 100.0)
REPEATS = 0.2
"""Share of the residual's power at one frequency from which on it repeats. What true links left had up to 0.12 of it,
what two links fitted to a push left 0.10 to 0.37."""
_SLOWEST, _FASTEST = 0.3, 12.0
"""[Hz] of what may repeat."""


def predictable_share(residuals: Residuals, residual: Array, seed: int = 0) -> float:
    """Share (0 to 1) of the residual's power that inputs and state predict in blocks that were not fitted.

    A force that the model lacks shows in a window as its double integral. So the features are functions of inputs,
    coordinates and rates (themselves, their signs, and random waves), their running sums and the sums of these.
    """
    replayer = residuals.replayer
    windows, state, aligned = replayer.windows, replayer.state, replayer.aligned
    rows = windows.start[:, None] + np.arange(windows.length)
    signals = [aligned.inputs[rows], state.position[rows], state.velocity[rows]]
    base = np.concatenate(signals, axis=-1)
    spread = base.std(axis=(0, 1))
    base = (base - base.mean(axis=(0, 1)))[..., spread > 1e-12] / spread[spread > 1e-12]
    rng = np.random.default_rng(seed)
    waves = np.sin(base @ rng.normal(0, 1.0, (base.shape[-1], _FEATURES)) + rng.uniform(0, 2 * np.pi, _FEATURES))
    rates = state.velocity[rows] / np.maximum(state.velocity[rows].std(axis=(0, 1)), 1e-12)
    force = np.concatenate([base, np.tanh(10 * rates), rates * np.abs(rates), waves, np.ones((*rows.shape, 1))], -1)
    once = np.cumsum(force, axis=1) / windows.length
    twice = np.cumsum(once, axis=1) / windows.length
    features = np.concatenate([force, once, twice], axis=-1)[:, windows.sample]
    features = features / np.maximum(features.std(axis=(0, 1)), 1e-9)
    groups = windows.block % 4
    target = residual / np.sqrt(1.0 + (residual**2).mean(axis=1, keepdims=True))
    best = _held_out(features, target, groups, _RIDGE).max(axis=0)
    power = (target**2).sum(axis=(0, 1))
    return float(np.maximum(best, 0.0) @ power / max(float(power.sum()), 1e-12))


def _held_out(features: Array, targets: Array, groups: NDArray[np.int64], strengths: Sequence[float]) -> Array:
    """Share of each target's power that ridge regression explains in groups of blocks that were left out.

    Args:
        features: (nw, ns, nf).
        targets: (nw, ns, nt).
        groups: (nw,) of each window.
        strengths: of the ridge.

    Returns:
        (strengths, nt)
    """
    missed = np.zeros((len(strengths), targets.shape[-1]))
    for g in np.unique(groups):
        train, test = groups != g, groups == g
        if not train.any():
            return np.zeros_like(missed)
        a = features[train].reshape(-1, features.shape[-1])
        normal, moment = a.T @ a, a.T @ targets[train].reshape(-1, targets.shape[-1])
        for i, strength in enumerate(strengths):
            weights = np.linalg.solve(normal + strength * len(a) * 1e-2 * np.eye(len(normal)), moment)
            missed[i] += ((targets[test] - features[test] @ weights) ** 2).sum(axis=(0, 1))
    return 1.0 - missed / np.maximum((targets**2).sum(axis=(0, 1)), 1e-12)


def repeating_share(residuals: Residuals, residual: Array) -> tuple[float, float]:
    """Largest share (0 to 1) of the residual's power that one frequency predicts in blocks not fitted; and it [Hz].

    Something that comes at regular times, whatever the robot does, keeps its phase from window to window. A force of
    this kind shows in a window as its double integral.
    """
    windows, aligned = residuals.replayer.windows, residuals.replayer.aligned
    rows = windows.start[:, None] + np.arange(windows.length)
    time = rows * aligned.period
    groups = windows.block % 4
    target = residual / np.sqrt(1.0 + (residual**2).mean(axis=1, keepdims=True))
    power, best = (target**2).sum(axis=(0, 1)), (0.0, 0.0)
    flat = np.ones(rows.shape)
    for frequency in np.arange(_SLOWEST, min(_FASTEST, 0.25 / aligned.period), 0.5 / max(aligned.duration, 1.0)):
        phase = 2.0 * np.pi * frequency * time
        force = np.stack([np.cos(phase), np.sin(phase), flat], axis=-1)
        once = np.cumsum(force, axis=1) / windows.length
        features = np.concatenate([force, once, np.cumsum(once, axis=1) / windows.length], axis=-1)[:, windows.sample]
        features = features / np.maximum(features.std(axis=(0, 1)), 1e-9)
        explained = np.maximum(_held_out(features, target, groups, _RIDGE[:1])[0], 0.0) @ power
        best = max(best, (float(explained / max(power.sum(), 1e-12)), float(frequency)))
    return best
