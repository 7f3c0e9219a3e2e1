"""What the commands of this package share: their options, and tables, facts and progress on the terminal."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

Robot = Annotated[str, typer.Option(help="Name of a robot, or path of its parameter file.")]
Json = Annotated[Path | None, typer.Option("--json", help="Write the results to this file.")]
HELP = {"help_option_names": ["-h", "--help"]}

# Files and pipes have no width; the tables need one.
console = Console(markup=False, width=None if sys.stdout.isatty() else 160)


def say(what: str) -> None:
    """A line beside the results."""
    print(what, file=sys.stderr, flush=True)


@contextlib.contextmanager
def progress() -> Iterator[Callable[[str, float], None]]:
    """A bar on a terminal, lines elsewhere; what is yielded takes what is done, and which share of it."""
    if console.is_terminal:
        with Progress(console=console, transient=True) as bar:
            task = bar.add_task("", total=1.0)
            yield lambda what, share: bar.update(task, description=what, completed=share)
        return
    told = ""

    def tell(what: str, share: float) -> None:
        nonlocal told
        line = f"{what}: {100 * share:.0f} %"
        if line != told and round(100 * share) % 10 == 0:
            told = line
            say(line)

    yield tell


def print_table(rows: Sequence[Mapping[str, Any]], title: str) -> None:
    """Rows with the same keys, which are the columns."""
    table = Table(title=title, title_justify="left")
    for key in rows[0]:
        table.add_column(key)
    for row in rows:
        table.add_row(*(_text(value) for value in row.values()))
    console.print(table)


def print_facts(facts: Mapping[str, Any], title: str) -> None:
    """Facts by name, a line each."""
    table = Table(title=title, title_justify="left", show_header=False, min_width=len(title))
    for key, value in facts.items():
        table.add_row(key, _text(value))
    console.print(table)


def _text(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{key} {_text(part)}" for key, part in value.items())
    if isinstance(value, list | tuple):
        return " ".join(_text(part) for part in value)
    return f"{value:.5g}" if isinstance(value, float) else str(value)
