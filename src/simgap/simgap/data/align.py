"""From raw rows to a uniform grid: time checks, runs, dropped samples, wrapped angles, dead channels."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from simgap.data.errors import GapInputError
from simgap.data.glitches import QUANTITIES, glitches
from simgap.data.plant import Plant
from simgap.data.recording import Recording
from simgap.data.sample_times import sample_times

Array = NDArray[np.float64]

MIN_DURATION = 4.0
"""[s] Less than this gives too few blocks to keep some of them for scoring."""
MAX_PERIOD = 0.1
"""[s] A robot's log that is slower says nothing about its dynamics."""
_ENABLED = ""
"""Stands for the map's `enabled` among the auxiliary columns while they are resampled."""
_JUMP_PERIODS = 10.0
"""A step of time longer than this many periods ends a run."""
_EXACT, _SAME_PERIOD = 1e-7, 1e-3
"""Shares by which the mean of a steady clock's steps differs from their median: where stamps are exact, and at most."""
_ON_TICK, _EVERY_ROW = 0.1, 0.9
"""Of a period, how far a row may lie from a tick; and the share of rows that is nearly all."""
HOLE_PERIODS = 2.5
"""Outputs are not interpolated over holes longer than this many periods; such samples are not scored."""


@dataclass(frozen=True)
class Run:
    """Rows [start, stop) of the grid that follow each other without a gap; ``setup`` is one of `Plant.setups`."""

    start: int
    stop: int
    label: float
    setup: int = 0
    called: str = ""

    @property
    def name(self) -> str:
        """What the recording calls it: a word, the file that it came in, or its number."""
        return self.called or f"{self.label:g}"


@dataclass
class Aligned:
    """A recording on a uniform grid within each run.

    Attributes:
        period: [s] of the grid.
        time: (n,) [s].
        inputs: (n, ni), no NaN.
        outputs: (n, no), no NaN (held over holes).
        valid: (n, no) False where an output was not sampled.
        runs: in order; windows never cross their borders.
        live: (no,) False for an output that does not change at all.
        lattice: (no,) step of the lattice on which an output's values were sampled, before they were put on the grid; 0
            where they lie on none.
        enabled: (n,) False where the servos gave no torque.
        source: the file or files that it was read from, for messages.
    """

    period: float
    time: Array
    inputs: Array
    outputs: Array
    valid: NDArray[np.bool_]
    runs: tuple[Run, ...]
    live: NDArray[np.bool_]
    held_out: tuple[float, ...] = ()
    auxiliary: dict[str, Array] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    lattice: Array = field(default_factory=lambda: np.zeros(0))
    enabled: NDArray[np.bool_] = field(default_factory=lambda: np.ones(0, bool))
    source: str = "recording"

    def __post_init__(self) -> None:
        if not len(self.enabled):
            self.enabled = np.ones(len(self.time), bool)

    @property
    def duration(self) -> float:
        """[s] recorded, without the gaps."""
        return sum((r.stop - r.start - 1) * self.period for r in self.runs)


