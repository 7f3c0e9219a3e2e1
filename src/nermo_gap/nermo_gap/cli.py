"""``nermo gap``: diagnose the gap between a recording and a model."""

from __future__ import annotations

import contextlib
import shlex
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated, Any, NoReturn

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from nermo_description.robots import ParameterError
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
    recordings: Annotated[
        list[Path], typer.Argument(help="MCAPs of this system, or tables (.csv, .npz, .parquet) with a header.")
    ],
    robot: Annotated[
        str | None, typer.Option(help="nermo, nermo_lite or a parameter file; by default what the recording says.")
    ] = None,
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
      nermo gap diagnose recordings/today --robot nermo --out diagnosis
      nermo gap diagnose log.csv --model robot.xml --map map.yaml --json diagnosis.json
    """
    mouse = robot is not None or any(r.suffix.lower() == ".mcap" or r.is_dir() for r in recordings)
    if mouse and (model is not None or map_ is not None):
        _fail("--model and --map are for tables of other robots; a recording of the mouse brings its own (--robot)", 2)
    if not mouse and (model is None or map_ is None):
        _fail("a table needs --model MODEL.xml and --map MAP.yaml, or --robot where it is one of the mouse", 2)
    try:
        extra = tuple(c for path in effects or () for c in load_effects(path))
        with _progress("align") as say:
            options = Options(seed, None, extra, {}, baselines, tuple(only or ()), say)
            if model is not None and map_ is not None:
                plant = build_plant(load_spec(model), load_map(map_))
                tables = [recording_from_table(load_table(r), plant, str(r)) for r in recordings]
                found = diagnose(tables, plant, options)
            else:
                # What knows the mouse is imported only for the mouse.
                from nermo_gap.robots.diagnosis import diagnose_recordings

                found = diagnose_recordings(recordings, robot, options)
    except (GapInputError, ParameterError) as error:
        _fail(str(error), 2)
    found.report["command"] = _called("diagnose")
    if out or json_:
        write_experiment(found, out or json_.parent, found.menu)  # type: ignore[union-attr]
    for path in filter(None, [json_, out / "diagnosis.json" if out else None]):
        write_report(found.report, path)
    if out:
        write_page(found.report, gather(found), out / "report.html")
    _print(found)


@gap_app.command("apply")
def apply_command(
    diagnosis: Annotated[Path, typer.Argument(help="The diagnosis.json of a recording of the mouse.")],
    out: Annotated[Path, typer.Option(help="Robot file (.yaml) to write.")],
    robot: Annotated[str | None, typer.Option(help="The robot that was diagnosed; by default what it says.")] = None,
) -> None:
    """Write the effects of a diagnosis as a robot that the twin, the experiments and the graph load.

    \b
    Example:
      nermo gap apply diagnosis/diagnosis.json --out my_robot.yaml
      nermo experiment straight-line --quick --robot my_robot.yaml
    """
    from nermo_gap.robots.apply import deviations_of, read_diagnosis, write_robot

    if out.suffix not in (".yaml", ".yml"):
        _fail(f"--out: {out} must end in .yaml", 2)
    try:
        report = read_diagnosis(diagnosis)
        base = robot or str(report.get("robot_file") or report["robot"])
        applied = deviations_of(report, base)
        if report["verdict"] != "effect":
            typer.echo(f"warning: the verdict was {report['verdict']}; the effects are its best guess", err=True)
        if not applied.deviations:
            _fail(
                f"{diagnosis}: holds no effect that a robot file can hold ({'; '.join(applied.left_out) or 'none'})", 1
            )
        write_robot(applied.deviations, base, out)
    except (GapInputError, ParameterError) as error:
        _fail(str(error), 2)
    for deviation in applied.deviations:
        values = ", ".join(f"{n} {v:.4g}" for n, v in deviation.values.items())
        typer.echo(f"{deviation.effect} at {', '.join(deviation.sites) or 'the world'}: {values}")
    for line in applied.left_out:
        typer.echo(f"left out: {line}", err=True)
    typer.echo(f"written: {out}")


@gap_app.command("explain")
def explain_command(
    summary: Annotated[Path, typer.Argument(help="SUMMARY.yaml, or thesis_robot for the thesis's own.")],
    out: Annotated[Path, typer.Option(help="Folder for what has been run; a second call goes on there.")] = Path(
        "explanation"
    ),
    json_: Annotated[Path | None, typer.Option("--json", help="File for the explanations.")] = None,
    only: Annotated[list[str] | None, typer.Option(help="Look at this effect only, name@site (repeat).")] = None,
    effects: Annotated[int, typer.Option(min=1, max=3, help="Largest number of effects at once.")] = 2,
    workers: Annotated[int | None, typer.Option(min=1, help="Processes; by default one a processor.")] = None,
) -> None:
    """Say which effects reproduce a table of published results: speeds, ratios, arc times, lifts.

    \b
    Example:
      nermo gap explain thesis_robot --out explanation --json explanation.json
    """
    from nermo_gap.explain.report import explain_file, print_explanations

    try:
        with _progress("experiments") as say:
            report = explain_file(
                summary, out, only or [], effects, workers, lambda stage, done, total: say(stage, done / max(total, 1))
            )
    except (GapInputError, ParameterError) as error:
        _fail(str(error), 2)
    report["command"] = _called("explain")
    if json_ is not None:
        write_report(report, json_)
    print_explanations(report)


@gap_app.command("predict")
def predict_command(
    diagnosis: Annotated[Path, typer.Argument(help="The diagnosis.json of a recording of the mouse.")],
    out: Annotated[Path, typer.Option(help="Folder for what has been run; a second call goes on there.")] = Path(
        "prediction"
    ),
    json_: Annotated[Path | None, typer.Option("--json", help="File for the predictions.")] = None,
    robot: Annotated[str | None, typer.Option(help="The robot that was diagnosed; by default what it says.")] = None,
    quick: Annotated[bool, typer.Option(help="The straight line only.")] = False,
) -> None:
    """Say how the experiments would go with what a diagnosis has found, in closed loop.

    \b
    Example:
      nermo gap predict diagnosis/diagnosis.json --quick
    """
    from nermo_gap.explain.predict import predict, print_predictions
    from nermo_gap.robots.apply import deviations_of, read_diagnosis

    try:
        report = read_diagnosis(diagnosis)
        base = robot or str(report.get("robot_file") or report["robot"])
        applied = deviations_of(report, base)
        with _progress("experiments") as say:
            rows = predict(
                base, applied.deviations, out, quick, lambda done, total: say("experiments", done / max(total, 1))
            )
    except (GapInputError, ParameterError) as error:
        _fail(str(error), 2)
    if json_ is not None:
        write_report({"schema": "nermo_gap/prediction/1", "robot": base, "rows": rows}, json_)
    print_predictions(rows)


@contextlib.contextmanager
def _progress(first: str) -> Iterator[Callable[[str, float], None]]:
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


def _called(name: str) -> str:
    """The command line, whatever program it was given to."""
    return shlex.join(["nermo", "gap", *sys.argv[sys.argv.index(name) if name in sys.argv else 1 :]])


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
