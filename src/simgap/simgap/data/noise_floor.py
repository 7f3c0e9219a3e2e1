"""The noise floor of each channel: what would differ if the very same experiment were repeated."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.signal import savgol_coeffs

from simgap.data.align import Aligned

Array = NDArray[np.float64]

_WINDOW, _ORDER = 7, 3
_STILL, _FEW = 1.5, 50
"""Steps without any change that a stretch of _WINDOW samples may have to be judged, and stretches that are needed.
Where a robot rests in its friction its encoder repeats itself, which says nothing of how well a motion repeats."""
_BEGIN = 10
"""Samples whose mean says where a run began."""
_BARE = 0.25
"""Share of the outputs that may be without noise, before it is said: some are computed on a real robot too."""
_MIN_SHARE = 2e-5
"""No floor is below this share of the channel's spread: a simulation's own errors are of that size."""


def noise_floor(aligned: Aligned) -> Array:
    """Standard deviation of the noise of every output, (no,) in the channel's unit.

    The largest of: scatter between repeats (runs with the same inputs), the high-frequency content (what a local cubic
    does not explain while the channel changes, by the median so that impacts do not count), the quantisation step /
    sqrt(12), and 2e-5 of the channel's spread.
    """
    spread = np.array([_spread(aligned, i) for i in range(aligned.outputs.shape[1])])
    floors = np.stack([_high_frequency(aligned), _quantisation(aligned), _repeats(aligned), _MIN_SHARE * spread])
    floor: Array = np.maximum(floors.max(axis=0), 1e-12)
    return floor


def without_noise(aligned: Aligned, floor: Array) -> NDArray[np.bool_]:
    """(no,) Outputs that move and in which no noise is seen, as in a simulation's log: only their spread says a floor.

    ``floor`` (no,) as `noise_floor` has it.
    """
    spread = np.array([_spread(aligned, i) for i in range(aligned.outputs.shape[1])])
    found: NDArray[np.bool_] = (spread > 0.0) & (floor <= 1.001 * _MIN_SHARE * spread)
    return found


def noise_warning(aligned: Aligned, floor: Array, names: Sequence[str]) -> str:
    """A sentence where many outputs are without noise; empty where few are."""
    bare = np.flatnonzero(without_noise(aligned, floor))
    if len(bare) < _BARE * len(floor):
        return ""
    some = ", ".join(names[i] for i in bare[:3])
    return (
        f"{len(bare)} of {len(floor)} outputs ({some}...) show no noise, as those of a simulation: noise floors are "
        "then far finer than any sensor, and a gap in them says little; give each what your sensors resolve "
        "(`resolution` in the map)"
    )


def input_noise(aligned: Aligned) -> Array:
    """Standard deviation of the white noise of every input, (ni,) in the channel's unit; 0 for one that is exact."""
    return _deviation(aligned, aligned.inputs, np.ones(aligned.inputs.shape, bool))


def _spread(aligned: Aligned, i: int) -> float:
    low, high = np.percentile(aligned.outputs[aligned.valid[:, i], i], [2, 98]) if aligned.valid[:, i].any() else (0, 0)
    return float(high - low)


def _high_frequency(aligned: Aligned) -> Array:
    return _deviation(aligned, aligned.outputs, aligned.valid)


def _deviation(aligned: Aligned, values: Array, valid: NDArray[np.bool_]) -> Array:
    """Robust deviation from a local cubic over 7 samples, corrected for what the cubic takes with it."""
    smoother = savgol_coeffs(_WINDOW, _ORDER)
    kept = float(np.sqrt(1.0 - smoother[_WINDOW // 2]))
    floor = np.zeros(values.shape[1])
    for i in range(values.shape[1]):
        residuals, changing = [], []
        for run in aligned.runs:
            y, ok = values[run.start : run.stop, i], valid[run.start : run.stop, i]
            rows = np.flatnonzero(ok)
            if len(rows) <= _WINDOW:
                continue
            # A channel slower than the grid is judged by its own samples.
            step = max(round(float(np.median(np.diff(rows)))), 1)
            y, ok = y[rows[0] :: step], ok[rows[0] :: step]
            residual = (y - np.convolve(y, smoother, mode="same"))[_WINDOW:-_WINDOW]
            whole = np.convolve(ok, np.ones(_WINDOW), mode="same")[_WINDOW:-_WINDOW] > _WINDOW - 0.5
            residuals.append(residual[whole])
            same = np.concatenate([[0.0], np.diff(y) == 0.0])
            changing.append((np.convolve(same, np.ones(_WINDOW - 1), mode="same")[_WINDOW:-_WINDOW] < _STILL)[whole])
        joined = np.concatenate(residuals) if residuals else np.zeros(0)
        moved = np.concatenate(changing) if changing else np.zeros(0, bool)
        if moved.sum() >= _FEW:
            joined = joined[moved]
        if len(joined):
            floor[i] = 1.4826 * float(np.median(np.abs(joined))) / kept
    return floor


def _quantisation(aligned: Aligned) -> Array:
    """Step / sqrt(12) where the sampled values lie on a lattice, or where the map says what a sensor resolves."""
    lattice = aligned.lattice if len(aligned.lattice) else np.zeros(aligned.outputs.shape[1])
    found: Array = lattice / np.sqrt(12.0)
    return found


def _repeats(aligned: Aligned) -> Array:
    """Deviation between runs that were told the same: sd of the difference / sqrt(2).

    Not of runs in which the robot was another (a payload, a stand): what these differ by is no noise. Nor counts where
    a run began, for there a replay begins too.
    """
    floor = np.zeros(aligned.outputs.shape[1])
    squares: list[Array] = []
    scale = np.ptp(aligned.inputs, axis=0) + 1e-12
    for a, first in enumerate(aligned.runs):
        for second in aligned.runs[a + 1 :]:
            n = min(first.stop - first.start, second.stop - second.start)
            if n < 50 or first.setup != second.setup:
                continue
            one, two = slice(first.start, first.start + n), slice(second.start, second.start + n)
            if np.max(np.abs(aligned.inputs[one] - aligned.inputs[two]) / scale) > 1e-6:
                continue
            both = aligned.valid[one] & aligned.valid[two]
            difference = np.where(both, aligned.outputs[one] - aligned.outputs[two], 0.0)
            began = difference[:_BEGIN].sum(axis=0) / np.maximum(both[:_BEGIN].sum(axis=0), 1)
            squares.append(np.mean(np.where(both, difference - began, 0.0) ** 2, axis=0) / 2.0)
    if squares:
        floor = np.sqrt(np.median(np.stack(squares), axis=0))
    return floor
