"""A recording: named input and output channels over time, and the tables (CSV, NPZ, Parquet) that it is read from."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from simgap.data.errors import GapInputError, nearest
from simgap.data.plant import Plant
from simgap.data.units import factor

Array = NDArray[np.float64]


@dataclass
class Recording:
    """Raw channels of one recording, in SI, as they were sampled.

    Attributes:
        time: [s], (n,), as recorded: it may have gaps, repeats and jumps (align.py deals with them).
        inputs: (n, ni) in the units of the control (or the joint force) they drive; NaN where not sampled.
        outputs: (n, no) in SI; NaN where not sampled.
        segment: (n,) the number of the run that a row belongs to.
        held_out: numbers of the runs that are kept for scoring, empty where blocks are to be chosen.
        auxiliary: further columns, in the unit of the map.
    """

    time: Array
    inputs: Array
    outputs: Array
    segment: Array
    held_out: tuple[float, ...] = ()
    auxiliary: dict[str, Array] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)


def load_table(path: str | Path) -> dict[str, Array]:
    """Read a CSV, NPZ or Parquet file into columns of float64; an empty cell becomes NaN.

    Raises:
        GapInputError: missing, unreadable, of another type, or a column that holds no numbers.
    """
    path = Path(path)
    if not path.is_file():
        raise GapInputError(f"{path}: no such recording")
    try:
        match path.suffix.lower():
            case ".csv" | ".parquet" as kind:
                return _check_columns(_read_arrow(path, kind), path)
            case ".npz":
                with np.load(path, allow_pickle=False) as archive:
                    return _check_columns({name: np.asarray(archive[name]) for name in archive.files}, path)
            case other:
                raise GapInputError(f"{path}: a table is .csv, .npz or .parquet, not {other or 'without extension'}")
    except (OSError, ValueError) as error:
        if isinstance(error, GapInputError):
            raise
        raise GapInputError(f"{path}: cannot read the table ({' '.join(str(error).split())[:200]})") from error


def _read_arrow(path: Path, kind: str) -> dict[str, NDArray[np.generic]]:
    # Imported here: a machine that only reads NPZ needs no Arrow.
    import pyarrow.csv
    import pyarrow.parquet

    try:
        table = pyarrow.csv.read_csv(path) if kind == ".csv" else pyarrow.parquet.read_table(path)
    except pyarrow.ArrowException as error:
        raise ValueError(str(error)) from error
    return {n: table.column(n).to_numpy(zero_copy_only=False) for n in table.column_names}


def _check_columns(columns: dict[str, NDArray[np.generic]], path: Path) -> dict[str, Array]:
    checked: dict[str, Array] = {}
    for name, values in columns.items():
        if values.ndim != 1:
            raise GapInputError(f"{path}: column {name!r} has {values.ndim} dimensions, must have one")
        if values.dtype.kind in "biuf":
            checked[name.strip()] = values.astype(np.float64)
    lengths = {len(v) for v in checked.values()}
    if not lengths or lengths == {0}:
        raise GapInputError(f"{path}: the table holds no numbers")
    if len(lengths) > 1:
        raise GapInputError(f"{path}: the columns differ in length ({', '.join(map(str, sorted(lengths)))} rows)")
    return checked


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

    seconds, _ = factor(mapping.time.unit, ("time",), f"{mapping.source}: time ({mapping.time.column})")
    time = seconds * column(mapping.time.column, "time")
    inputs = [channel.scale * column(channel.column, f"inputs[{i}]") for i, channel in enumerate(plant.inputs)]
    outputs = [channel.scale * column(channel.column, f"outputs[{i}]") for i, channel in enumerate(plant.outputs)]
    segment = np.zeros_like(time)
    held_out: tuple[float, ...] = ()
    if mapping.segments is not None:
        segment = column(mapping.segments.column, "segments")
        held_out = mapping.segments.held_out
        missing = [h for h in held_out if h not in set(segment.tolist())]
        if missing:
            raise GapInputError(f"{source}: segments.held_out: the recording has no run {missing[0]:g}")
    auxiliary = {row.column: column(row.column, f"auxiliary[{i}]") for i, row in enumerate(mapping.auxiliary)}
    return Recording(time, np.stack(inputs, 1), np.stack(outputs, 1), segment, held_out, auxiliary)


def concatenate(recordings: list[Recording]) -> Recording:
    """Several recordings of one robot as one; each keeps its runs apart."""
    if len(recordings) == 1:
        return recordings[0]
    offset, segments, held_out = 0.0, [], []
    for r in recordings:
        segments.append(r.segment - np.nanmin(r.segment) + offset)
        held_out += [h - float(np.nanmin(r.segment)) + offset for h in r.held_out]
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
    )
