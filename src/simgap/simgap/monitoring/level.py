"""How far a robot and its nominal model are apart in short windows, part by part."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simgap.data.align import Aligned
from simgap.data.excitation import NOISE_SPREAD
from simgap.data.plant import Plant
from simgap.inference.residual import Residuals
from simgap.simulation.replay import Replayer
from simgap.simulation.variant import Variant
from simgap.simulation.windows import WARM_UP, Windows

Array = NDArray[np.float64]

HORIZON = 0.25
"""[s] of a window: long enough for friction to show, and four of them a second."""
_SAMPLES = 40
"""Samples of a window that are compared, at most."""


@dataclass(frozen=True)
class Levels:
    """The gap of windows.

    Attributes:
        end: (nw,) [s] of the recording's time.
        level: (nw, np) logarithm of the mean square gap of every part, in noise floors.
        active: (nw, np) whether robot or model moved that part; otherwise there is nothing to compare.
    """

    end: Array
    level: Array
    active: NDArray[np.bool_]


def parts(plant: Plant) -> dict[str, list[int]]:
    """Outputs by the part of the robot (joint, body, tendon...) that they measure."""
    found: dict[str, list[int]] = {}
    for i, channel in enumerate(plant.outputs):
        found.setdefault(channel.subsystem, []).append(i)
    return found


def levels(plant: Plant, aligned: Aligned, floor: Array, after: float, threads: int | None = None) -> Levels | None:
    """The gap in all windows that begin ``after`` a time [s], one after the other; None where none fits.

    Each starts where the robot was measured to be, and runs free for HORIZON. What the measurement of the start may be
    off by is forgiven (`Residuals`).
    """
    windows = _tile(aligned, after)
    if windows is None:
        return None
    replayer = Replayer(plant, aligned, windows, floor, threads)
    nominal = Variant.nominal(plant)
    outputs = replayer.run([nominal])[0]
    residuals = Residuals.build(replayer, nominal)
    gap = residuals.whiten(residuals.raw(outputs))
    count = residuals.mask.sum(axis=1)
    square = (gap**2).sum(axis=1)
    swing = np.maximum(_swing(residuals.measured, residuals.mask), np.ptp(outputs[..., residuals.live], axis=1))
    moved = swing > NOISE_SPREAD * floor[residuals.live]
    place = {int(channel): k for k, channel in enumerate(residuals.live)}
    level, active = [], []
    for channels in parts(plant).values():
        mine = [place[c] for c in channels if c in place]
        samples = count[:, mine].sum(axis=1)
        level.append(np.log(np.maximum(square[:, mine].sum(axis=1) / np.maximum(samples, 1), 1e-6)))
        active.append((moved[:, mine] & (count[:, mine] > 0)).any(axis=1))
    end = aligned.time[windows.start + windows.length - 1]
    return Levels(end, np.stack(level, axis=1), np.stack(active, axis=1))


def _tile(aligned: Aligned, after: float) -> Windows | None:
    length = max(round(HORIZON / aligned.period), 5)
    lead = max(round(WARM_UP / aligned.period), 1)
    starts: list[int] = []
    for run in aligned.runs:
        position = run.start + lead
        while position + length < run.stop:
            if aligned.time[position] > after - 0.5 * aligned.period:
                starts.append(position)
                position += length
            else:
                position += 1
    if not starts:
        return None
    every = max(1, -(-length // _SAMPLES))
    count = np.arange(len(starts), dtype=np.int64)
    sample = np.arange(every - 1, length, every, dtype=np.int64)
    return Windows(np.array(starts, np.int64), lead, length, sample, count, np.zeros_like(count))


def _swing(values: Array, mask: NDArray[np.bool_]) -> Array:
    """Range (nw, nl) of values (nw, ns, nl) over the recorded samples."""
    low, high = np.where(mask, values, np.inf).min(axis=1), np.where(mask, values, -np.inf).max(axis=1)
    swing: Array = np.maximum(high - low, 0.0)
    return swing
