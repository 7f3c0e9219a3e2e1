"""``nermo gap mice``: make, diagnose and score a blind check of mice."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from simgap.blind.cli import (
    AnswersOption,
    BudgetOption,
    CaseOption,
    ExecutorOption,
    KeepOption,
    TimeoutOption,
    carry_out,
    hidden_places,
    refusals,
    say,
    score_command,
)
from simgap.cli import Only
from simgap.console import HELP, fail
from simgap.execution.executors import PROCESSES

mice_app = typer.Typer(
    name="mice",
    help="The blind check of mice: hidden ones that do the protocol, a diagnosis that cannot see them, and the score.",
    no_args_is_help=True,
    add_completion=False,
    context_settings=HELP,
)


@mice_app.command("make")
def make_command(
    out: Annotated[Path, typer.Option(help="Folder for recordings: what may be seen.")],
    cases: Annotated[int, typer.Option(help="How many: 20 % healthy, half with one fault, 15 % pairs, 15 % unknown.")],
    seed: Annotated[int, typer.Option(help="Of everything that is drawn. It is sealed with the answers.")],
    answers: Annotated[Path | None, typer.Option(help="Folder for the sealed answers; by default OUT-answers.")] = None,
    robots: Annotated[str, typer.Option(help="Comma-separated, taken in turn.")] = "nermo_lite",
    protocol: Annotated[str, typer.Option(help="standard, or walk.")] = "standard",
    markers: Annotated[bool, typer.Option("--markers", help="The tracker sees feet and rear torso too.")] = False,
    workers: Annotated[int, typer.Option(min=1, help="Processes.")] = max((os.cpu_count() or 1) - 1, 1),
    salt: Annotated[str | None, typer.Option(help="Sealed with each answer; random by default.")] = None,
) -> None:
    """Record mice with hidden faults, and seal the answers elsewhere.

    \b
    Example:
      nermo gap mice make --out mice --cases 30 --seed 2026
    """
    from nermo_description.robots import ParameterError
    from nermo_gap.blind.mice.check import make

    place = answers or out.with_name(out.name + "-answers")
    names = [name for name in robots.split(",") if name]
    if not names:
        fail("--robots: names no robot; nermo_lite, nermo or both", 2)

    def told(done: int, total: int) -> None:
        say(f"recorded {done} of {total}")

    try:
        with refusals():
            made = make(out, place, cases, seed, names, protocol, markers, workers, salt, told)
    except ParameterError as error:
        fail(str(error), 2)
    typer.echo(f"{len(made['cases'])} mice in {out}; answers sealed in {place}")
    typer.echo(f"next: nermo gap mice diagnose {out} --out {out}-results")


@mice_app.command("diagnose")
def diagnose_command(
    folder: Annotated[Path, typer.Argument(help="Folder of `make --out`.")],
    out: Annotated[Path, typer.Option(help="Folder for results.jsonl, a line a mouse as it comes; resumes it.")],
    workers: Annotated[int, typer.Option(min=1, help="Mice at a time, each on one processor.")] = os.cpu_count() or 1,
    timeout: TimeoutOption = 1800.0,
    budget: BudgetOption = None,
    case: CaseOption = None,
    only: Only = None,
    keep: KeepOption = False,
    answers: AnswersOption = None,
    executor: ExecutorOption = PROCESSES,
) -> None:
    """Diagnose all mice, each in a process that can read nothing but its own recordings.

    \b
    Example:
      nermo gap mice diagnose mice --out mice-results
    """
    from nermo_gap.blind.mice.check import WORKER
    from simgap.blind.run import Plan

    plan = Plan(
        cases=tuple(case or ()),
        threads=1,
        baselines=False,
        only=tuple(only or ()),
        answers=hidden_places(folder, answers),
        keep=keep,
        timeout=timeout,
        budget=budget,
        workers=workers,
        worker=WORKER,
        place=executor,
    )
    carry_out(folder, out, plan)


mice_app.command("score")(score_command)
