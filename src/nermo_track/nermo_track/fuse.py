"""Several cameras' poses made one, each weighed by how well it knows what."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

Array = NDArray[np.float64]

REACH = 0.1
"""[s] Two poses farther apart say nothing of the time between them."""


@dataclass(frozen=True)
class Poses:
    """Poses of base_link in the world against time."""

    time: Array
    """(n,) [s]"""
    position: Array
    """(n, 3) [m]"""
    rotation: Rotation
    """n of them"""
    covariance: Array
    """(n, 6, 6) [m, rad, fixed axes]"""


@dataclass(frozen=True)
class Disagreement:
    """By how much a camera's poses are from the first one's, in the median."""

    position: float
    """[m]"""
    angle: float
    """[rad]"""


def fuse(cameras: Sequence[Poses]) -> tuple[Poses, list[Disagreement]]:
    """Poses at the times of the camera that has most of them, and how far the others were from it.

    Others are interpolated to these times where they have a pose before and after. What all of them share, as a sheet
    that was printed too small, no weight can mend; nor does a covariance know where a camera stands wrongly.

    Args:
        cameras: Each in the world and the recording's time.
    """
    first = max(cameras, key=lambda poses: len(poses.time))
    information = np.linalg.inv(first.covariance)
    pull = np.zeros((len(first.time), 6))
    apart = []
    for other in cameras:
        if other is first:
            continue
        rows, offset, spread = _seen_from(first, other)
        if len(rows) == 0:
            continue
        apart.append(
            Disagreement(
                float(np.median(np.linalg.norm(offset[:, :3], axis=1))),
                float(np.median(np.linalg.norm(offset[:, 3:], axis=1))),
            )
        )
        weight = np.linalg.inv(spread)
        information[rows] += weight
        pull[rows] += np.einsum("nij,nj->ni", weight, offset)
    covariance = np.linalg.inv(information)
    moved = np.einsum("nij,nj->ni", covariance, pull)
    rotation = Rotation.from_rotvec(moved[:, 3:]) * first.rotation
    return Poses(first.time, first.position + moved[:, :3], rotation, covariance), apart


def _seen_from(first: Poses, other: Poses) -> tuple[NDArray[np.int64], Array, Array]:
    """Rows of ``first`` at which ``other`` has a pose too, its offset (m, 6) [m, rad] from it, and its covariance."""
    after = np.searchsorted(other.time, first.time)
    inside = (after > 0) & (after < len(other.time))
    rows = np.flatnonzero(inside)
    rows = rows[other.time[after[rows]] - other.time[after[rows] - 1] <= REACH]
    if len(rows) == 0:
        return rows, np.empty((0, 6)), np.empty((0, 6, 6))
    time = first.time[rows]
    place = np.column_stack([np.interp(time, other.time, column) for column in other.position.T])
    turn = Slerp(other.time, other.rotation)(time)
    offset = np.hstack([place - first.position[rows], (turn * first.rotation[rows].inv()).as_rotvec()])
    return rows, offset, other.covariance[after[rows]]
