"""What a leg-load filter assumes: how the load moves, and what the two cells read then."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Reading:
    """What a cell should read, for each of B filters."""

    value: Array
    """[V], shape (B,)."""
    gradient: Array
    """By the state, shape (B, n)."""


class LoadModel(Protocol):
    """Model of B legs. State 0 is always the load F [N], state 1 its rate [N/s]."""

    states: tuple[str, ...]
    """Names of the n states."""
    piezoresistive_variance: Any
    """Of a reading [V^2], a number or (B,)."""
    piezoelectric_variance: Any
    bound_variance: Any
    """Of the load that a saturated reading proves [N^2]."""

    def start(self, count: int) -> tuple[Array, Array]:
        """States (B, n) and covariances (B, n, n) before any reading."""

    def predict(self, x: Array, period: float) -> tuple[Array, Array]:
        """States a period [s] later, and their Jacobian (B, n, n) or (n, n)."""

    def process(self, period: float) -> Array:
        """Variances that a period [s] adds to the states, shape (n,) or (B, n)."""

    def piezoresistive(self, x: Array, voltage: Array) -> Reading:
        """Of the static cell; `voltage` (B,) is what it does read, for a model that cares where to take the slope."""

    def piezoelectric(self, x: Array) -> Reading:
        """Of the dynamic cell."""

    def saturation(self, voltage: Array, x: Array) -> tuple[Mask, Array]:
        """Whether a reading (B,) of the static cell is saturated, and the load [N] that it proves then."""

    def observe_frequency(self, frequency: float) -> tuple[Reading, float] | None:
        """Takes the load's frequency [rad/s]; a model with the frequency in its state answers a reading for it."""
