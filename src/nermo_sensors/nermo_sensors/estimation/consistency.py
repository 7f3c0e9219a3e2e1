"""Is an estimate as good as it says, and how good is it?"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Quality:
    """Of an estimate beside the truth."""

    rmse: float
    """[N]"""
    peak_error: float
    """Mean over the bumps of the estimated minus the true maximum [N]."""
    within_3_sigma: float
    """Share of time; 0.997 for a Gaussian."""
    nees: float
    """Mean squared error over variance; 1 is honest."""


def judge(truth: Array, load: Array, variance: Array, bumps: list[slice]) -> Quality:
    """Arrays of shape (n,); `bumps` are where one maximum each is to be found."""
    error = load - truth
    return Quality(
        rmse=float(np.sqrt(np.mean(error**2))),
        peak_error=float(np.mean([load[bump].max() - truth[bump].max() for bump in bumps])) if bumps else float("nan"),
        within_3_sigma=float(np.mean(error**2 <= 9.0 * variance)),
        nees=float(np.mean(error**2 / variance)),
    )


def find_bumps(truth: Array) -> list[slice]:
    """One slice for each stretch in which the truth is above half of its range."""
    above = np.concatenate([[False], truth > 0.5 * (truth.min() + truth.max()), [False]])
    edges = np.flatnonzero(np.diff(above.astype(np.int8)))
    return [slice(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]
