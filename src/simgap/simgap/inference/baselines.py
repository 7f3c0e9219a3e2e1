"""The obvious alternatives, on the same windows: fit everything at once, and the best single effect in sample."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simgap.inference.fit import Fitter
from simgap.inference.hypothesis import Hypothesis
from simgap.inference.scores import Scored
from simgap.inference.select import Selector
from simgap.simulation.windows import light

Array = NDArray[np.float64]

_FREE = 5.0
"""Standard deviations within which everything may move when it is fitted without priors."""


_ROUNDS, _ROUNDS_HEAVY = 6, 3
"""Iterations of that fit; fewer where a round takes long."""


def fit_everything(fitter: Fitter, iterations: int | None = None, seed: int = 0) -> dict[str, object]:
    """Plain least squares (mujoco.minimize) of all nominal parameters, fitted outside of one fold and scored in it.

    No effects, no priors, white residuals: what a user gets who frees every number of the model.
    """
    iterations = iterations or (_ROUNDS if light(fitter.residuals.replayer.plant.model) else _ROUNDS_HEAVY)
    fold, recorded = fitter.windows.fold, fitter.recorded.any(axis=1)
    held = int(fold[recorded & (fold >= 0)].min())
    train, test = np.flatnonzero(recorded & (fold != held)), np.flatnonzero(recorded & (fold == held))
    step = max(len(train) // 40, 1)
    train = train[::step]
    none = np.zeros(0)

    def residual(x: Array) -> Array:
        points = np.atleast_2d(x.T) if x.ndim == 2 else x[None]
        values = [
            fitter.replay(Hypothesis(), [(none, p) for p in points[i : i + 16]], train)
            for i in range(0, len(points), 16)
        ]
        flat = np.concatenate(values).reshape(len(points), -1)
        result: Array = flat.T if x.ndim == 2 else flat[0]
        return result

    z = _optimize(len(fitter.nuisances), residual, iterations)
    square = fitter.mean_square(fitter.replay(Hypothesis(), [(none, z)], test)[0], test)
    before = fitter.mean_square(fitter.replay(Hypothesis(), [(none, np.zeros(len(fitter.nuisances)))], test)[0], test)
    blocks = [np.flatnonzero(fitter.windows.block[test] == b) for b in np.unique(fitter.windows.block[test])]
    rng = np.random.default_rng(seed)
    draws = [np.concatenate([blocks[b] for b in rng.integers(0, len(blocks), len(blocks))]) for _ in range(400)]
    gaps = np.sqrt([square[d].mean() for d in draws])
    shrinks = 1.0 - gaps / np.sqrt([before[d].mean() for d in draws])
    return {
        "gap": float(np.sqrt(square.mean())),
        "ci90": np.percentile(gaps, [5, 95]).tolist(),
        "shrink": float(1.0 - np.sqrt(square.mean() / before.mean())),
        "shrink_ci90": np.percentile(shrinks, [5, 95]).tolist(),
        "parameters": {n.name: float(v) for n, v in zip(fitter.nuisances, z, strict=True)},
        "parameter_unit": "standard deviations of the prior",
        "held_out": f"fold {held}",
        "method": "mujoco.minimize: least squares of all nominal parameters, no priors, no effects",
    }


def _optimize(count: int, residual: Callable[[Array], Array], iterations: int) -> Array:
    """Least squares of so many numbers by MuJoCo's own optimizer."""
    # Its typed half would hide the rest of mujoco, which is untyped, from the type checker.
    minimize: Any = importlib.import_module("mujoco.minimize")
    bounds = [np.full(count, -_FREE), np.full(count, _FREE)]
    found, _ = minimize.least_squares(np.zeros(count), residual, bounds, eps=1e-2, max_iter=iterations, verbose=0)
    return np.asarray(found, float)


def best_in_sample(selector: Selector, singles: list[Scored], reference: Scored) -> dict[str, object]:
    """The single effect with the smallest in-sample error; always names one, however little it explains."""
    fitter = selector.fitter
    scored = singles or [reference]
    errors = [float((s.fit.residual**2).mean()) for s in scored]
    best = scored[int(np.argmin(errors))]
    return {
        "effect": best.fit.hypothesis.effects[0].key if best.fit.hypothesis.effects else None,
        "gap": best.gap,
        "in_sample_gap": float(np.sqrt(fitter.mean_square(best.fit.residual).mean())),
    }
