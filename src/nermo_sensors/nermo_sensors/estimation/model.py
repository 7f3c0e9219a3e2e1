"""What a leg-load filter assumes: how the load moves, and what the cells of the foot read then."""

from __future__ import annotations

from collections.abc import Callable
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


@dataclass(frozen=True, slots=True)
class CellModel:
    """What a filter assumes of one cell."""

    read: Callable[[Array, Array], Reading]
    """Of states (B, n) and of what it does read (B,) [V], for a cell where that says where to take the slope."""
    variance: Any
    """Of a reading [V^2], a number or (B,)."""
    saturation: Callable[[Array, Array], tuple[Mask, Array]] | None = None
    """Of readings (B,) [V] and states (B, n): which are saturated, and the load [N] that they prove then."""
    bound_variance: Any = 0.0
    """Of that load [N^2]."""


class LoadModel(Protocol):
    """Model of B legs. State 0 is always the load F [N], state 1 its rate [N/s]."""

    states: tuple[str, ...]
    """Names of the n states."""
    cells: dict[str, CellModel]
    """Of the cells whose memory is part of the state, by name."""
    bend: float
    """A load that moves by more in one step [N] makes the slopes of `predict` wrong; infinite where that is linear."""

    def start(self, count: int) -> tuple[Array, Array]:
        """States (B, n) and covariances (B, n, n) before any reading."""

    def predict(self, x: Array, period: float, towards: Array | None = None) -> tuple[Array, Array]:
        """States a period [s] later, and their Jacobian (B, n, n) or (n, n).

        The Jacobian is that of the predicted loads, or the secant to the loads `towards` (B,) [N].
        """

    def process(self, period: float) -> Array:
        """Variances that a period [s] adds to the states, shape (n,) or (B, n)."""

    def observe_frequency(self, frequency: float) -> tuple[Reading, float] | None:
        """Takes the load's frequency [rad/s]; a model with the frequency in its state answers a reading for it."""
