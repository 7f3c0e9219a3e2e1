"""Tables as recordings: CSV, NPZ and Parquet, and the folders of LeRobot that hold Parquet."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simgap.data.errors import GapInputError
from simgap.data.formats import BAGS, TABLES, listed, reader_of

Array = NDArray[np.float64]

_WORDS = {"": np.nan, "nan": np.nan, "true": 1.0, "false": 0.0}
"""Cells of a CSV that are numbers too."""
_NAMELESS = ("", "none", "nan")
_WHOLE = "is the file whole, and of the kind that its name says?"


def load_table(path: str | Path, text: Callable[[str], bool] = lambda name: False) -> dict[str, Array]:
    """Read a file that `TABLES` names, or a folder of LeRobot, into columns of float64; an empty cell becomes NaN.

    Columns of text are left out, but for those whose names ``text`` wants, which are kept as they are.

    A column of arrays becomes one column for each element, `action[0]`; of LeRobot's, whose `meta/info.json` names the
    elements, `action[elbow.pos]`.

    Raises:
        GapInputError: missing, unreadable, of another type, or nothing in it is a number.
    """
    path = Path(path)
    if path.is_dir():
        return _load_folder(path)
    if not path.is_file():
        raise GapInputError(f"{path}: no such recording")
    kind = path.suffix.lower()
    if kind not in TABLES:
        raise GapInputError(
            f"{path}: a recording is a table ({listed(TABLES)}) or a bag ({listed(BAGS)}), "
            f"not {kind or 'a file without extension'}"
        )
    try:
        names = _lerobot_names(path.parent) if kind == ".parquet" else None
        return _check_columns(reader_of(kind)(path), path, names, text)
    except (OSError, ValueError) as error:
        if isinstance(error, GapInputError):
            raise
        if isinstance(error, UnicodeDecodeError):
            wrong = error.object[error.start]
            raise GapInputError(
                f"{path}: holds a byte ({wrong:#x}) that is no UTF-8; save the table in UTF-8"
            ) from error
        reason = " ".join(str(error).split())[:200]
        if "pickle" in reason.lower():
            raise GapInputError(
                f"{path}: holds Python objects (a pickle), which are not read because they can run code; "
                "save plain arrays of numbers with numpy.savez"
            ) from error
        raise GapInputError(f"{path}: cannot read the table ({reason}); {_WHOLE}") from error
    except Exception as error:
        # What Python's zip reader raises on a damaged archive has no common base.
        raise GapInputError(f"{path}: cannot read the table ({type(error).__name__}: {error}); {_WHOLE}") from error


def _load_folder(path: Path) -> dict[str, Array]:
    """All tables of a LeRobot dataset, one after the other; its `episode_index` tells the runs apart."""
    files = sorted(path.glob("data/**/*.parquet")) if (path / "meta" / "info.json").is_file() else []
    if not files:
        raise GapInputError(
            f"{path}: is neither a bag (a folder with metadata.yaml) nor a LeRobot dataset (meta/info.json and data/)"
        )
    tables = [load_table(file) for file in files]
    shared = [name for name in tables[0] if all(name in t for t in tables)]
    return {name: np.concatenate([t[name] for t in tables]) for name in shared}


def _lerobot_names(folder: Path) -> dict[str, list[str]]:
    """Names of the elements of each feature, where the file belongs to a LeRobot dataset."""
    for above in (folder, *folder.absolute().parents):
        try:
            features = json.loads((above / "meta" / "info.json").read_text(encoding="utf-8"))["features"]
            return {name: names for name, f in features.items() if (names := _flat(f.get("names")))}
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            continue
    return {}


def _flat(names: Any) -> list[str]:
    """Names as a list; some versions write {"motors": [...]}."""
    if isinstance(names, dict):
        names = next((v for v in names.values() if isinstance(v, list)), list(names))
    return [str(n) for n in names] if isinstance(names, list) else []


def read_csv(path: Path) -> dict[str, NDArray[Any]]:
    """Columns of a CSV; its first row names them."""
    with path.open(newline="", encoding="utf-8-sig") as file:
        sample = file.read(4096)
        file.seek(0)
        rows = csv.reader(file, delimiter=delimiter(sample.split("\n", 1)[0]))
        header = [name.strip() for name in next(rows, [])]
        cells = [row for row in rows if row]
    if len(set(header)) < len(header):
        twice = next(name for name in header if header.count(name) > 1)
        raise GapInputError(f"{path}: the header names column {twice!r} twice")
    wrong = next((i for i, row in enumerate(cells) if len(row) != len(header)), None)
    if wrong is not None:
        raise GapInputError(
            f"{path}: row {wrong + 2} has {len(cells[wrong])} cells where the header has {len(header)}; "
            "was the file cut off while it was written?"
        )
    return {name: numbers([row[i] for row in cells], f"{path}: column {name!r}") for i, name in enumerate(header)}


def delimiter(header: str) -> str:
    """What stands between the cells of a CSV, from its first line."""
    return next((d for d in ",;\t" if d in header), ",")


def numbers(cells: list[str], where: str, first_row: int = 2) -> NDArray[Any]:
    """Cells as float64, or as they are where most are words.

    Raises:
        GapInputError: a cell is no number; ``first_row`` is the row of the file that the first one is in.
    """
    try:
        return np.array(cells, dtype=np.float64)
    except ValueError:
        values = [_number(cell) for cell in cells]
    wrong = [i for i, value in enumerate(values) if value is None]
    if len(wrong) > 0.5 * len(cells):
        return np.array(cells)
    if wrong:
        raise GapInputError(
            f"{where}: row {wrong[0] + first_row} holds {cells[wrong[0]]!r}, which is no number; "
            "leave the cell empty where nothing was measured"
        )
    return np.array(values, dtype=np.float64)


def numbered(values: NDArray[Any]) -> tuple[Array, dict[float, str]]:
    """Words (n,) as numbers in the order of their appearance, NaN where there is none, and what each number is."""
    words = [str(v).strip() for v in values.tolist()]
    order = [w for w in dict.fromkeys(words) if w.lower() not in _NAMELESS]
    number = {w: float(i) for i, w in enumerate(order)}
    return np.array([number.get(w, np.nan) for w in words]), {i: w for w, i in number.items()}


def _number(cell: str) -> float | None:
    word = cell.strip().lower()
    try:
        return _WORDS[word] if word in _WORDS else float(word)
    except ValueError:
        return None


def read_npz(path: Path) -> dict[str, NDArray[Any]]:
    """Arrays of an NPZ."""
    with np.load(path, allow_pickle=False) as archive:
        return {name: np.asarray(archive[name]) for name in archive.files}


def read_parquet(path: Path) -> dict[str, NDArray[Any]]:
    """Columns of a Parquet file."""
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError as error:
        raise GapInputError(f"{path}: Parquet needs one package more: pip install 'simgap[parquet]'") from error
    try:
        table = pyarrow.parquet.read_table(path, partitioning=None)
    except pyarrow.ArrowException as error:
        raise ValueError(str(error)) from error
    return {name: _parquet_column(table.column(name)) for name in table.column_names}


def _parquet_column(column: Any) -> NDArray[Any]:
    values = column.to_numpy(zero_copy_only=False)
    if values.dtype != object or not len(values):
        return np.asarray(values)
    if all(isinstance(v, bool | None) for v in values):
        return np.array([np.nan if v is None else float(v) for v in values])
    if all(isinstance(v, np.ndarray) for v in values) and len({v.shape for v in values}) == 1:
        return np.stack(values)
    return np.asarray(values)


def _check_columns(
    columns: dict[str, NDArray[Any]],
    path: Path,
    names: dict[str, list[str]] | None = None,
    text: Callable[[str], bool] = lambda name: False,
) -> dict[str, Array]:
    """Columns of numbers, and those of text that are wanted, each of one dimension.

    ``names`` are those of the elements of a column of arrays.
    """
    checked: dict[str, Array] = {}
    for name, values in columns.items():
        if values.dtype.kind not in "biuf":
            if values.ndim == 1 and text(name.strip()):
                checked[name.strip()] = values.astype(str)
            continue
        if values.ndim == 1:
            checked[name.strip()] = values.astype(np.float64)
        elif values.ndim == 2:
            said = (names or {}).get(name, [])
            elements: Iterable[object] = said if len(said) == values.shape[1] else range(values.shape[1])
            checked |= {f"{name}[{e}]": values[:, i].astype(np.float64) for i, e in enumerate(elements)}
        elif values.ndim == 0:
            continue
        else:
            raise GapInputError(f"{path}: column {name!r} has {values.ndim} dimensions, must have one or two")
    lengths = {len(v) for v in checked.values()}
    if not lengths or lengths == {0}:
        raise GapInputError(f"{path}: the table holds no numbers; below the names of its columns it needs rows of them")
    if len(lengths) > 1:
        raise GapInputError(f"{path}: the columns differ in length ({', '.join(map(str, sorted(lengths)))} rows)")
    return checked
