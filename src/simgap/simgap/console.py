"""What the commands share: progress, failure, and a diagnosis on the terminal and in files.

Nothing heavy is imported before it is needed: a command's help appears at once.
"""

from __future__ import annotations

import contextlib
import math
import os
import shlex
import signal
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from threading import current_thread, main_thread
from types import FrameType
from typing import TYPE_CHECKING, Any, NoReturn, TextIO

import typer

from simgap.data.errors import GapInputError
from simgap.inference.budget import Hurry

if TYPE_CHECKING:
    from rich.console import Console

    from simgap.analysis.diagnose import Diagnosis
    from simgap.live.watch import Live
    from simgap.preparation.check import Check
    from simgap.preparation.detectability import Detectable

HELP = {"help_option_names": ["-h", "--help"]}
"""Settings of every command."""


@contextlib.contextmanager
def silence() -> Iterator[TextIO]:
    """What other libraries print, in Python or below it, goes nowhere; yields the terminal for what is ours."""
    streams = [sys.stdout, sys.stderr]
    for stream in streams:
        stream.flush()
    saved = [os.dup(1), os.dup(2)]
    # A test that replaces sys.stderr reads there; on a terminal it is descriptor 2.
    on_terminal = sys.stderr is sys.__stderr__
    with (
        os.fdopen(os.dup(2), "w") as terminal,
        Path(os.devnull).open("w") as nowhere,
        warnings.catch_warnings(),
        contextlib.redirect_stdout(nowhere),
    ):
        warnings.simplefilter("ignore")
        for descriptor in (1, 2):
            os.dup2(nowhere.fileno(), descriptor)
        try:
            yield terminal if on_terminal else streams[1]
        finally:
            for descriptor, old in zip((1, 2), saved, strict=True):
                os.dup2(old, descriptor)
                os.close(old)


@contextlib.contextmanager
def hurried(terminal: TextIO) -> Iterator[Hurry]:
    """Yields what the first Ctrl-C in here sets to wanted; a second one interrupts, as ever."""
    hurry, usual = Hurry(), signal.getsignal(signal.SIGINT)
    # Where somebody else looks after it, or nobody is to, or no signal comes, it stays so.
    if usual is not signal.default_int_handler or current_thread() is not main_thread():
        yield hurry
        return

    def first(number: int, frame: FrameType | None) -> None:
        signal.signal(signal.SIGINT, usual)
        hurry.wanted = True
        # Not by the stream, in whose midst this may come. What has no descriptor is no terminal.
        with contextlib.suppress(OSError):
            os.write(terminal.fileno(), b"\nending with the best answer so far; Ctrl-C again ends without one\n")

    signal.signal(signal.SIGINT, first)
    try:
        yield hurry
    finally:
        signal.signal(signal.SIGINT, usual)


