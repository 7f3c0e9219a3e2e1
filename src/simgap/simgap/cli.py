"""``simgap``: diagnose the gap between a recording and a MuJoCo model.

Commands import what they need when they run, so that help appears at once.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

import simgap
from simgap.blind.cli import blind_app
from simgap.console import (
    HELP,
    called,
    fail,
    guarded,
    hurried,
    print_diagnosis,
    print_each,
    progress,
    refusals,
    silence,
    warn_of_guess,
    writable,
    write_diagnosis,
)
from simgap.data.formats import BAGS, TABLES, listed
from simgap.execution.executors import HELP as EXECUTOR
from simgap.execution.executors import PROCESSES
from simgap.live.options import HERE, PORT, Web, WebHost, WebPort

app = typer.Typer(
    name="simgap",
    help="Diagnose the sim-to-real gap: where it lies, which effect causes it, how far it shrinks.",
    no_args_is_help=True,
    add_completion=False,
    context_settings=HELP,
)
app.add_typer(blind_app)

Recordings = Annotated[
    list[Path], typer.Argument(help=f"Tables ({listed(TABLES)}), LeRobot datasets, or bags ({listed(BAGS)}).")
]
Model = Annotated[Path, typer.Option(help="The nominal model, an MJCF.")]
MapFile = Annotated[Path, typer.Option("--map", help="YAML that maps columns or topics to actuators and sensors.")]

# Of every command that diagnoses, nermo_gap's too.
Out = Annotated[
    Path | None, typer.Option(help="Folder for diagnosis.json and report.html; `diagnosis` without --json.")
]
DiagnosisFile = Annotated[Path | None, typer.Option("--json", help="File for the diagnosis.")]
OwnEffects = Annotated[list[Path] | None, typer.Option(help="Python files with effects of your own.")]
Only = Annotated[list[str] | None, typer.Option(help="Consider this effect only (may be repeated).")]
Seed = Annotated[int, typer.Option(min=0, help="Seed of the bootstrap.")]
Baselines = Annotated[bool, typer.Option(help="Also fit everything at once, for comparison.")]
Budget = Annotated[float | None, typer.Option(min=1.0, help="Seconds that it may take; the best answer by then.")]
Reference = Annotated[
    list[Path] | None,
    typer.Option(help="A recording of the same robot when it was well (may be repeated): what has changed since?"),
]


@app.callback()
def _simgap() -> None:
    """Diagnose the sim-to-real gap: where it lies, which effect causes it, how far it shrinks."""


@app.command("version")
def version_command() -> None:
    """Print the version."""
    typer.echo(simgap.__version__)


@app.command("diagnose")
def diagnose_command(
    recordings: Recordings,
    model: Model,
    map_: MapFile,
    out: Out = None,
    json_: DiagnosisFile = None,
    effects: OwnEffects = None,
    only: Only = None,
    seed: Seed = 0,
    baselines: Baselines = True,
    budget: Budget = None,
    reference: Reference = None,
    each: Annotated[
        bool, typer.Option("--each", help="Each recording by itself, in a folder of OUT that has its name.")
    ] = False,
    workers: Annotated[
        int | None, typer.Option(min=1, help="With --each: processes; by default one a processor.")
    ] = None,
    executor: Annotated[str, typer.Option(help=f"With --each. {EXECUTOR}")] = PROCESSES,
    web: Web = False,
    web_host: WebHost = HERE,
    web_port: WebPort = PORT,
) -> None:
    """Say where the gap of a recording lies, which effect causes it, and how far the effect shrinks it.

    Ctrl-C ends the search with the best answer so far; a second one without an answer.

    \b
    Examples:
      simgap diagnose log.csv --model robot.xml --map map.yaml --out diagnosis
      simgap diagnose today.csv --reference yesterday.csv --model robot.xml --map map.yaml
      simgap diagnose run*.csv --each --model robot.xml --map map.yaml --out runs
      simgap diagnose log.csv --model robot.xml --map map.yaml --web
    """
    if not each and (executor != PROCESSES or workers is not None):
        fail("--executor and --workers need --each: one diagnosis uses the processors of this machine by itself", 2)
    if each and web:
        fail("--web shows one diagnosis: it does not go with --each", 2)
    with refusals():
        from simgap.live.watch import watched
        from simgap.many import Wanted, diagnose_each, diagnose_files

        writable(out or (None if json_ and not each else Path("diagnosis")), json_)
        wanted = Wanted(
            tuple(recordings),
            model,
            map_,
            tuple(effects or ()),
            tuple(only or ()),
            seed,
            baselines,
            budget,
            tuple(reference or ()),
            command=called(["simgap"], "diagnose"),
        )
        if each:
            folder, rows = out or Path("diagnosis"), []
            with progress("recordings") as say:
                for row in diagnose_each(wanted, folder, workers, executor):
                    rows.append(row)
                    say("recordings", len(rows) / len(recordings))
            print_each(rows, json_ or folder / "summary.json", wanted.command)
            return
        with watched(web, web_host, web_port) as live:
            with silence() as terminal, hurried(terminal) as hurry, progress("align", terminal) as say:
                told, staged = (live.beside(say), live.staged) if live else (say, None)
                found = diagnose_files(wanted, told, staged, hurry)
            written = write_diagnosis(found, out or (None if json_ else Path("diagnosis")), json_, live)
            print_diagnosis(found, written)


@app.command("apply")
def apply_command(
    diagnosis: Annotated[Path, typer.Argument(help="The folder or diagnosis.json of `simgap diagnose`.")],
    out: Annotated[Path, typer.Option(help="The corrected model (.xml), or URDF, to write.")],
    model: Annotated[Path | None, typer.Option(help="The model that was diagnosed, an MJCF.")] = None,
    wrapper: Annotated[
        Path | None, typer.Option(help="Python file for what no MJCF can say; by default OUT_signals.py.")
    ] = None,
    randomise: Annotated[
        Path | None, typer.Option(help="YAML file for the intervals, as ranges for domain randomisation.")
    ] = None,
    map_: Annotated[
        Path | None, typer.Option("--map", help="The map of the diagnosis: writes OUT_map.yaml, to go on from here.")
    ] = None,
    urdf: Annotated[
        Path | None, typer.Option(help="In place of --model: the robot's URDF, which gets the numbers that it knows.")
    ] = None,
) -> None:
    """Write what a diagnosis has found into the model, and what no model can say into a small Python file.

    \b
    Examples:
      simgap apply diagnosis/diagnosis.json --model robot.xml --out robot_corrected.xml --randomise ranges.yaml
      simgap apply diagnosis/diagnosis.json --model robot.xml --map map.yaml --out robot_corrected.xml
      simgap apply diagnosis/diagnosis.json --urdf robot.urdf --out robot_corrected.urdf
    """
    source = model or urdf
    if source is None or (model is not None and urdf is not None):
        fail("give --model MODEL.xml, the MJCF that was diagnosed, or --urdf ROBOT.urdf", 2)
    if urdf is None and out.suffix.lower() != ".xml":
        fail(f"--out: {out} must end in .xml, as MuJoCo's models do", 2)
    if out.resolve() == source.resolve():
        fail(f"--out: {out} is the model itself; choose another name", 2)
    if urdf is not None:
        if wrapper is not None or randomise is not None or map_ is not None:
            fail("--wrapper, --map and --randomise need --model: they are for MuJoCo", 2)
        _apply_urdf(diagnosis, urdf, out)
        return
    assert model is not None
    with refusals():
        from simgap.correction.apply import apply, read_diagnosis
        from simgap.correction.changes import Correction
        from simgap.correction.ranges import write_ranges

        report = read_diagnosis(diagnosis)
        maps = (map_, out.with_name(f"{out.stem}_map.yaml")) if map_ is not None else None
        applied = apply(report, model, out, wrapper or out.with_name(f"{out.stem}_signals.py"), maps)
        if randomise is not None:
            found = Correction.of(report["correction"])
            write_ranges(randomise, found.changes, found.signals, str(diagnosis))
    warn_of_guess(report["verdict"])
    for change in applied.written:
        typer.echo(change.sentence)
    for signal in applied.wrapped:
        typer.echo(f"{signal.sentence} (in {applied.wrapper})")
    for signal in applied.mapped:
        typer.echo(f"{signal.sentence} (in {applied.map})")
    for note in applied.notes:
        typer.echo(f"not written: {note}", err=True)
    if not applied.kept_text:
        typer.echo("the model is written anew by MuJoCo: its layout and comments are not kept", err=True)
    for path in (randomise, applied.wrapper, applied.map, out):
        if path is not None:
            typer.echo(path)


def _apply_urdf(diagnosis: Path, urdf: Path, out: Path) -> None:
    with refusals():
        from simgap.correction.apply import read_diagnosis
        from simgap.correction.changes import Correction
        from simgap.correction.urdf import write_urdf

        report = read_diagnosis(diagnosis)
        applied = write_urdf(urdf, Correction.of(report["correction"]), out)
    warn_of_guess(report["verdict"])
    for change in applied.written:
        typer.echo(change.sentence)
    for note in applied.notes:
        typer.echo(f"not written: {note}", err=True)
    typer.echo(out)


@app.command("effects")
def effects_command(
    name: Annotated[str | None, typer.Argument(help="Only this effect.")] = None,
    markdown: Annotated[bool, typer.Option("--markdown", help="All of them as a page of Markdown.")] = False,
) -> None:
    """List every effect that a diagnosis can name: what it is, where it acts, its parameters and their units."""
    with refusals():
        from simgap.catalogue import as_markdown, catalogue
        from simgap.data.errors import GapInputError, nearest

        rows = catalogue()
        if name is not None and name not in {row.name for row in rows}:
            raise GapInputError(f"no effect {name!r}; {nearest(name, [row.name for row in rows], 'effect')}")
    if markdown:
        typer.echo(as_markdown(), nl=False)
        return
    for row in rows:
        if name in (None, row.name):
            typer.echo(f"{row.name} (at {row.site})\n    {row.sentence}\n    {row.parameters}")


@app.command("check")
def check_command(
    recordings: Recordings,
    model: Model,
    map_: MapFile,
    json_: Annotated[Path | None, typer.Option("--json", help="File for what was seen.")] = None,
) -> None:
    """Look at a recording before it is diagnosed: clock, holes, units, signs, and how small a fault it could show.

    \b
    Example:
      simgap check log.csv --model robot.xml --map map.yaml
    """
    with refusals():
        from simgap.console import print_check
        from simgap.data.mapping import load_map
        from simgap.data.plant import build_plant, load_spec
        from simgap.data.recording import load_recording
        from simgap.preparation.check import check

        writable(None, json_)
        plant = build_plant(load_spec(model), load_map(map_))
        with silence():
            found = check([load_recording(r, plant) for r in recordings], plant, detect=True)
        if json_ is not None:
            from simgap.analysis.diagnose import write_report

            write_report(found.report(), json_)
    print_check(found)
    if found.errors:
        fail(found.errors[0], 2)


@app.command("map")
def map_command(
    recording: Annotated[Path, typer.Argument(help="A table, a LeRobot dataset or a bag.")],
    model: Model,
    out: Annotated[Path, typer.Option(help="The map to write.")] = Path("map.yaml"),
    yes: Annotated[bool, typer.Option("--yes", help="Never ask; what nobody can know stays open in the file.")] = False,
) -> None:
    """Guess which column or topic is which actuator and joint, in which unit, and write it down with comments.

    \b
    Example:
      simgap map log.csv --model robot.xml --out map.yaml
    """

    def ask(question: str, default: str) -> str:
        try:
            return str(typer.prompt(question, default=default, show_default=False, err=True))
        except typer.Abort:
            if sys.stdin.isatty():
                raise  # somebody was there, and stopped it
            typer.echo("", err=True)
            return default

    with refusals():
        from simgap.data.errors import GapInputError
        from simgap.data.plant import load_model
        from simgap.preparation.guess import guess_map

        guess = guess_map(recording, load_model(model), None if yes else ask)
        try:
            out.parent.mkdir(parents=True, exist_ok=True)
            out.write_text(guess.text(recording.name), encoding="utf-8")
        except OSError as error:
            raise GapInputError(f"{out}: cannot be written ({error.strerror})") from error
    typer.echo(f"{len(guess.inputs)} inputs, {len(guess.outputs)} outputs, {len(guess.unused)} not used")
    for doubt in guess.open:
        typer.echo(f"look at: {doubt}")
    typer.echo(out)


@app.command("monitor")
def monitor_command(
    recording: Annotated[Path, typer.Argument(help="A .csv or .mcap that another process is writing.")],
    model: Model,
    map_: MapFile,
    reference: Annotated[
        list[Path] | None, typer.Option(help="A recording of the robot when it was well (may be repeated).")
    ] = None,
    idle: Annotated[float, typer.Option(min=0.0, help="Ends when nothing was written for so many seconds.")] = 10.0,
    json_: Annotated[Path | None, typer.Option("--json", help="File for what was seen, written at the end.")] = None,
) -> None:
    """Watch a robot while it is recorded: the gap of the last seconds by part, and when the model goes stale.

    Without a reference, ten seconds of motion teach what is usual. Ends with Ctrl-C, or when the file grows no more.

    \b
    Example:
      simgap monitor log.csv --model robot.xml --map map.yaml --reference good.csv
    """
    import time

    with refusals():
        from simgap.analysis.diagnose import write_report
        from simgap.data.growing import follow
        from simgap.data.mapping import load_map
        from simgap.data.plant import build_plant, load_spec
        from simgap.data.recording import load_recording
        from simgap.monitoring.monitor import SPAN, Monitor
        from simgap.monitoring.watch import line, report, watch

        writable(None, json_)
        plant = build_plant(load_spec(model), load_map(map_))
        source = follow(recording, plant.map)
        monitor = Monitor(plant, [load_recording(r, plant) for r in reference or ()])
        typer.echo(f"gap of the last {SPAN:g} s by part, in noise floors; in brackets what is usual", err=True)
        changes, told = [], 0.0
        try:
            for changed in watch(source, monitor, idle):
                for change in changed:
                    typer.echo(change.sentence)
                changes += changed
                if time.monotonic() - told >= 1.0:
                    told = time.monotonic()
                    typer.echo(line(monitor), err=True)
        except KeyboardInterrupt:
            pass
        if json_ is not None:
            write_report(report(monitor, changes), json_)
    if monitor.learned < 1.0:
        fail(f"{recording}: {monitor.waits or 'too little motion to learn what is usual'}; nothing can be said", 1)
    stale = ", ".join(monitor.stale)
    typer.echo(f"{monitor.time:.1f} s watched: " + (f"stale at the end: {stale}" if stale else "the model fits"))


@app.command("example")
def example_command(
    out: Annotated[Path, typer.Option(help="Folder for model, map, log and diagnosis.")] = Path("example"),
    seed: Annotated[int, typer.Option(min=0, help="Which fault, and which motion.")] = 0,
    diagnosed: Annotated[bool, typer.Option("--diagnose/--make-only", help="Also diagnose it, in a minute.")] = True,
) -> None:
    """Make the log of a simulated arm with a hidden fault, diagnose it, and say what was hidden.

    \b
    Example:
      simgap example
    """
    with refusals():
        from simgap.examples.arm import make

        fault = make(out, seed)
    files = [str(out / name) for name in ("log.csv", "model.xml", "map.yaml")]
    line = f"simgap diagnose {files[0]} --model {files[1]} --map {files[2]} --out {out / 'diagnosis'}"
    typer.echo(f"made {', '.join(files)}; now: {line}", err=True)
    if diagnosed:
        diagnose_command([Path(files[0])], Path(files[1]), Path(files[2]), out / "diagnosis", baselines=False)
        typer.echo(f"hidden was {fault.effect}: {fault.sentence}", err=True)


def main() -> None:
    """The console command."""
    guarded(app, "simgap")
