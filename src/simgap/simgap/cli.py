"""``simgap``: diagnose the gap between a recording and a MuJoCo model."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

import simgap
from simgap.analysis.diagnose import Options, diagnose
from simgap.blind.cli import blind_app
from simgap.console import called, fail, print_diagnosis, progress, write_diagnosis
from simgap.data.errors import GapInputError
from simgap.data.mapping import load_map
from simgap.data.plant import build_plant, load_spec
from simgap.data.recording import load_recording
from simgap.effects.library import load_effects

app = typer.Typer(
    name="simgap",
    help="Diagnose the sim-to-real gap: where it lies, which effect causes it, how far it shrinks.",
    no_args_is_help=True,
    add_completion=False,
)
app.add_typer(blind_app)


@app.callback()
def _simgap() -> None:
    """Diagnose the sim-to-real gap: where it lies, which effect causes it, how far it shrinks."""


@app.command("version")
def version_command() -> None:
    """Print the version."""
    typer.echo(simgap.__version__)


@app.command("diagnose")
def diagnose_command(
    recordings: Annotated[list[Path], typer.Argument(help="Tables (.csv, .npz, .parquet) or bags (.mcap, .db3).")],
    model: Annotated[Path, typer.Option(help="The nominal model, an MJCF.")],
    map_: Annotated[Path, typer.Option("--map", help="YAML that maps columns to actuators and sensors.")],
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
      simgap diagnose log.csv --model robot.xml --map map.yaml --json diagnosis.json
    """
    try:
        extra = tuple(c for path in effects or () for c in load_effects(path))
        plant = build_plant(load_spec(model), load_map(map_))
        tables = [load_recording(r, plant) for r in recordings]
        with progress("align") as say:
            found = diagnose(tables, plant, Options(seed, None, extra, {}, baselines, tuple(only or ()), say))
    except GapInputError as error:
        fail(str(error), 2)
    found.report["command"] = called(["simgap"], "diagnose")
    write_diagnosis(found, out, json_)
    print_diagnosis(found)


def main() -> None:
    """The console command."""
    app(prog_name="simgap")
