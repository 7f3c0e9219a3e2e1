"""What a fault is, and the scale of a healthy robot that its size is relative to."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simgap.blind.truth import Run, Truth

Array = NDArray[np.float64]
Values = dict[str, float]

LEVELS = ("weak", "medium", "strong")


@dataclass(frozen=True)
class Scale:
    """What a healthy robot does in a recording: root mean squares and ranges of its motion, by joint and actuator."""

    torque: dict[str, float]
    speed: dict[str, float]
    inertia: dict[str, float]
    low: dict[str, float]
    high: dict[str, float]
    begin: dict[str, float]
    force: Array
    swing: Array
    rate: Array
    total_force: float
    column: dict[str, tuple[float, float]]
    seconds: float

    @classmethod
    def of(cls, truth: Truth, healthy: Run, commands: Array) -> Scale:
        """Measure a healthy run on its commands (n, nu)."""
        model = truth.model
        inertia, torque, speed = {}, {}, {}
        for name in healthy.position:
            dof = truth.dof(name)
            inertia[name] = float(model.dof_M0[dof])
            acceleration = float(np.gradient(healthy.speed[:, dof], healthy.time).std())
            drive = float(np.sqrt((healthy.torque[:, dof] ** 2).mean()))
            torque[name] = max(drive, 0.3 * inertia[name] * acceleration)
            speed[name] = float(healthy.speed[:, dof].std()) or 1.0
        force = np.sqrt((healthy.force**2).mean(axis=0))
        rates = np.abs(np.gradient(commands, healthy.time, axis=0))
        return cls(
            torque,
            speed,
            inertia,
            {n: float(np.percentile(v, 1)) for n, v in healthy.position.items()},
            {n: float(np.percentile(v, 99)) for n, v in healthy.position.items()},
            {n: float(v[0]) for n, v in healthy.position.items()},
            np.percentile(np.abs(healthy.force), 95, axis=0),
            commands.std(axis=0),
            np.percentile(rates, 95, axis=0),
            float(force.sum()),
            {n: (float(v.std()), float(np.abs(v - np.median(v)).max())) for n, v in healthy.columns.items()},
            float(healthy.time[-1]),
        )


Inject = Callable[[Truth, Scale, str, float], Values]


@dataclass(frozen=True)
class Fault:
    """A fault: the name that a diagnosis should give it, the kind of its site, and its relative sizes.

    ``inject(truth, scale, member, size)`` returns the parameters that a diagnosis should find; an empty mapping where
    the mechanism has no parameter in common with the library's.
    """

    name: str
    kind: str
    sizes: tuple[float, float, float]
    inject: Inject
    known: bool = True


def steepness(truth: Truth, dof: int, level: float, speed: float) -> float:
    """Of a smooth friction law at standstill: steep, but no steeper than the time step can carry."""
    return min(0.5 * float(truth.model.dof_M0[dof]) / float(truth.model.opt.timestep), level / (0.01 * speed))


def by_chance(scale: Scale, joint: str) -> np.random.Generator:
    """The same for a joint of one recording."""
    return np.random.default_rng(round(1e6 * abs(scale.high[joint] - scale.low[joint])))


def actuator_index(truth: Truth, actuator: str) -> int:
    """An actuator's number in the model."""
    return int(truth.model.actuator(actuator).id)


def varied(size: float) -> float:
    """A number in [0, 1) that differs from case to case, as sizes do, and is the same whenever a case is made again."""
    return float(np.modf(97.0 * size)[0])
