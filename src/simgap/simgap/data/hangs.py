"""A sensor that hangs: it repeats its last value while the robot moves on, and then jumps to where that is by now.

A tracker that lost its markers, a driver that waits for its bus. A joint that stands still is not taken for one: it
neither moves just before and after, nor jumps.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simgap.data.lattice import lattice_step

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

_LEAST, _LONGER = 4, 3.0
"""Repeats in a row, and times as many as there usually are: a log that asks ten times as often as its sensor answers
repeats each value nine times."""
_JUMP = 3.0
"""How many times as large as the steps before and after the jump at the end is at least."""
_MOVES, _COUNTS = 0.3, 3.0
"""Of the usual step, and counts of an encoder: as much it moves at least, before and after."""
_RARE = 0.02
"""Share of the other samples that repeat the one before, at most, where a sensor's noise never tells a value twice."""
_NOISY = 2e-5
"""Of a channel's spread: so much noise it has then, at least."""


def hangs(outputs: Array) -> Bools:
    """Which samples (n, channels) of sensors are no more than the repeated value of one that hangs.

    A channel that hangs is told by a jump. In one that has, a value that it repeats is another hang where its noise
    never tells one twice, or where it moves just before and after. Others hang with it where they repeat a value
    just as long, as those of one tracker do. A value that is not finite is none.
    """
    stretches = [_stretches(values) for values in outputs.T]
    certain = {(rows[begin], rows[end]) for rows, long, sure in stretches for begin, end in long[sure]}
    found = np.zeros(outputs.shape, dtype=bool)
    for channel, (rows, long, _) in enumerate(stretches):
        for begin, end in long:
            if (rows[begin], rows[end]) in certain:
                found[rows[begin + 1 : end + 1], channel] = True
    return found


def _stretches(values: Array) -> tuple[NDArray[np.int64], NDArray[np.int64], Bools]:
    """Of a channel (n,): the rows that hold a value; first and last sample of each long stretch of one value, counted
    in these; and which of the stretches are no rest.
    """
    rows = np.flatnonzero(np.isfinite(values))
    sampled = values[rows]
    steps = np.diff(sampled)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], steps == 0.0, [False]])))
    stretches = edges.reshape(-1, 2)
    lengths = stretches[:, 1] - stretches[:, 0]
    often = float(np.median(np.diff(np.flatnonzero(steps)))) - 1.0 if np.count_nonzero(steps) > 1 else 0.0
    is_long = lengths >= max(_LEAST, _LONGER * often)
    long = stretches[is_long]
    if not len(long) or not steps.any():
        return rows, long, np.zeros(len(long), dtype=bool)
    size, lattice = np.abs(steps), lattice_step(sampled)
    inside = (long[:, 0] > 0) & (long[:, 1] + 1 < len(steps))
    before, jump, after = (size[np.clip(at, 0, len(steps) - 1)] for at in (long[:, 0] - 1, long[:, 1], long[:, 1] + 1))
    usual = float(np.median(size[size > 0.0]))
    moves = inside & (np.minimum(before, after) > max(_MOVES * usual, _COUNTS * lattice))
    jumps = moves & (jump > _JUMP * np.maximum(before, after))
    if not jumps.any():
        return rows, long, jumps
    # A sensor that has hung is believed to rest only where its noise would not show, and it does not move up to there.
    rare = lengths[~is_long].sum() <= _RARE * (len(steps) - lengths[is_long].sum())
    never_twice = lattice == 0.0 and rare and _noise(sampled, steps) > _NOISY * float(np.ptp(sampled))
    return rows, long, long[:, 0] > 0 if never_twice else moves


def _noise(sampled: Array, steps: Array) -> float:
    """Deviation of a channel's samples (n,) from a smooth course, by fourth differences where it repeats nothing."""
    free = np.convolve(steps == 0.0, np.ones(4), mode="valid") == 0.0
    fourth = np.abs(np.diff(sampled, 4))[free]
    return float(np.median(fourth)) * 1.4826 / np.sqrt(70.0) if len(fourth) else 0.0
