"""What the words of the `nermo` command share: tables, facts and progress on the terminal."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

# Files and pipes have no width; the tables need one.
console = Console(markup=False, width=None if sys.stdout.isatty() else 180)


@contextlib.contextmanager
def progress(what: str) -> Iterator[Callable[[int, int], None]]:
    """A progress bar on a terminal, a line for each finished tenth elsewhere."""
    if not console.is_terminal:
        yield (
            lambda done, total: console.print(f"{what}: {done} of {total}") if done % max(1, total // 10) == 0 else None
        )
        return
    columns = (TextColumn(what), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console) as bar:
        task = bar.add_task(what, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


class Counter:
    """Counts steps that are done one by one, beyond what was expected too."""

    def __init__(self, report: Callable[[int, int], None], expected: int) -> None:
        self._report, self.expected = report, expected
        self.done = 0

    def advance(self) -> None:
        """One more is done."""
        self.done += 1
        self._report(self.done, max(self.done, self.expected))

    def plan(self, more: int) -> None:
        """So many are to come."""
        self.expected = self.done + more


@contextlib.contextmanager
def counting(what: str, expected: int = 0) -> Iterator[Counter]:
    """`progress` of steps that are done one by one."""
    with progress(what) as report:
        yield Counter(report, expected)


def print_rows(title: str, rows: list[dict[str, Any]], columns: Sequence[str]) -> None:
    """Some columns of rows as a table."""
    table = Table(title=title)
    for name in columns:
        table.add_column(name.replace("_", " "), justify="left" if isinstance(rows[0][name], str) else "right")
    for row in rows:
        table.add_row(*(cell(row[name]) for name in columns))
    console.print(table)


def print_facts(title: str, facts: dict[str, Any], indent: str = "  ") -> None:
    """Facts by name, a line each."""
    console.print(title, style="bold", highlight=False)
    for name, value in facts.items():
        if isinstance(value, list) and value and isinstance(value[0], dict):
            print_rows(name, value, list(value[0]))
        elif isinstance(value, dict):
            inner = ", ".join(f"{key} {cell(item)}" for key, item in value.items())
            console.print(f"{indent}{name}: {inner}", highlight=False)
        else:
            console.print(f"{indent}{name}: {cell(value)}", highlight=False)


def cell(value: Any) -> str:
    """A value as a table shows it."""
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, list | tuple):
        return " ".join(map(cell, value))
    if isinstance(value, dict):
        return ", ".join(f"{key} {cell(item)}" for key, item in value.items())
    return f"{value:.4g}" if isinstance(value, float) else str(value)
