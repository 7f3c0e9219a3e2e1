"""Pictures without a pose, and poses that cannot be."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]

NEIGHBOURS = 9
"""Pictures in a row in which one that stands alone is told."""
FAR = 6.0
"""Robust standard deviations from its neighbours from which on a pose is an outlier. Chosen: one good sample in 10^8
were it Gaussian; a wrong pose is tens of them off."""


@dataclass(frozen=True)
class Missing:
    """Pictures without a pose, and why."""

    pictures: int
    lost: int
    """The mouse's tags were not found."""
    misfit: int
    """They were, but fit no pose."""
    jump: int
    """The pose is far from its neighbours'."""
    longest: float
    """[s] The longest time without a pose."""

    @property
    def share(self) -> float:
        """Of all pictures."""
        return (self.lost + self.misfit + self.jump) / self.pictures

    def sentence(self) -> str:
        """What is missing."""
        return (
            f"{self.pictures - self.lost - self.misfit - self.jump} of {self.pictures} pictures have a pose "
            f"({self.lost} without a tag, {self.misfit} whose tag fits no pose, {self.jump} far from their neighbours: "
            f"{100.0 * self.share:.1f} % missing, for {self.longest:.2f} s at the longest)"
        )


def longest_gap(time: Array, kept: NDArray[np.int64]) -> float:
    """[s] The longest time of ``time`` (n,) without one of ``kept`` (indices), the film's ends included."""
    edges = np.concatenate([[-1], kept, [len(time)]])
    widest = np.diff(edges) - 1
    step = float(np.median(np.diff(time)))
    return float(widest.max()) * step


def outliers(position: Array, rotation: Rotation, spread: Array) -> NDArray[np.bool_]:
    """(n,) Which poses stand alone: farther from the median of their neighbours than noise and motion take them.

    Args:
        position: (n, 3) [m]
        rotation: n of them.
        spread: (n, 6, 6) Covariances.
    """
    half = NEIGHBOURS // 2
    rows = np.clip(np.arange(-half, len(position) + half), 0, len(position) - 1)
    windows = sliding_window_view(rows, NEIGHBOURS)
    near = np.repeat(np.arange(len(position)), NEIGHBOURS)
    relative = (rotation[near].inv() * rotation[windows.ravel()]).as_rotvec().reshape(len(position), NEIGHBOURS, 3)
    found = np.zeros(len(position), dtype=bool)
    for values, block in ((position[windows] - position[:, None], slice(0, 3)), (relative, slice(3, 6))):
        middle = np.median(values, axis=1, keepdims=True)
        scatter = 1.4826 * np.median(np.linalg.norm(values - middle, axis=2), axis=1)
        own = np.sqrt(np.trace(spread[:, block, block], axis1=1, axis2=2))
        found |= np.linalg.norm(middle[:, 0], axis=1) > FAR * np.hypot(scatter, own)
    return found
