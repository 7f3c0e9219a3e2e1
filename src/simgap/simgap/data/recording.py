"""A recording: named input and output channels over time, whatever file it is read from."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from simgap.data.bag import is_bag, read_bag
from simgap.data.errors import GapInputError, nearest
from simgap.data.formats import BAGS, listed
from simgap.data.plant import Plant
from simgap.data.setup import said
from simgap.data.tables import load_table, numbered
from simgap.data.units import factor

__all__ = ["Recording", "concatenate", "load_recording", "load_table", "recording_from_table"]

Array = NDArray[np.float64]


@dataclass
class Recording:
    """Raw channels of one recording, in SI, as they were sampled.

    Attributes:
        time: [s], (n,), as recorded: it may have gaps, repeats and jumps (align.py deals with them).
        inputs: (n, ni) in the units of the control (or the joint force) they drive; NaN where not sampled.
        outputs: (n, no) in SI; NaN where not sampled.
        segment: (n,) the number of the run that a row belongs to.
        called: what runs are called, by number; of others the number is the name.
        held_out: numbers of the runs that are kept for scoring, empty where blocks are to be chosen.
        auxiliary: further columns, in the unit of the map.
        enabled: (n,) 1 where the servos give torque and 0 where they do not, NaN where not sampled; None where the map
            names no such column.
        setup: (n,) number of the setup (`Plant.setups`) of a row's run; None where all are as modelled.
        source: the file or files that it was read from, for messages.
    """

    time: Array
    inputs: Array
    outputs: Array
    segment: Array
    held_out: tuple[float, ...] = ()
    auxiliary: dict[str, Array] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    enabled: Array | None = None
    setup: Array | None = None
    source: str = "recording"
    called: dict[float, str] = field(default_factory=dict)


def load_recording(path: str | Path, plant: Plant) -> Recording:
    """Read what the plant's map names from a table, a LeRobot dataset, or a bag of ROS.

    Raises:
        GapInputError: the file cannot be read, or lacks something that the map names.
    """
    path = Path(path)
    if is_bag(path):
        columns, warnings = read_bag(path, plant.map)
        recording = recording_from_table(columns, plant, str(path))
        recording.warnings += warnings
        return recording
    if plant.map.of_bag:
        raise GapInputError(f"{plant.map.source}: its rows name topics of a bag, but {path} is no bag ({listed(BAGS)})")
    runs = plant.map.segments
    table = load_table(path, lambda name: runs is not None and name == runs.column)
    return recording_from_table(table, plant, str(path))


def recording_from_table(columns: dict[str, Array], plant: Plant, source: str = "recording") -> Recording:
    """Pick the columns that the plant's map names and convert them to SI.

    Raises:
        GapInputError: a column that the table lacks (with the nearest names), or holds no numbers at all.
    """
    mapping = plant.map

    def column(name: str, where: str) -> Array:
        if name not in columns:
            raise GapInputError(
                f"{source}: {where}: no numeric column {name!r} in the table; {nearest(name, columns, 'column')}"
            )
        values = columns[name]
        if not np.isfinite(values).any():
            raise GapInputError(f"{source}: {where}: column {name!r} holds no finite number")
        return np.where(np.isfinite(values), values, np.nan)

    where = f"{mapping.source}: time ({mapping.time.column})"
    seconds = 1.0 if mapping.of_bag else factor(mapping.time.unit, ("time",), where)[0]
    time = seconds * column(mapping.time.column, "time")
    inputs = [channel.scale * column(channel.column, f"inputs[{i}]") for i, channel in enumerate(plant.inputs)]
    outputs = [channel.scale * column(channel.column, f"outputs[{i}]") for i, channel in enumerate(plant.outputs)]
    segment, called = np.zeros_like(time), dict[float, str]()
    if mapping.segments is not None:
        named = columns.get(mapping.segments.column)
        if named is not None and named.dtype.kind == "U":
            numbers, called = numbered(named)
            columns = columns | {mapping.segments.column: numbers}
        segment = column(mapping.segments.column, "segments")
    known, there = {name: number for number, name in called.items()}, set(segment[np.isfinite(segment)].tolist())
    wanted = () if mapping.segments is None else mapping.segments.held_out
    held_out = tuple(_number(label, known) for label in wanted)
    for label, number in zip(wanted, held_out, strict=True):
        if number not in there:
            have = nearest(said(label), [called.get(n, f"{n:g}") for n in sorted(there)], "run")
            raise GapInputError(f"{source}: segments.held_out: the recording has no run {said(label)}; {have}")
    setup_of = {_number(label, known): setup for label, setup in plant.setup_of.items()}
    setup = np.array([setup_of.get(label, 0) for label in segment.tolist()], float) if setup_of else None
    unknown = [label for label in plant.setup_of if _number(label, known) not in there]
    warned = [f"{source}: segments.runs: the recording has no run {said(label)}" for label in unknown]
    auxiliary = {row.column: column(row.column, f"auxiliary[{i}]") for i, row in enumerate(mapping.auxiliary)}
    enabled = None
    if mapping.enabled is not None:
        enabled = column(mapping.enabled.column, "enabled")
        odd = enabled[np.isfinite(enabled) & (enabled != 0.0) & (enabled != 1.0)]
        if len(odd):
            raise GapInputError(
                f"{source}: enabled: column {mapping.enabled.column!r} holds {odd[0]:g}; "
                "it must be true or false, or 1 or 0"
            )
        if not (enabled == 1.0).any():
            raise GapInputError(
                f"{source}: enabled: column {mapping.enabled.column!r} is never 1: the servos gave no torque all along"
            )
    told, seen = np.stack(inputs, 1), np.stack(outputs, 1)
    return Recording(time, told, seen, segment, held_out, auxiliary, warned, enabled, setup, source, called)


def concatenate(recordings: list[Recording]) -> Recording:
    """Several recordings of one robot as one; each keeps its runs apart, which are called by their files."""
    if len(recordings) == 1:
        return recordings[0]
    offset, segments, held_out = 0.0, [], []
    called: dict[float, str] = {}
    for r, file in zip(recordings, _files([r.source for r in recordings]), strict=True):
        shift = offset - float(np.nanmin(r.segment))
        segments.append(r.segment + shift)
        held_out += [h + shift for h in r.held_out]
        numbers = np.unique(r.segment[np.isfinite(r.segment)]).tolist()
        for n in numbers:
            called[n + shift] = f"{file}: {r.called.get(n, f'{n:g}')}" if len(numbers) > 1 else file
        offset = float(np.nanmax(segments[-1])) + 1.0
    keys = set.intersection(*(set(r.auxiliary) for r in recordings))
    return Recording(
        np.concatenate([r.time for r in recordings]),
        np.concatenate([r.inputs for r in recordings]),
        np.concatenate([r.outputs for r in recordings]),
        np.concatenate(segments),
        tuple(held_out),
        {k: np.concatenate([r.auxiliary[k] for r in recordings]) for k in sorted(keys)},
        [w for r in recordings for w in r.warnings],
        None
        if all(r.enabled is None for r in recordings)
        else np.concatenate([np.ones(len(r.time)) if r.enabled is None else r.enabled for r in recordings]),
        None
        if all(r.setup is None for r in recordings)
        else np.concatenate([np.zeros(len(r.time)) if r.setup is None else r.setup for r in recordings]),
        ", ".join(r.source for r in recordings),
        called,
    )


def _files(sources: list[str]) -> list[str]:
    """Names of files, as short as tells them apart."""
    short = [Path(s).stem for s in sources]
    names = short if len(set(short)) == len(short) else sources
    return [n if names.index(n) == i else f"{n} ({names[:i].count(n) + 1})" for i, n in enumerate(names)]


def _number(label: float | str, known: dict[str, float]) -> float:
    """The number of a run that a map names; NaN of one that there is not."""
    if known:
        return known.get(said(label), float("nan"))
    try:
        return float(label)
    except ValueError:
        return float("nan")
