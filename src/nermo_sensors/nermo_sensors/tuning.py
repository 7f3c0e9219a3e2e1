"""Covariances by particle swarm (C 4.3.1.3), the whole swarm filtering at once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from nermo_sensors.bench.table import BenchRecording
from nermo_sensors.estimation.load_filter import make_model
from nermo_sensors.estimation.offline import Estimates, estimate
from nermo_sensors.parameters import Calibration, Noises

Array = NDArray[np.float64]
Objective = Literal["thesis", "likelihood"]

ALPHA, BETA, GAMMA = 5.0, 1e-2, 1e-5
"""Weights of the load, of its rate and of the bias in (4.19), as C chose them."""

REACH = 2.0
"""Decades to either side of the present value in which a covariance is searched."""

WAKE_UP = 1.0
"""Time from the start of a recording that is not judged [s]."""

_WORST = 1e12
_SCALE_STEPS = 8


@dataclass(frozen=True, slots=True)
class Tuning:
    """What the swarm found."""

    noises: Noises
    cost: float
    """Of the best particle; lower is better."""
    cost_before: float
    """Of the covariances that it started from."""
    history: list[float]
    """Best cost after each generation."""


def thesis_cost(states: Estimates, bias: int, recording: BenchRecording) -> Array:
    """-log O of (4.19) for each of B filters; the logarithm, because O itself underflows."""
    rows = _judged(recording)
    force, rate = recording.force[rows, None], np.gradient(recording.force, recording.time)[rows, None]
    D = states.states[rows, :, bias]
    return (
        ALPHA * np.mean((states.states[rows, :, 0] - force) ** 2, axis=0)
        + BETA * np.mean((states.states[rows, :, 1] - rate) ** 2, axis=0)
        + GAMMA * np.std(D, axis=0)
    )


def likelihood_cost(states: Estimates, bias: int, recording: BenchRecording) -> Array:
    """Minus the mean log-density that each filter gave to the true load: rewards small errors and honest variances."""
    del bias
    rows = _judged(recording)
    error = states.load[rows] - recording.force[rows, None]
    variance = np.maximum(states.variance[rows], 1e-12)
    return np.asarray(0.5 * np.mean(np.log(2.0 * np.pi * variance) + error**2 / variance, axis=0))


_COSTS: dict[str, Callable[[Estimates, int, BenchRecording], Array]] = {
    "thesis": thesis_cost,
    "likelihood": likelihood_cost,
}


@dataclass(frozen=True, slots=True)
class Swarm:
    """How the covariances are searched, and for what."""

    objective: Objective = "thesis"
    particles: int = 24
    generations: int = 25
    seed: int = 0


class _Covariances:
    """The covariances of one estimator that are searched, as decades [1], shape (B, n), and what they make of a run."""

    def __init__(self, estimator: str, calibration: Calibration, noises: Noises, recording: BenchRecording) -> None:
        self._estimator, self._calibration, self._noises, self.recording = estimator, calibration, noises, recording
        present: BaseModel = getattr(noises, estimator)
        self._kind = type(present)
        # How long an error lasts stays as it is, and so does the size of a bias that lasts for a run: a run shows one
        # draw of it, and a swarm free to call it small or short-lived finds a filter that follows no other run.
        fields = self._kind.model_fields
        kept = {"bias"} if "bias_time" in fields else set()
        self.names = [name for name in fields if not name.endswith("_time") and name not in kept]
        self._fixed = {name: getattr(present, name) for name in fields if name not in self.names}
        self.start = np.log10([getattr(present, name) for name in self.names])
        self._bias = make_model(estimator, calibration, noises).states.index("bias")

    def filtered(self, points: Array) -> Estimates:
        """The run through one filter a point."""
        values = dict(zip(self.names, 10.0**points.T, strict=True))
        trial = self._kind.model_construct(**self._fixed, **values)
        model = make_model(self._estimator, self._calibration, self._with(trial))
        with np.errstate(all="ignore"):
            return estimate(model, self.recording, len(points))

    def cost(self, points: Array, objective: Objective) -> Array:
        """(B,), lower is better."""
        with np.errstate(all="ignore"):
            costs = _COSTS[objective](self.filtered(points), self._bias, self.recording)
        return np.where(np.isfinite(costs), np.minimum(costs, _WORST), _WORST)

    def scaled(self, point: Array) -> Noises:
        """The noises of a point (n,), their common scale set towards a mean normalised squared error of 1."""
        found = dict(zip(self.names, (10.0**point).tolist(), strict=True))
        # Start and bounds do not scale along, so one step does not always do.
        for _ in range(_SCALE_STEPS):
            scale = _normalised_error(self.filtered(np.log10([list(found.values())])), self.recording)
            found = {name: value * scale for name, value in found.items()}
            if abs(scale - 1.0) < 0.05:
                break
        return self._with(self._kind.model_validate({**self._fixed, **found}))

    def _with(self, tuned: BaseModel) -> Noises:
        return self._noises.model_copy(update={self._estimator: tuned})


def tune(
    estimator: str,
    calibration: Calibration,
    noises: Noises,
    recording: BenchRecording,
    swarm: Swarm,
    progress: Callable[[int, int], None],
) -> Tuning:
    """Searches the covariances of one estimator, starting from `noises`.

    Mostly the ratios of covariances move the estimate, and the thesis's objective does not look at the variance at all:
    their common scale is set last, on this recording. For the likelihood, too, that is the best common scale.
    """
    # pymoo takes a second to import, and only tuning needs it.
    from pymoo.algorithms.soo.nonconvex.pso import PSO
    from pymoo.core.problem import Problem
    from pymoo.optimize import minimize

    covariances = _Covariances(estimator, calibration, noises, recording)
    start, count = covariances.start, len(covariances.names)
    history: list[float] = []

    class Search(Problem):
        def _evaluate(self, x: Array, out: dict[str, Any], *_: Any, **__: Any) -> None:
            out["F"] = costs = covariances.cost(x, swarm.objective)
            history.append(min([float(costs.min()), *history[-1:]]))
            progress(len(history), swarm.generations)

    random = np.random.default_rng(swarm.seed)
    particles = start + REACH * (2.0 * random.random((swarm.particles, count)) - 1.0)
    particles[0] = start
    before = float(covariances.cost(start[None], swarm.objective)[0])
    result = minimize(
        Search(n_var=count, xl=start - REACH, xu=start + REACH),
        PSO(pop_size=swarm.particles, sampling=particles),
        ("n_gen", swarm.generations),
        seed=swarm.seed,
    )
    found = covariances.scaled(np.asarray(result.X, dtype=np.float64))
    return Tuning(found, float(result.F[0]), before, history)


def _normalised_error(states: Estimates, recording: BenchRecording) -> float:
    rows = _judged(recording)
    error = states.load[rows, 0] - recording.force[rows]
    return float(np.mean(error**2 / states.variance[rows, 0]))


def _judged(recording: BenchRecording) -> NDArray[np.bool_]:
    return np.asarray(recording.time >= recording.time[0] + WAKE_UP)