def align(recording: Recording, plant: Plant, shortest: float = MIN_DURATION, moving: bool = True) -> Aligned:
    """Split a recording into runs and put each on a uniform grid.

    Args:
        recording: what was sampled.
        plant: whose map named it.
        shortest: [s] of usable data that are needed.
        moving: whether an output that never changes is dead; otherwise it may be that the robot rests.

    Raises:
        GapInputError: time that is not finite or does not advance, less than ``shortest`` of usable data, or no output
            that changes.
    """
    warnings, source = list(recording.warnings), recording.source
    time, keep = recording.time, np.isfinite(recording.time) & np.isfinite(recording.segment)
    if not keep.all():
        warnings.append(f"{int((~keep).sum())} rows without a time or run number are left out")
    time, segment = time[keep], recording.segment[keep]
    inputs, outputs = recording.inputs[keep], recording.outputs[keep]
    auxiliary = {k: v[keep] for k, v in recording.auxiliary.items()}
    if recording.enabled is not None:
        auxiliary[_ENABLED] = recording.enabled[keep]
    _leave_out_glitches(outputs, plant, warnings)
    if len(time) < 10:
        raise GapInputError(f"{source}: time: {len(time)} rows have a time and a run; record at least {shortest:g} s")
    time = _as_sampled(time, segment, outputs, warnings)
    steps = np.diff(time)
    same_run = segment[1:] == segment[:-1]
    forward = steps[(steps > 0) & same_run]
    if len(forward) < 0.5 * len(steps):
        raise GapInputError(
            f"{source}: time ({plant.map.time.column}): does not advance in most rows; the map must name the column "
            "that counts up"
        )
    period = _period(time, same_run, np.concatenate([inputs, outputs], axis=1))
    if period > MAX_PERIOD:
        raise GapInputError(
            f"{source}: time ({plant.map.time.column}): sampled every {period:.3g} s, slower than {MAX_PERIOD:g} s; is "
            "the unit of time right in the map?"
        )
    breaks = _breaks(time, segment, period, warnings)
    pieces, runs, position, lost = [], [], 0, 0
    for start, stop in zip([0, *breaks], [*breaks, len(time)], strict=True):
        piece = _resample(time[start:stop], inputs[start:stop], outputs[start:stop], period, auxiliary, start, plant)
        if piece is None:
            continue
        pieces.append(piece)
        lost += piece[5]
        setup = 0 if recording.setup is None else int(recording.setup[keep][start])
        label = float(segment[start])
        runs.append(Run(position, position + len(piece[0]), label, setup, recording.called.get(label, "")))
        position += len(piece[0])
    if lost:
        warnings.append(
            f"time: {lost} rows ({100.0 * lost / position:.2g} %) of a steady clock are missing; what the robot was "
            "told in them is interpolated (`hold: zero` at an input keeps the last)"
        )
    usable = sum((r.stop - r.start) * period for r in runs)
    if usable < shortest:
        raise GapInputError(
            f"{source}: holds {usable:.2f} s of usable data; at least {shortest:g} s are needed to fit on one part and "
            "score on another: record longer"
        )
    grid_time, grid_inputs, grid_outputs, valid = (np.concatenate([p[i] for p in pieces]) for i in range(4))
    grid_aux = {k: np.concatenate([p[4][k] for p in pieces]) for k in auxiliary}
    for channel, taken in zip(plant.outputs, valid.T, strict=True):
        if (share := _missing(taken)) > 0.01:
            warnings.append(f"output {channel.name}: {100 * share:.1f} % of the samples are missing")
    enabled = grid_aux.pop(_ENABLED, np.ones(len(grid_time))) > 0.5
    live = _live(grid_outputs, valid, plant, warnings) if moving else np.asarray((valid > 0).any(axis=0))
    if not live.any():
        raise GapInputError(
            f"{source}: outputs: no output ever changes; there is nothing to compare: move each joint, and see that it "
            "is measured"
        )
    return Aligned(
        period,
        grid_time,
        grid_inputs,
        grid_outputs,
        valid.astype(bool),
        tuple(runs),
        live,
        recording.held_out,
        grid_aux,
        warnings,
        np.array(
            [o.resolution or lattice_step(y[np.isfinite(y)]) for o, y in zip(plant.outputs, outputs.T, strict=True)]
        ),
        enabled,
        source,
    )


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


def _as_sampled(time: Array, segment: Array, outputs: Array, warnings: list[str]) -> Array:
    """The rows' times (n,), of each run by its own clock."""
    edges = [0, *(np.flatnonzero(np.diff(segment)) + 1).tolist(), len(time)]
    pieces = [sample_times(time[a:b], outputs[a:b]) for a, b in pairwise(edges)]
    worst = max((scatter for _, scatter in pieces), default=0.0)
    if worst > 0.0:
        warnings.append(
            f"time: stamps scatter by {1e3 * worst:.2g} ms about a steady clock, by which the robot moves smoothly; "
            "rows are taken for ticks of that clock"
        )
    return np.concatenate([times for times, _ in pieces]) if pieces else time


