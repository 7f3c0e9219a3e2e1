"""Pictures without a pose, and poses that cannot be."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]

PAIRS = 6
"""Neighbours on each side by which a pose is judged: 0.2 s at 30 Hz, less than a step."""
LEAST_PAIRS = 3
"""Fewer at a film's ends, where one bad pose would outvote a good one, judge nothing."""
LEAST_POSES = 2 * PAIRS + 1
"""A film with fewer is none."""
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


def outliers(time: Array, position: Array, rotation: Rotation, spread: Array) -> NDArray[np.bool_]:
    """(n,) Which poses stand alone.

    Each pair of neighbours, one before and one after, says where a pose is on the straight way between them. A pose is
    an outlier where it is farther from the median of what they say than its own noise and their scatter take it, and
    is not on the way from those before to those after: a mouse whose servos step jumps from one picture to the next.

    Args:
        time: (n,) [s]
        position: (n, 3) [m]
        rotation: n of them.
        spread: (n, 6, 6) Covariances.
    """
    count = len(time)
    here, apart = np.arange(count), np.arange(1, PAIRS + 1)
    before, after = here[:, None] - apart, here[:, None] + apart
    there = (before >= 0) & (after < count)
    judged = there.sum(axis=1) >= LEAST_PAIRS
    before, after = np.maximum(before, 0), np.minimum(after, count - 1)
    share = (time[:, None] - time[before]) / np.maximum(time[after] - time[before], 1e-9)
    found = np.zeros(count, dtype=bool)
    turned = _turned(rotation, here, before)
    # Half a turn one way is half a turn the other way: neighbours must not disagree on that.
    sides_turned = [_unwrapped(turns, turned[:, :1]) for turns in (turned, _turned(rotation, here, after))]
    for values, block in (
        ([position[rows] - position[:, None] for rows in (before, after)], slice(0, 3)),
        (sides_turned, slice(3, 6)),
    ):
        sides = [np.where(there[..., None], side, np.nan)[judged] for side in values]
        own = np.sqrt(np.trace(spread[judged][:, block, block], axis1=1, axis2=2))
        found[judged] |= _far(sides, share[judged][..., None], own) & _beyond(sides, own)
    return found


def _far(sides: list[Array], share: Array, own: Array) -> NDArray[np.bool_]:
    """(n,) Which poses, at zero, are far from the middle of what pairs of ``sides`` (n, pairs, 3) say."""
    said = sides[0] + share * (sides[1] - sides[0])
    middle = np.nanmedian(said, axis=1)
    scatter = 1.4826 * np.nanmedian(np.linalg.norm(said - middle[:, None], axis=2), axis=1)
    return np.asarray(np.linalg.norm(middle, axis=1) > FAR * np.hypot(scatter, own), dtype=bool)


def _beyond(sides: list[Array], own: Array) -> NDArray[np.bool_]:
    """(n,) Which poses, at zero, are outside of the box from the nearest on one side to those on the other."""
    ends = np.stack([np.nanmedian(side[:, :LEAST_PAIRS], axis=1) for side in sides])
    excess = np.maximum(np.maximum(ends.min(axis=0), -ends.max(axis=0)), 0.0)
    return np.asarray(np.linalg.norm(excess, axis=1) > FAR * own, dtype=bool)


def _unwrapped(turns: Array, reference: Array) -> Array:
    """(n, pairs, 3) [rad] The same rotations, each by that of its two vectors which is nearer to ``reference``."""
    length = np.linalg.norm(turns, axis=-1, keepdims=True)
    other = turns - 2.0 * np.pi * turns / np.maximum(length, 1e-12)
    nearer = np.linalg.norm(other - reference, axis=-1) < np.linalg.norm(turns - reference, axis=-1)
    return np.where(nearer[..., None], other, turns)


def _turned(rotation: Rotation, here: NDArray[np.int64], rows: NDArray[np.int64]) -> Array:
    """(n, pairs, 3) [rad] Rotation vectors from each pose to those of ``rows``."""
    vectors = (rotation[rows.ravel()] * rotation[np.repeat(here, rows.shape[1])].inv()).as_rotvec()
    return np.asarray(vectors.reshape(*rows.shape, 3), dtype=np.float64)
