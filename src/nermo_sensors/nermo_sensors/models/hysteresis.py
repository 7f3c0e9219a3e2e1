"""What a cell remembers: hysteresis and creep. Each has a forward model and, where it differs, the estimator's own."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np


class PlayHysteresis:
    """Prandtl-Ishlinskii hysteresis: an elastic part and some plays, each of which follows within its slack.

    What the cell feels lags behind the force, by at most the sum of weight times slack, and does not depend on how
    fast the force changes. Scalar; one object a cell.
    """

    def __init__(self, slacks: Sequence[float], weights: Sequence[float]) -> None:
        if len(slacks) != len(weights):
            raise ValueError(f"weights: {len(weights)} of them for {len(slacks)} slacks")
        self._slacks, self._weights = tuple(slacks), tuple(weights)
        self._elastic = 1.0 - sum(weights)
        if self._elastic <= 0.0 or min(*weights, 0.0) < 0.0:
            raise ValueError(f"weights: {weights} must be 0 or more, and less than 1 together")
        self._places = [0.0] * len(slacks)

    def step(self, force: float) -> float:
        """The force that is felt [N] once `force` [N] is reached; monotone between two calls."""
        felt = self._elastic * force
        for number, (slack, weight) in enumerate(zip(self._slacks, self._weights, strict=True)):
            place = min(max(self._places[number], force - slack), force + slack)
            self._places[number] = place
            felt += weight * place
        return felt

    def clear(self) -> None:
        """Forgets everything."""
        self._places = [0.0] * len(self._places)


class ReversalHysteresis:
    """Dahl's hysteresis, the one-state version that an estimator can carry: felt = F + half_width z.

    z goes to -1 while the force rises and to +1 while it falls, within `reversal_force`:
    dz/dF = -(1 + z) / reversal_force rising, -(1 - z) / reversal_force falling. Arrays of any shape.
    """

    @staticmethod
    def step(z: Any, change: Any, reversal_force: float) -> tuple[Any, Any, Any]:
        """Z after the force changed by `change` [N], and its derivatives by z [1] and by the change [1/N]."""
        sign = np.where(change < 0.0, -1.0, 1.0)
        remain = np.exp(-np.abs(change) / reversal_force)
        return (z + sign) * remain - sign, remain, -(z * sign + 1.0) * remain / reversal_force


class Creep:
    """Conductance that builds up with the load of the last minutes (C 4.3.3): a sum of first-order lags.

    Scalar; one object a cell.
    """

    def __init__(self, gains: Sequence[float], times: Sequence[float]) -> None:
        if len(gains) != len(times):
            raise ValueError(f"gains: {len(gains)} of them for {len(times)} times")
        self._gains, self._times = tuple(gains), tuple(times)
        self._levels = [0.0] * len(gains)

    def step(self, force: float, period: float) -> float:
        """Relative gain of conductance [1] after `period` [s] under `force` [N]."""
        for number, (gain, time) in enumerate(zip(self._gains, self._times, strict=True)):
            self._levels[number] += (gain * force - self._levels[number]) * -math.expm1(-period / time)
        return sum(self._levels)

    def clear(self) -> None:
        """Forgets everything."""
        self._levels = [0.0] * len(self._levels)
