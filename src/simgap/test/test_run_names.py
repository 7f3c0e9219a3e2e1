"""Runs that have names: words in a column, and the files that several recordings came in."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pyarrow
import pyarrow.parquet
import pytest
from robots import plant_of, simulate

from simgap.data.align import align
from simgap.data.errors import GapInputError
from simgap.data.plant import Plant
from simgap.data.recording import concatenate, load_recording
from simgap.preparation.guess import guess_map
from simgap.simulation.windows import cut

NAMES = ("chirp", "holding", "waypoints")


def _plant(**segments: object) -> Plant:
    return plant_of("arm", lambda data: data.update(segments={"column": "motion", **segments}))


def _columns() -> dict[str, list[object]]:
    tables = [simulate("arm", 4.0, seed) for seed in range(len(NAMES))]
    joined = {k: np.concatenate([t[k] for t in tables]).tolist() for k in tables[0]}
    return joined | {"motion": [name for name, t in zip(NAMES, tables, strict=True) for _ in t["t"]]}


def _written(path: Path, columns: dict[str, list[object]]) -> Path:
    if path.suffix == ".parquet":
        pyarrow.parquet.write_table(pyarrow.table(columns), path)
    else:
        with path.open("w", newline="", encoding="utf-8") as file:
            csv.writer(file).writerows([list(columns), *zip(*columns.values(), strict=True)])
    return path


@pytest.mark.parametrize("ending", [".csv", ".parquet"])
def test_runs_are_called_by_the_words_of_their_column(tmp_path: Path, ending: str) -> None:
    plant = _plant(held_out=["holding"], runs={"waypoints": {"supply": 11.0}}, supply=12.0)
    aligned = align(load_recording(_written(tmp_path / f"log{ending}", _columns()), plant), plant)
    assert [run.name for run in aligned.runs] == list(NAMES)
    assert [run.setup for run in aligned.runs] == [0, 0, 1]
    windows = cut(aligned)
    held = windows.start[windows.fold == 0]
    assert len(held) and all(aligned.runs[1].start <= start < aligned.runs[1].stop for start in held)


def test_rows_of_a_run_without_a_name_belong_to_none(tmp_path: Path) -> None:
    columns = _columns()
    columns["motion"] = [None if name == "holding" else name for name in columns["motion"]]
    plant = _plant()
    aligned = align(load_recording(_written(tmp_path / "log.parquet", columns), plant), plant)
    assert [run.name for run in aligned.runs] == ["chirp", "waypoints"]


def test_a_run_that_is_not_there_is_told_with_those_that_are(tmp_path: Path) -> None:
    path = _written(tmp_path / "log.csv", _columns())
    with pytest.raises(GapInputError, match=r"held_out: the recording has no run holdin; did you mean holding"):
        load_recording(path, _plant(held_out=["holdin"]))
    with pytest.raises(GapInputError, match=r"no run 7; valid runs: chirp, holding, waypoints"):
        load_recording(path, _plant(held_out=[7]))
    warned = load_recording(path, _plant(runs={"walk": {"supply": 11.0}})).warnings
    assert any("segments.runs: the recording has no run walk" in warning for warning in warned)


def test_several_files_are_called_by_their_names(tmp_path: Path) -> None:
    columns, plant = _columns(), _plant()
    whole = _written(tmp_path / "monday.csv", columns)
    rows = [i for i, name in enumerate(columns["motion"]) if name == "chirp"]
    part = _written(tmp_path / "tuesday.csv", {k: [v[i] for i in rows] for k, v in columns.items()})
    aligned = align(concatenate([load_recording(p, plant) for p in (whole, part)]), plant)
    assert [run.name for run in aligned.runs] == ["monday: chirp", "monday: holding", "monday: waypoints", "tuesday"]
    (tmp_path / "other").mkdir()
    again = _written(tmp_path / "other" / "monday.csv", {k: [v[i] for i in rows] for k, v in columns.items()})
    aligned = align(concatenate([load_recording(p, plant) for p in (part, again, part)]), plant)
    assert [run.name for run in aligned.runs] == [str(part), str(again), f"{part} (2)"]


@pytest.mark.parametrize("ending", [".csv", ".parquet"])
def test_a_guessed_map_has_the_column_of_words(tmp_path: Path, ending: str) -> None:
    columns = _columns()
    columns["episode"] = columns.pop("motion")
    path = _written(tmp_path / f"log{ending}", columns)
    plant = plant_of("arm")
    guessed = guess_map(path, plant.model)
    assert guessed.segments == {"column": "episode"}
    plant = plant_of("arm", lambda data: data.update(segments=guessed.segments))
    assert [run.name for run in align(load_recording(path, plant), plant).runs] == list(NAMES)


def test_numbers_stay_numbers(tmp_path: Path) -> None:
    columns = _columns()
    columns["motion"] = [float(NAMES.index(str(name))) for name in columns["motion"]]
    plant = _plant(held_out=["1"])
    aligned = align(load_recording(_written(tmp_path / "log.csv", columns), plant), plant)
    assert [run.name for run in aligned.runs] == ["0", "1", "2"] and aligned.held_out == (1.0,)
