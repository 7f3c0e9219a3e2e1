"""From raw rows to a uniform grid: time checks, runs, dropped samples, wrapped angles, dead channels."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from simgap.data.errors import GapInputError
from simgap.data.glitches import QUANTITIES, glitches
from simgap.data.hangs import hangs
from simgap.data.lattice import lattice_step
from simgap.data.plant import Plant
from simgap.data.recording import Recording

Array = NDArray[np.float64]

MIN_DURATION = 4.0
"""[s] Less than this gives too few blocks to keep some of them for scoring."""
MAX_PERIOD = 0.1
"""[s] A robot's log that is slower says nothing about its dynamics."""
_ENABLED = ""
"""Stands for the map's `enabled` among the auxiliary columns while they are resampled."""
_JUMP_PERIODS = 10.0
"""A step of time longer than this many periods ends a run."""
HOLE_PERIODS = 2.5
"""Outputs are not interpolated over holes longer than this many periods; such samples are not scored."""


@dataclass(frozen=True)
class Run:
    """Rows [start, stop) of the grid that follow each other without a gap; ``setup`` is one of `Plant.setups`."""

    start: int
    stop: int
    label: float
    setup: int = 0


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
    _leave_out_hangs(outputs, plant, warnings)
    _leave_out_glitches(outputs, plant, warnings)
    if len(time) < 10:
        raise GapInputError(f"{source}: time: {len(time)} rows have a time and a run; record at least {shortest:g} s")
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
    pieces, runs, position = [], [], 0
    for start, stop in zip([0, *breaks], [*breaks, len(time)], strict=True):
        piece = _resample(time[start:stop], inputs[start:stop], outputs[start:stop], period, auxiliary, start, plant)
        if piece is None:
            continue
        pieces.append(piece)
        setup = 0 if recording.setup is None else int(recording.setup[keep][start])
        runs.append(Run(position, position + len(piece[0]), float(segment[start]), setup))
        position += len(piece[0])
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


def _leave_out_hangs(outputs: Array, plant: Plant, warnings: list[str]) -> None:
    """Make NaN of what a hanging sensor repeats, in place."""
    hung = hangs(outputs)
    outputs[hung] = np.nan
    for channel, repeated in zip(plant.outputs, hung.T, strict=True):
        if repeated.any():
            warnings.append(
                f"output {channel.name}: {int(repeated.sum())} samples ({100.0 * float(repeated.mean()):.2g} %) repeat "
                "the one before while the robot moves; left out, as of a sensor that hangs"
            )


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
            periods.append(float(np.median(steps)))
    return min(periods, default=float(np.median(np.diff(time))))


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
) -> tuple[Array, Array, Array, Array, dict[str, Array]] | None:
    """One run on its uniform grid, or None where it is too short to hold a window."""
    stop = start + len(time)
    if len(time) < 20 or time[-1] - time[0] < 20 * period:
        return None
    grid = time[0] + period * np.arange(int((time[-1] - time[0]) / period + 1e-6) + 1)
    new_inputs = np.empty((len(grid), inputs.shape[1]))
    for i, channel in enumerate(plant.inputs):
        stamps, values = _sampled(time, inputs[:, i], period)
        if not len(stamps):
            return None
        new_inputs[:, i] = np.interp(grid, stamps, values) if channel.linear else _hold(grid, stamps, values, period)
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
    return grid, new_inputs, new_outputs, valid, aux


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