@contextlib.contextmanager
def progress(first: str, terminal: TextIO | None = None) -> Iterator[Callable[[str, float], None]]:
    """A bar for a stage's share of 1 on a terminal (by default stderr), lines elsewhere."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    console = Console(markup=False, file=terminal or sys.stderr)
    if console.is_terminal:
        columns = (TextColumn("{task.description:>16}"), BarColumn(), TimeElapsedColumn())
        with Progress(*columns, console=console, transient=True, redirect_stdout=False, redirect_stderr=False) as bar:
            task = bar.add_task(first, total=1.0)
            yield lambda stage, share: bar.update(task, description=stage, completed=share)
        return
    told = ""

    def tell(stage: str, share: float) -> None:
        nonlocal told
        line = f"{stage}: {10 * int(10.0 * share)} %"
        if line != told:
            told = line
            print(line, file=terminal or sys.stderr, flush=True)

    yield tell


def called(program: Sequence[str], name: str) -> str:
    """The command line from its word ``name`` on, as a user of ``program`` types it."""
    return shlex.join([*program, *sys.argv[sys.argv.index(name) if name in sys.argv else 1 :]])


def fail(message: str, status: int) -> NoReturn:
    """End the command with one sentence on stderr."""
    typer.echo(message, err=True)
    raise typer.Exit(status)


def warn_of_guess(verdict: str) -> None:
    """Say so on stderr where what is applied is not settled."""
    if verdict in ("ambiguous", "unknown"):
        typer.echo(f"warning: the verdict was {verdict}; what is written is its best guess", err=True)


def writable(out: Path | None, json_: Path | None) -> None:
    """Whether results will go into a folder and a file, asked before they are worked for; nothing is made yet.

    Raises:
        GapInputError: they will not.
    """
    for option, folder in (("--out", out), ("--json", json_.parent if json_ else None)):
        if folder is None:
            continue
        above = next(place for place in (folder.absolute(), *folder.absolute().parents) if place.exists())
        if not above.is_dir() or not os.access(above, os.W_OK):
            why = "nothing may be written there" if above.is_dir() else "it is a file and no folder"
            raise GapInputError(f"{option}: {above}: {why}; choose another")
    if json_ is not None and json_.is_dir():
        raise GapInputError(f"--json: {json_}: is a folder; give a file in it")


@contextlib.contextmanager
def refusals() -> Iterator[None]:
    """Input that cannot be used ends the command with its sentence and status 2."""
    try:
        yield
    except GapInputError as error:
        fail(str(error), 2)


def guarded(app: typer.Typer, program: str) -> None:
    """Run a program; what nobody foresaw is one sentence, not a traceback (unless SIMGAP_TRACEBACK is set)."""
    try:
        app(prog_name=program)
    except Exception as error:
        if os.environ.get("SIMGAP_TRACEBACK"):
            raise
        typer.echo(
            f"{program}: an error of the program itself ({type(error).__name__}: {error}); please report it with what "
            "SIMGAP_TRACEBACK=1 shows",
            err=True,
        )
        sys.exit(1)


def print_check(found: Check) -> None:
    """What a recording holds, by joint, with doubts and advice, on the terminal."""
    from rich.console import Console
    from rich.table import Table

    # No markup: channels of a bag have brackets in their names.
    console = Console(markup=False)
    runs = "one run" if found.runs == 1 else f"{found.runs} runs"
    console.print(f"{found.duration:.4g} s in {runs}, a sample every {1e3 * found.period:.4g} ms")
    table = Table("joint", "from", "to", "rms speed", "reversals", "noise", "not told apart")
    for joint in found.joints:
        told = "anything: it stands still" if joint.still else ", ".join(joint.confounded) or "-"
        numbers = [f"{v:.3g}" for v in (joint.low, joint.high, joint.speed)]
        table.add_row(joint.name, *numbers, str(joint.reversals), f"{joint.noise:.2g}", told)
    console.print(table)
    if found.detectability:
        _print_detectable(found.detectability, console)
    for warning in found.warnings:
        _led(console, "warning:", f" {warning}", "yellow")
    for line in found.advice:
        console.print(f"record: {line}", highlight=False)
    console.print(found.verdict, style="bold")


def _led(console: Console, lead: str, text: str, style: str) -> None:
    """A line that begins with something in another style."""
    from rich.text import Text

    console.print(Text.assemble((lead, style), text))


def _print_detectable(rows: Sequence[Detectable], console: Console) -> None:
    """By part: the smallest that would be found of each effect, and what does not show or looks like another."""
    console.print("what this recording could show, part by part, from which size on", style="bold")
    for site in dict.fromkeys(row.site for row in rows):
        mine = [row for row in rows if row.site == site]
        size = [f"{r.effect} {size_of(r)}" for r in mine if r.smallest is not None and r.rival is None]
        like = [f"{r.effect} {size_of(r)} (like {r.rival})" for r in mine if r.rival is not None]
        hidden = [r.effect for r in mine if r.smallest is None]
        _led(console, site, f": {', '.join(size) or 'nothing'}", "bold")
        for what, names in (("not told from another", like), ("does not show", hidden)):
            if names:
                console.print(f"  {what}: {', '.join(names)}", highlight=False)


def size_of(row: Detectable) -> str:
    """The smallest size of an effect that shows, with its unit."""
    if row.parameter.startswith("factor") and row.smallest is not None:
        return f"x {1.0 + float(f'{row.smallest - 1.0:.2g}'):.6g}"
    if row.unit == "1":
        return f"{row.smallest:.2g}"
    return f"{row.smallest:.2g} {row.unit}"


def print_diagnosis(found: Diagnosis, report_file: Path | None = None) -> None:
    """The verdict, what was found, and the next experiment, on the terminal; last, where the report is."""
    from rich.console import Console
    from rich.table import Table

    from simgap.report.sentences import free, left, limits

    console, report = Console(markup=False), found.report
    gap: dict[str, Any] = report["gap"]
    console.print(f"verdict: {report['verdict']}", style="bold")
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
        gain = proposed["expected_gain"]
        odds = f"odds of {math.exp(min(gain, 20.0)):.2g} to 1" if gain < 20.0 else "beyond doubt"
        console.print(f"next: {proposed['description']} (should tell them apart by {gain:.1f} nats, {odds})")
    told = report.get("what_to_do", {})
    for row in told.get("checks", ()):
        console.print(f"check: {row['check']}", highlight=False)
    for line in told.get("commands", ()):
        console.print(f"type next: {line}", highlight=False, soft_wrap=True)
    for warning in report["warnings"]:
        _led(console, "warning:", f" {warning}", "yellow")
    for line in report.get("data", {}).get("advice", ()):
        console.print(f"record: {line}", highlight=False)
    console.print(f"{report['wall_s']:.1f} s")
    if report_file is not None:
        # Not wrapped by the width of the terminal, so that it can be copied.
        print(report_file)


def print_each(rows: Sequence[dict[str, Any]], summary: Path, command: str) -> None:
    """A row for each of many recordings, on the terminal and in a file; last, where that is.

    Ends with status 2 where a recording could not be used.
    """
    from rich.console import Console
    from rich.table import Table

    from simgap.analysis.diagnose import write_report

    rows = sorted(rows, key=lambda row: str(row["recording"]))
    table = Table("recording", "verdict", "effects", "gap before", "after")
    for row in rows:
        name = Path(row["recording"]).name
        if "error" in row:
            table.add_row(name, "refused")
            continue
        effects = "\n".join(f"{e['name']}@{e['site']}: {_parameters(e)}" for e in row["effects"])
        table.add_row(name, row["verdict"], effects, f"{row['gap']['before']:.2f}", f"{row['gap']['after']:.2f}")
    write_report({"schema": "simgap/each/1", "command": command, "rows": rows}, summary)
    Console(markup=False).print(table)
    print(summary)
    if errors := [row["error"] for row in rows if "error" in row]:
        fail(errors[0], 2)


def _parameters(effect: dict[str, Any]) -> str:
    return ", ".join(f"{p['value']:.4g} {p['unit']}".strip() for p in effect["parameters"].values())


def write_diagnosis(found: Diagnosis, out: Path | None, json_: Path | None, live: Live | None = None) -> Path | None:
    """Write diagnosis.json, the page and the next experiment into ``out``, and the diagnosis into ``json_``.

    ``live`` shows it, where somebody may watch.

    Returns:
        The page, or where none is asked for the diagnosis.

    Raises:
        GapInputError: they cannot be written.
    """
    from simgap.analysis.diagnose import write_experiment, write_report
    from simgap.correction.apply import diagnosed
    from simgap.report.evidence import gather
    from simgap.report.html import write_page

    if live:
        live.writes()
    found.report["correction"] = diagnosed(found.selector.fitter, found.numbers, found.report["effects"]).report()
    try:
        if out or json_:
            write_experiment(found, out or json_.parent, found.menu)  # type: ignore[union-attr]
        for path in filter(None, [json_, out / "diagnosis.json" if out else None]):
            write_report(found.report, path)
    except OSError as error:
        raise GapInputError(f"{error.filename}: cannot be written ({error.strerror})") from error
    evidence = gather(found) if out or live else None
    if out and evidence:
        write_page(found.report, evidence, out / "report.html")
    written = out / "report.html" if out else json_
    if live and evidence:
        live.finished(found.report, evidence, written)
    return written