def _leave_out_glitches(outputs: Array, plant: Plant, warnings: list[str]) -> None:
    """Make NaN of them, in place."""
    for channel, values in zip(plant.outputs, outputs.T, strict=True):
        if channel.quantity in QUANTITIES and (alone := glitches(values)).any():
            values[alone] = np.nan
            warnings.append(
                f"output {channel.name}: {int(alone.sum())} samples ({100.0 * float(alone.mean()):.2g} %) stand alone, "
                "far from those before and after; left out as glitches of the sensor"
            )


def _period(time: Array, same_run: NDArray[np.bool_], values: Array) -> float:
    """[s] between two samples of the channel (n, nc) that is sampled most often: topics of a bag have stamps of their
    own, and lie close to each other.
    """
    periods = []
    run = np.concatenate([[0], np.cumsum(~same_run)])
    for column in values.T:
        rows = np.flatnonzero(np.isfinite(column))
        steps = np.diff(time[rows])
        steps = steps[(steps > 0) & (run[rows][1:] == run[rows][:-1])]
        if len(steps):
            periods.append(_usual_step(steps))
    return min(periods, default=float(np.median(np.diff(time))))


def _usual_step(steps: Array) -> float:
    """The median of the steps [s], to more digits where they are multiples of one but for what scatters little.

    Stamps since 1970 are told to 0.2 us: the median of their steps is off by so much, which adds up over a recording.
    """
    usual = float(np.median(steps))
    times = np.round(steps / usual)
    near = (times >= 1.0) & (times < _JUMP_PERIODS)
    mean = float(steps[near].sum() / times[near].sum())
    return mean if _EXACT * usual < abs(mean - usual) < _SAME_PERIOD * usual else usual


def _missing(valid: NDArray[np.bool_]) -> float:
    """Share of the samples that lack of a channel that is recorded in every so many rows (n,)."""
    rows = np.flatnonzero(valid)
    every = float(np.median(np.diff(rows))) if len(rows) > 1 else 1.0
    return 1.0 - every * float(np.mean(valid))


def _breaks(time: Array, segment: Array, period: float, warnings: list[str]) -> list[int]:
    """Rows at which a new run starts."""
    steps = np.diff(time)
    new_segment = segment[1:] != segment[:-1]
    jump = ((steps > _JUMP_PERIODS * period) | (steps < -0.5 * period)) & ~new_segment
    if jump.any():
        worst = int(np.argmax(np.where(jump, np.abs(steps), 0.0)))
        warnings.append(
            f"time jumps {int(jump.sum())} times (by {steps[worst]:+.3g} s at row {worst + 1}); "
            "the recording is split there"
        )
    return [int(i) + 1 for i in np.flatnonzero(new_segment | jump)]


