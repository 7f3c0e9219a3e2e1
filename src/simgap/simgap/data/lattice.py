"""The lattice on which sampled values lie: the counts of an encoder."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def lattice_step(values: Array) -> float:
    """Step of the lattice on which sampled values (n,) lie, as those of an encoder do; 0 where there is none."""
    levels = np.unique(values)
    if len(levels) < 3:
        return 0.0
    steps = np.diff(levels)
    steps = steps[steps > 1e-9 * max(float(np.ptp(levels)), 1e-12)]
    step = float(np.percentile(steps, 5)) if len(steps) else 0.0
    # Encoders' values are written with few digits, which moves each by a little.
    on_lattice = step > 0.0 and float(np.mean(np.abs(steps / step - np.round(steps / step)) < 0.02)) > 0.9
    return step if on_lattice else 0.0
