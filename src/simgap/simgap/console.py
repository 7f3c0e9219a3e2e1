"""What the commands share: progress, failure, and a diagnosis on the terminal and in files."""

from __future__ import annotations

import contextlib
import shlex
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NoReturn

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from simgap.analysis.diagnose import Diagnosis, write_experiment, write_report
from simgap.report.evidence import gather
from simgap.report.html import write_page
from simgap.report.sentences import free, left, limits


@contextlib.contextmanager
def progress(first: str) -> Iterator[Callable[[str, float], None]]:
    """A bar for a stage's share of 1 on a terminal, lines elsewhere."""
    console = Console(stderr=True)
    if console.is_terminal:
        columns = (TextColumn("{task.description:>16}"), BarColumn(), TimeElapsedColumn())
        with Progress(*columns, console=console, transient=True) as bar:
            task = bar.add_task(first, total=1.0)
            yield lambda stage, share: bar.update(task, description=stage, completed=share)
        return
    told = ""

    def tell(stage: str, share: float) -> None:
        nonlocal told
        line = f"{stage}: {10 * int(10.0 * share)} %"
        if line != told:
            told = line
            print(line, file=sys.stderr, flush=True)

    yield tell


def called(program: Sequence[str], name: str) -> str:
    """The command line from its word ``name`` on, as a user of ``program`` types it."""
    return shlex.join([*program, *sys.argv[sys.argv.index(name) if name in sys.argv else 1 :]])


def fail(message: str, status: int) -> NoReturn:
    """End the command with one sentence on stderr."""
    typer.echo(message, err=True)
    raise typer.Exit(status)


def print_diagnosis(found: Diagnosis) -> None:
    """The verdict, what was found, and the next experiment, on the terminal."""
    console, report = Console(), found.report
    gap: dict[str, Any] = report["gap"]
    console.print(f"[bold]verdict: {report['verdict']}[/bold]")
    for reason in report["reasons"]:
        console.print(f"  {reason}")
    console.print(
        f"held-out gap (noise floor = 1): {gap['before']:.2f} -> {gap['after']:.2f}, "
        f"shrink {gap['shrink']:.3f} (90 %: {gap['ci90'][0]:.3f} to {gap['ci90'][1]:.3f})"
    )
    table = Table("effect", "site", "parameter", "value", "90 %")
    for effect in report["effects"]:
        for name, p in effect["parameters"].items():
            interval = f"{p['ci90'][0]:.4g} to {p['ci90'][1]:.4g}"
            table.add_row(effect["name"], effect["site"], name, f"{p['value']:.4g} {p['unit']}", interval)
    if report["effects"]:
        console.print(table)
    for sentence in filter(None, (free(report), left(report), limits(report))):
        console.print(sentence, highlight=False)
    for group in report["equivalent"]:
        console.print("not told apart: " + ", ".join(group))
    if report["next_experiment"]:
        proposed = report["next_experiment"]
        console.print(f"next: {proposed['description']} (expected gain {proposed['expected_gain']:.1f} nats)")
    for warning in report["warnings"]:
        console.print(f"[yellow]warning:[/yellow] {warning}")
    console.print(f"{report['wall_s']:.1f} s")


def write_diagnosis(found: Diagnosis, out: Path | None, json_: Path | None) -> None:
    """Write diagnosis.json, the page and the next experiment into ``out``, and the diagnosis into ``json_``."""
    if out or json_:
        write_experiment(found, out or json_.parent, found.menu)  # type: ignore[union-attr]
    for path in filter(None, [json_, out / "diagnosis.json" if out else None]):
        write_report(found.report, path)
    if out:
        write_page(found.report, gather(found), out / "report.html")