def _resample(
    time: Array,
    inputs: Array,
    outputs: Array,
    period: float,
    auxiliary: dict[str, Array],
    start: int,
    plant: Plant,
) -> tuple[Array, Array, Array, Array, dict[str, Array], int] | None:
    """One run on its uniform grid, and how many rows it has lost; None where it is too short to hold a window."""
    stop = start + len(time)
    if len(time) < 20 or time[-1] - time[0] < 20 * period:
        return None
    grid = time[0] + period * np.arange(int((time[-1] - time[0]) / period + 1e-6) + 1)
    new_inputs = np.empty((len(grid), inputs.shape[1]))
    lost = _lost(time, grid, period)
    for i, (channel, row) in enumerate(zip(plant.inputs, plant.map.inputs, strict=True)):
        stamps, values = _sampled(time, inputs[:, i], period)
        if not len(stamps):
            return None
        between = np.interp(grid, stamps, values)
        new_inputs[:, i] = between if channel.linear else _hold(grid, stamps, values, period)
        if row.hold is None and len(stamps) > _EVERY_ROW * len(time):
            new_inputs[lost, i] = between[lost]
    new_outputs, valid = np.zeros((len(grid), outputs.shape[1])), np.zeros((len(grid), outputs.shape[1]))
    for i, output in enumerate(plant.outputs):
        stamps, values = _sampled(time, outputs[:, i], period)
        if not len(stamps):
            continue
        hinge = output.qpos >= 0 and output.quantity == "angle"
        if output.wrapped or (hinge and np.abs(np.diff(values)).max(initial=0.0) > 1.5 * np.pi):
            values = np.unwrap(values)
        new_outputs[:, i] = np.interp(grid, stamps, values)
        # A channel may be slower than the table: what counts as a hole is judged by its own period.
        own = max(period, float(np.median(np.diff(stamps)))) if len(stamps) > 1 else period
        after = np.clip(np.searchsorted(stamps, grid), 1, max(len(stamps) - 1, 1))
        gap = stamps[np.minimum(after, len(stamps) - 1)] - stamps[after - 1]
        on_sample = np.abs(stamps[np.minimum(after, len(stamps) - 1)] - grid) < 0.5 * period
        on_sample |= np.abs(stamps[after - 1] - grid) < 0.5 * period
        inside = (grid >= stamps[0] - 0.5 * period) & (grid <= stamps[-1] + 0.5 * period)
        valid[:, i] = inside & on_sample & ((gap <= HOLE_PERIODS * own) | on_sample)
    aux = {}
    for name, column in auxiliary.items():
        stamps, values = _sampled(time, column[start:stop], period)
        if name == _ENABLED:
            aux[name] = _hold(grid, stamps, values, period) if len(stamps) else np.ones(len(grid))
        elif not len(stamps):
            aux[name] = np.full(len(grid), np.nan)
        else:
            aux[name] = np.interp(grid, stamps, values)
    return grid, new_inputs, new_outputs, valid, aux, int(lost.sum())


def _lost(time: Array, grid: Array, period: float) -> NDArray[np.bool_]:
    """Which points of the grid are ticks of a steady clock whose rows the log has lost.

    The robot was told something then. Where rows come late instead, and not on the next tick, it was told nothing.
    """
    steps = np.diff(time) / period
    longer = steps[steps > 1.5]
    on_tick = np.abs(longer - np.round(longer)) < _ON_TICK
    if not len(longer) or on_tick.mean() < _EVERY_ROW:
        return np.zeros(len(grid), dtype=bool)
    last = np.maximum(np.searchsorted(time, grid + 1e-3 * period, side="right") - 1, 0)
    lost: NDArray[np.bool_] = grid - time[last] > 0.5 * period
    return lost


def _sampled(time: Array, values: Array, period: float) -> tuple[Array, Array]:
    """(stamps, values) of a channel's samples (n,), without those whose time does not advance."""
    ok = np.isfinite(values)
    time, values = time[ok], values[ok]
    advances = np.diff(np.maximum.accumulate(time), prepend=-np.inf) > 0.01 * period
    return time[advances], values[advances]


def _hold(grid: Array, stamps: Array, values: Array, period: float) -> Array:
    """Each value until the next one, on the grid."""
    held: Array = values[np.maximum(np.searchsorted(stamps, grid + 1e-3 * period, side="right") - 1, 0)]
    return held


def _live(outputs: Array, valid: Array, plant: Plant, warnings: list[str]) -> NDArray[np.bool_]:
    live = np.zeros(len(plant.outputs), bool)
    for i, channel in enumerate(plant.outputs):
        values = outputs[valid[:, i] > 0, i]
        live[i] = len(values) > 10 and float(np.ptp(values)) > 0.0
        if live[i]:
            longest = _longest_constant(values)
            if longest > 0.5 * len(values) and longest > 200:
                live[i] = False
                warnings.append(
                    f"output {channel.name}: stands still for {100 * longest / len(values):.0f} % of the recording; "
                    "taken for a dead channel and not scored"
                )
        else:
            warnings.append(f"output {channel.name}: never changes; taken for a dead channel and not scored")
    return live


def _longest_constant(values: Array) -> int:
    changes = np.flatnonzero(np.diff(values) != 0.0)
    edges = np.concatenate([[-1], changes, [len(values) - 1]])
    return int(np.diff(edges).max())
