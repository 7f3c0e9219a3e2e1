"""How a recording is cut: short windows that are replayed, grouped into blocks that are fitted or kept for scoring."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from simgap.data.align import HOLE_PERIODS, Aligned
from simgap.data.errors import GapInputError
from simgap.simulation.contacts import colliding
from simgap.simulation.state import smoothing_length

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

HORIZON = 0.6
"""[s] of free run: long enough for a delay, a dead band or friction to show, short enough for chaos not to."""
HORIZON_HEAVY = 0.3
"""[s] of free run of models that are not `light`: as much shows in half of it, at half the price."""
WARM_UP = 0.15
"""[s] before it in which the model is held to the measurement, so that what is not measured can settle."""
HORIZONS_LONG = (2.4, 1.2)
"""[s] of free run of robots that forget their start: the first of which a recording holds enough."""
_COVERED = 0.85
"""Share of what shorter windows cover that longer ones have to cover."""
FOLDS = 3
_WINDOWS_PER_BLOCK, _LONG_PER_BLOCK = 3, 2
"""At least, of windows up to HORIZON and of longer ones; shorter windows make blocks of _BLOCK."""
_BLOCK = 1.2
"""[s]"""
_REST, _NEAR = 0.08, 4.0
"""[s] for which an output stays within so many noise deviations of its extreme where it rests there."""
_RANGE = 40.0
"""[noise deviations] An output that moves less has no ends."""
_PATIENCE = 3
"""Lengths of a window that are waited for a better place to start it."""
_MAX_SAMPLES = 120
MAX_WINDOWS = 60
"""More are thinned out by whole blocks: 36 s of scored motion say what a long recording has to say."""
MIN_WINDOWS = 24
"""What a slow model gets at least."""
FEW_LONG = 12
"""Longer windows a recording must hold at least, to be cut into them: each says more."""
LIGHT, LIGHT_IN_THE_AIR = 8, 12
"""Degrees of freedom up to which a model gets all of them; the second where nothing touches anything, which makes
replays cheap."""


@dataclass(frozen=True)
class Windows:
    """Windows of equal length.

    Attributes:
        start: (nw,) first scored row of the grid; the warm-up lies before it.
        warm_up, length: rows.
        sample: (ns,) rows after ``start`` that are compared (all, or every so many).
        block: (nw,) number of the block.
        fold: (nw,) fold in which the window is held out; -1 for one that is only fitted.
    """

    start: Ints
    warm_up: int
    length: int
    sample: Ints
    block: Ints
    fold: Ints

    def __len__(self) -> int:
        return len(self.start)

    @property
    def folds(self) -> int:
        """Number of folds."""
        return int(self.fold.max()) + 1

    def rows(self) -> Ints:
        """Grid rows of all compared samples, (nw, ns)."""
        rows: Ints = self.start[:, None] + self.sample[None, :]
        return rows

    def of(self, keep: NDArray[np.bool_]) -> Windows | None:
        """Those windows (nw,) alone, dealt to folds anew where a fold has none left; None where there are too few."""
        block = np.unique(self.block[keep], return_inverse=True)[1].astype(np.int64)
        fold = self.fold[keep]
        if set(fold[fold >= 0].tolist()) != set(range(self.folds)):
            fold = block % FOLDS
        if len(set(block.tolist())) < 2 * FOLDS:
            return None
        return replace(self, start=self.start[keep], block=block, fold=fold)


def longer(aligned: Aligned, warm_up: float = WARM_UP) -> float:
    """The longest horizon [s] of which a recording holds MIN_WINDOWS, that leaves little of it out."""

    def held(horizon: float) -> tuple[int, float]:
        length, lead = horizon / aligned.period, warm_up / aligned.period
        windows = sum(int((r.stop - r.start - lead) / length) for r in aligned.runs)
        return windows, windows * horizon

    most = held(HORIZON)[1]
    for horizon in HORIZONS_LONG:
        windows, covered = held(horizon)
        if windows >= FEW_LONG and covered >= _COVERED * most:
            return horizon
    return HORIZON


def covering(aligned: Aligned, horizons: Sequence[float], warm_up: float = WARM_UP) -> float | None:
    """The first of ``horizons`` [s] that leaves out little of what windows of HORIZON cover; None where all do."""

    def seconds(horizon: float) -> float:
        return horizon * sum(int((r.stop - r.start) * aligned.period / (horizon + warm_up)) for r in aligned.runs)

    return next((h for h in horizons if seconds(h) >= _COVERED * seconds(HORIZON)), None)


def light(model: mujoco.MjModel) -> bool:
    """Whether a model is replayed so fast that nothing has to be saved."""
    return bool(model.nv <= (LIGHT if colliding(model)[0] else LIGHT_IN_THE_AIR))


def affordable(model: mujoco.MjModel) -> int:
    """How many windows a model is worth: one with many degrees of freedom is slower, and says more in each.

    Its steps take longer, and there are more numbers of which each needs a replay.
    """
    return int(np.clip(MAX_WINDOWS * (LIGHT / max(model.nv, 1)) ** 2, MIN_WINDOWS, MAX_WINDOWS))


def at_limit(aligned: Aligned, floor: Array) -> NDArray[np.bool_]:
    """Rows (n,) in which some output rests at the end of its range: a stop, or a sensor that sees no further.

    What a saturated sensor tells is no place to start a replay from. ``floor`` (no,) is the outputs' noise.
    """
    found = np.zeros(len(aligned.outputs), bool)
    long = max(round(_REST / aligned.period), 3)
    for y, valid, noise in zip(aligned.outputs.T, aligned.valid.T, floor, strict=True):
        if valid.sum() < 10 * long:
            continue
        ends = np.percentile(y[valid], [0.5, 99.5])
        if np.ptp(ends) < _RANGE * noise:
            continue
        for end in ends:
            # The extreme lies at the edge of the noise about where it rests.
            edge = y[valid & (np.abs(y - end) < 2.0 * _NEAR * noise)]
            if not len(edge):
                continue
            level = np.median(edge)
            rests = valid & (np.abs(y - level) < _NEAR * noise)
            edges = np.flatnonzero(np.diff(np.concatenate([[0], rests.astype(int), [0]]))).reshape(-1, 2)
            for first, last in edges[np.diff(edges, axis=1)[:, 0] >= long]:
                found[first:last] = True
    return found


def unseen(aligned: Aligned) -> NDArray[np.bool_]:
    """Rows (n,) in a hole of some output, which lost samples there that it has elsewhere: a tracker's drop-out.

    What an output was before and is after says little of what it was within, so that no replay can start there, nor so
    near that its speed is smoothed over the hole.
    """
    found, near = np.zeros(len(aligned.time), dtype=bool), smoothing_length(aligned.period) // 2
    for valid in aligned.valid.T[aligned.live]:
        usual = np.median(np.diff(np.flatnonzero(valid))) if valid.sum() > 1 else 1.0
        for run in aligned.runs:
            rows = run.start + np.flatnonzero(valid[run.start : run.stop])
            edges = np.concatenate([[run.start - 1], rows, [run.stop]])
            for hole in np.flatnonzero(np.diff(edges) > HOLE_PERIODS * usual):
                found[max(edges[hole] + 1 - near, 0) : edges[hole + 1] + near] = True
    return found


def cut(
    aligned: Aligned,
    horizon: float = HORIZON,
    warm_up: float = WARM_UP,
    most: int = MAX_WINDOWS,
    avoided: NDArray[np.bool_] | None = None,
) -> Windows:
    """Tile every run with windows and deal its blocks to folds.

    A window that would begin in an ``avoided`` row (n,) begins later, by three of its lengths at most; one that would
    begin where an output was `unseen`, behind that.

    Where the recording names runs to be held out, these are the one fold and all others are only fitted. Otherwise
    whole runs go to FOLDS folds in turn where there are as many, none of them half of all, so that what is scored was
    recorded at another time, with other gains or another payload. Of fewer runs it is blocks of neighbouring windows,
    so that each fold sees the whole recording and no sample is scored by a fit that has seen its neighbours; the
    warm-up is the gap between blocks.

    Raises:
        GapInputError: fewer than two blocks for each fold.
    """
    length = max(round(horizon / aligned.period), 5)
    lead = max(round(warm_up / aligned.period), 1)
    per_block = max(_WINDOWS_PER_BLOCK if horizon <= HORIZON else _LONG_PER_BLOCK, round(_BLOCK / horizon))
    starts: list[int] = []
    blocks: list[int] = []
    folds: list[int] = []
    labels: list[float] = []
    number, holes = -1, unseen(aligned)
    for run in aligned.runs:
        held = run.label in aligned.held_out
        position, inside = run.start + lead, 0
        number += 1
        waited = 0
        while position + length < run.stop:
            if holes[position - lead : position + 1].any():
                position += 1
                continue
            if avoided is not None and waited < _PATIENCE * length and avoided[position - lead : position + 1].any():
                position, waited = position + 1, waited + 1
                continue
            waited = 0
            if inside == per_block:
                number, inside = number + 1, 0
                position += lead
                if position + length >= run.stop:
                    break
            starts.append(position)
            blocks.append(number)
            labels.append(run.label)
            folds.append((0 if held else -1) if aligned.held_out else number % FOLDS)
            position, inside = position + length, inside + 1
    if len(starts) > most:
        numbers = sorted(set(blocks))
        count = max(int(len(numbers) * most / len(starts)), 2)
        kept = {numbers[i] for i in np.linspace(0, len(numbers) - 1, count).round().astype(int)}
        keep = [i for i, b in enumerate(blocks) if b in kept]
        starts, blocks, folds = ([values[i] for i in keep] for values in (starts, blocks, folds))
        labels = [labels[i] for i in keep]
    block = np.unique(np.array(blocks, np.int64), return_inverse=True)[1].astype(np.int64)
    fold = np.array(folds, np.int64)
    if not aligned.held_out and len(fold):
        known, own, times = np.unique(labels, return_inverse=True, return_counts=True)
        by_run = len(known) >= FOLDS and times.max() <= 0.5 * len(fold)
        fold = (own if by_run else block).astype(np.int64) % FOLDS
    for f in range(int(fold.max(initial=0)) + 1):
        inside, outside = (len(set(block[m].tolist())) for m in (fold == f, fold != f))
        if inside < 1 or outside < 1:
            raise GapInputError(
                f"the recording gives {len(set(blocks))} blocks of {per_block} windows of {horizon:g} s"
                + (f", {holes.mean():.0%} of it lies in holes of some output" if holes.any() else "")
                + "; fitting and scoring need at least one each; record longer or name other runs as held_out"
            )
    return Windows(np.array(starts, np.int64), lead, length, compared(length), block, fold)


def compared(length: int) -> Ints:
    """Which samples of a window of ``length`` rows are compared: all, or every so many."""
    stride = max(1, -(-length // _MAX_SAMPLES))
    return np.arange(stride - 1, length, stride, dtype=np.int64)
