"""``nermo gap``: diagnose the gap between a recording and a model."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Any, NoReturn

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn
from rich.table import Table

from nermo_gap.blind.cli import blind_app
from nermo_gap.core.diagnose import Diagnosis, Options, diagnose, write_experiment, write_report
from nermo_gap.core.errors import GapInputError
from nermo_gap.core.library import load_effects
from nermo_gap.core.mapping import load_map
from nermo_gap.core.plant import build_plant, load_spec
from nermo_gap.core.recording import load_table, recording_from_table
from nermo_gap.report.evidence import gather
from nermo_gap.report.html import write_page

gap_app = typer.Typer(
    name="gap",
    help="Diagnose the sim-to-real gap: where it lies, which effect causes it, how far it shrinks.",
    no_args_is_help=True,
    add_completion=False,
)


gap_app.add_typer(blind_app)


@gap_app.callback()
def _gap() -> None:
    """Diagnose the sim-to-real gap: where it lies, which effect causes it, how far it shrinks."""


@gap_app.command("diagnose")
def diagnose_command(
    recordings: Annotated[list[Path], typer.Argument(help="Tables (.csv, .npz, .parquet) with a header.")],
    model: Annotated[Path | None, typer.Option(help="The nominal model, an MJCF.")] = None,
    map_: Annotated[Path | None, typer.Option("--map", help="YAML that maps columns to actuators and sensors.")] = None,
    out: Annotated[Path | None, typer.Option(help="Folder for diagnosis.json and report.html.")] = None,
    json_: Annotated[Path | None, typer.Option("--json", help="File for the diagnosis.")] = None,
    effects: Annotated[list[Path] | None, typer.Option(help="Python files with effects of your own.")] = None,
    only: Annotated[list[str] | None, typer.Option(help="Consider this effect only (may be repeated).")] = None,
    seed: Annotated[int, typer.Option(help="Seed of the bootstrap.")] = 0,
    baselines: Annotated[bool, typer.Option(help="Also fit everything at once, for comparison.")] = True,
) -> None:
    """Say where the gap of a recording lies, which effect causes it, and how far the effect shrinks it.

    \b
    Example:
      nermo gap diagnose log.csv --model robot.xml --map map.yaml --json diagnosis.json
    """
    if model is None or map_ is None:
        _fail("a table needs --model MODEL.xml and --map MAP.yaml", 2)
    try:
        plant = build_plant(load_spec(model), load_map(map_))
        tables = [recording_from_table(load_table(r), plant, str(r)) for r in recordings]
        extra = tuple(c for path in effects or () for c in load_effects(path))
        with _progress() as progress:
            task = progress.add_task("align", total=1.0)

            def say(stage: str, share: float, bar: Progress = progress, id_: TaskID = task) -> None:
                bar.update(id_, description=stage, completed=share)

            found = diagnose(tables, plant, Options(seed, None, extra, {}, baselines, tuple(only or ()), say))
    except GapInputError as error:
        _fail(str(error), 2)
    found.report["command"] = " ".join(["nermo gap diagnose", *sys.argv[2:]])
    if out or json_:
        write_experiment(found, out or json_.parent)  # type: ignore[union-attr]
    for path in filter(None, [json_, out / "diagnosis.json" if out else None]):
        write_report(found.report, path)
    if out:
        write_page(found.report, gather(found), out / "report.html")
    _print(found)


def _progress() -> Progress:
    columns = (TextColumn("{task.description:>16}"), BarColumn(), TimeElapsedColumn())
    return Progress(*columns, console=Console(stderr=True), transient=True)


def _fail(message: str, status: int) -> NoReturn:
    typer.echo(message, err=True)
    raise typer.Exit(status)


def _print(found: Diagnosis) -> None:
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
    for group in report["equivalent"]:
        console.print("not told apart: " + ", ".join(group))
    if report["next_experiment"]:
        proposed = report["next_experiment"]
        console.print(f"next: {proposed['description']} (expected gain {proposed['expected_gain']:.1f} nats)")
    for warning in report["warnings"]:
        console.print(f"[yellow]warning:[/yellow] {warning}")
    console.print(f"{report['wall_s']:.1f} s")


if __name__ == "__main__":
    typer.main.get_command(gap_app)()
