"""What a cell remembers: hysteresis and creep. Each has a forward model and, where it differs, the estimator's own."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


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


@dataclass(frozen=True, slots=True)
class LoopPlays:
    """Plays with the full loop that a calibration found: the version that an estimator can carry in its states.

    felt = elastic F + weight (p1 + ... + pn), each place p within its slack of F. Unlike a law that knows the last
    reversal only (Dahl's), plays come back to where they were after a smaller loop within a larger one.
    """

    slacks: Array
    """(n,) [N]"""
    weight: float
    """Of each [1]."""

    @classmethod
    def of_loop(cls, half_width: float, reversal_force: float, count: int) -> LoopPlays:
        """Plays whose full loop is +-half_width [N] about F and closes as exp(-change / reversal_force [N]).

        Infinitely many would do that exactly, their weights falling as exp(-2 slack / reversal_force); here are
        `count` of equal weight, each at the mean slack of its share.
        """
        if not (half_width >= 0.0 and reversal_force > 0.0 and count >= 1):
            raise ValueError(f"half_width = {half_width} N, reversal_force = {reversal_force} N, count = {count}")
        left = 1.0 - np.arange(count + 1) / count
        # Of an exponential distribution: the integral of u exp(-u) from where the share `left` remains.
        beyond = left * (1.0 - np.log(np.maximum(left, 1e-300)))
        return cls(0.5 * reversal_force * count * -np.diff(beyond), 2.0 * half_width / reversal_force / count)

    @property
    def elastic(self) -> float:
        """Share of the force that is felt at once [1]."""
        return 1.0 - self.weight * len(self.slacks)

    def step(self, places: Array, force: Array) -> Array:
        """Places (B, n) [N] once the forces (B,) [N] are reached, each monotone since the last call."""
        return np.clip(places, force[:, None] - self.slacks, force[:, None] + self.slacks)

    def drags(self, places: Array, force: Array) -> NDArray[np.bool_]:
        """Which plays (B, n) move along with the forces (B,) [N] from there on."""
        return np.abs(places - force[:, None]) >= self.slacks


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
