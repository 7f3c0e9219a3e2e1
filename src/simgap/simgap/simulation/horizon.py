"""How long a window may be: not so long that the robot forgets nothing and amplifies everything."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simgap.simulation.replay import Replayer
from simgap.simulation.variant import Variant

Array = NDArray[np.float64]

SHORTEST = 0.15
"""[s]"""
_GROWN = 1.5
"""Once an error of the start has grown by this factor in many windows, what comes after it is chaos, not evidence."""
_FORGOTTEN = 0.5
"""Where it has shrunk to this by the end of a window, the robot forgets its start, and longer windows show what is
wrong in the steady state as well."""
_MANY = 80.0
"""[%] of the windows in which it has not."""
_ERRORS = 2.0
"""Standard errors by which a start is moved; small against any motion."""


def usable_horizon(replayer: Replayer, nominal: Variant) -> float:
    """Longest horizon [s] over which the robot does not blow up an error of its start; that of the windows at most.

    A servo forgets such an error, a cart carries it on; a swinging double pendulum triples it in a third of a second,
    and in windows twice as long shows little else. Every measured coordinate is
    moved a little; errors are compared in units of each coordinate's spread over the recording.

    Asked only where all coordinates are measured and none is a free body's: a contact enlarges an error once, not on
    and on, and shorter windows would not help.
    """
    state = replayer.state
    if state.base is not None or not state.complete(replayer.plant.model):
        return float((replayer.windows.sample[-1] + 1) * replayer.aligned.period)
    growth = start_growth(replayer, nominal)
    period = replayer.aligned.period
    times = (replayer.windows.sample + 1) * period
    if growth.size == 0:
        return float(times[-1])
    typical = np.percentile(growth.max(axis=0), _MANY, axis=0)
    grown = np.flatnonzero(np.maximum.accumulate(typical) > _GROWN)
    return max(float(times[grown[0]]), SHORTEST) if len(grown) else float(times[-1])


def forgets(replayer: Replayer, nominal: Variant, left: float = _FORGOTTEN, most: int | None = None) -> bool:
    """Whether at most a share ``left`` of an error of the start is there at the end of a window, in most windows.

    ``most``: so many of them are looked at, spread over the recording; all where None.
    """
    state = replayer.state
    if state.base is not None or not state.complete(replayer.plant.model):
        return False
    growth = start_growth(replayer, nominal, most)
    return bool(growth.size and np.percentile(growth[..., -1].max(axis=0), _MANY) < left)


def start_growth(replayer: Replayer, nominal: Variant, most: int | None = None) -> Array:
    """Factor (nm, nw, ns) by which an error of each measured scalar coordinate has grown at each sample.

    In all windows, or in ``most`` of them.
    """
    state, count = replayer.state, len(replayer.windows)
    windows = np.unique(np.linspace(0, count - 1, min(most or count, count)).round().astype(np.int64))
    nw = len(windows)
    known = np.flatnonzero(state.qpos >= 0)
    channels = {c.qpos: i for i, c in enumerate(replayer.plant.outputs) if c.qpos >= 0 and replayer.aligned.live[i]}
    swing = np.maximum(state.position.std(axis=0), 1e-12)
    count = len(known) + 1
    shift = np.zeros((count, state.size))
    for k, j in enumerate(known):
        shift[k + 1, j] = _ERRORS * state.position_sd[j]
    outputs = replayer.run_pairs(
        [nominal],
        np.zeros(count * nw, np.int64),
        np.tile(windows, count),
        np.repeat(shift, nw, axis=0),
        np.zeros((count * nw, state.size)),
    )
    outputs = outputs.reshape(count, nw, *outputs.shape[1:])
    square = np.zeros((len(known), *outputs.shape[1:3]))
    for j in known:
        channel = channels[int(state.qpos[j])]
        gear = replayer.plant.outputs[channel].gear
        square += np.nan_to_num(((outputs[1:, ..., channel] - outputs[0, ..., channel]) / (gear * swing[j])) ** 2)
    start = np.array([shift[k + 1, j] / swing[j] for k, j in enumerate(known)]).reshape(-1, 1, 1)
    growth: Array = np.sqrt(square) / np.maximum(start, 1e-300)
    return growth
