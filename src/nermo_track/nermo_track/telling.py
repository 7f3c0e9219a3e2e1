"""How the commands of `nermo track` speak: bars, tables, files, and the sentence on what went wrong."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from nermo_description.results import CommandError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike


def check_seconds(option: str, value: float | None, most: float) -> None:
    """Raises CommandError for a time [s] that is below 0 or above ``most``."""
    if value is not None and not 0.0 <= value <= most:
        raise CommandError(f"{option}: is {value:g}; allowed: 0 to {most:g} s", status=2)


def save_table(out: Path, names: str, rows: ArrayLike) -> None:
    """Write rows (n, k) as a table with a header of ``names``. Raises CommandError where it cannot be written."""
    import numpy as np

    try:
        np.savetxt(out, rows, fmt="%.9g", delimiter=",", header=names, comments="")
    except OSError as error:
        raise CommandError(f"{out} cannot be written: {error.strerror}") from error


def print_rows(rows: list[dict[str, object]]) -> None:
    """A bench's rows as a table."""
    from rich.console import Console
    from rich.table import Table

    table = Table(*(name.replace("_", " ") for name in rows[0]))
    for row in rows:
        told = ("-" if value is None else value for value in row.values())
        table.add_row(*(f"{value:.3g}" if isinstance(value, float) else str(value) for value in told))
    console = Console(markup=False)
    Console(markup=False, width=None if console.is_terminal else 180).print(table)


@contextlib.contextmanager
def progress() -> Iterator[Callable[[str, float], None]]:
    """A bar for a stage's share of 1 on a terminal, nothing elsewhere."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description:>8}"), BarColumn(), TimeElapsedColumn())
    console = Console(markup=False, stderr=True)
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("", total=1.0)
        yield lambda stage, share: bar.update(task, description=stage, completed=share)


@contextlib.contextmanager
def told() -> Iterator[None]:
    """Input that cannot be used ends the command with its sentence and status 2."""
    from nermo_description.parameter_files import ParameterError
    from nermo_node.recording_reader import RecordingError
    from nermo_track.errors import TrackError

    try:
        yield
    except (TrackError, ParameterError, RecordingError) as error:
        raise CommandError(str(error), status=2) from error
