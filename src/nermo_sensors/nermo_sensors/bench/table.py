"""A bench recording: the true force beside the two voltages, read from a table and checked."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

Array = NDArray[np.float64]

BENCH_CELLS = ("piezoresistive", "piezoelectric")
"""What the bench measures: C's two cells."""
COLUMNS = ("time_s", "force_n", "piezoresistive_v", "piezoelectric_v")
"""Columns that a table must have."""
OPTIONAL = "frequency_hz"
"""Frequency of the cam; without it, laws that need it cannot be identified."""


class RecordingError(ValueError):
    """A recording that cannot be used; the message names file and column."""


@dataclass(frozen=True, slots=True)
class BenchRecording:
    """One run; all arrays have shape (n,)."""

    time: Array
    """[s], rising."""
    force: Array
    """[N], of the bench's own force sensor."""
    piezoresistive: Array
    """[V]"""
    piezoelectric: Array
    """[V]"""
    frequency: Array
    """Of the load [rad/s]; NaN where unknown."""

    def __post_init__(self) -> None:
        _check({name: getattr(self, name) for name in self.__slots__}, "recording")

    @property
    def period(self) -> float:
        """Time between samples [s]."""
        return float(np.median(np.diff(self.time)))

    @property
    def readings(self) -> Array:
        """(n, 2), one column of each of BENCH_CELLS [V]."""
        return np.stack([self.piezoresistive, self.piezoelectric], axis=1)

    def part(self, rows: NDArray[np.bool_] | slice) -> BenchRecording:
        """Some of the rows."""
        return BenchRecording(*(getattr(self, name)[rows] for name in self.__slots__))

    def save(self, path: Path) -> None:
        """Writes .csv."""
        pd.DataFrame(
            dict(
                zip(
                    (*COLUMNS, OPTIONAL),
                    (self.time, self.force, self.piezoresistive, self.piezoelectric, self.frequency / (2.0 * np.pi)),
                    strict=True,
                )
            )
        ).to_csv(path, index=False)

    @classmethod
    def load(cls, path: Path) -> BenchRecording:
        """Reads .csv, .parquet or .npz with the columns of COLUMNS. Raises RecordingError."""
        try:
            if path.suffix == ".npz":
                with np.load(path) as file:
                    table = pd.DataFrame({name: file[name] for name in file.files})
            else:
                table = pd.read_parquet(path) if path.suffix == ".parquet" else pd.read_csv(path)
        except (OSError, ValueError) as error:
            raise RecordingError(f"{path}: cannot be read: {' '.join(str(error).split())}") from error
        missing = [name for name in COLUMNS if name not in table]
        if missing:
            there = ", ".join(map(str, table.columns)) or "none"
            raise RecordingError(f"{path}: column {', '.join(missing)} is missing; there are: {there}")
        try:
            columns = {name: table[name].to_numpy(dtype=np.float64) for name in COLUMNS}
            frequency = table[OPTIONAL].to_numpy(dtype=np.float64) if OPTIONAL in table else np.full(len(table), np.nan)
        except ValueError as error:
            raise RecordingError(f"{path}: holds something that is no number: {error}") from error
        _check(columns, str(path))
        time, force, piezoresistive, piezoelectric = columns.values()
        return cls(time, force, piezoresistive, piezoelectric, 2.0 * np.pi * frequency)


def _check(columns: dict[str, Array], source: str) -> None:
    time = next(iter(columns.values()))
    if len(time) < 10:
        raise RecordingError(f"{source}: has {len(time)} rows; at least 10 are needed")
    for name, values in columns.items():
        if len(values) != len(time):
            raise RecordingError(f"{source}: column {name} has {len(values)} rows, {len(time)} expected")
        bad = np.flatnonzero(~np.isfinite(values))
        if len(bad) and name not in ("frequency", OPTIONAL):
            raise RecordingError(f"{source}: column {name}, row {bad[0] + 1}: {values[bad[0]]} is not a finite number")
    back = np.flatnonzero(np.diff(time) <= 0.0)
    if len(back):
        row = int(back[0])
        raise RecordingError(
            f"{source}: time does not rise at row {row + 2}: {time[row + 1]} s comes after {time[row]} s"
        )
