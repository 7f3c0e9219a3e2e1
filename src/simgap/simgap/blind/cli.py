"""``simgap blind`` and ``python -m simgap.blind``: make, diagnose and score a blind check."""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer

from simgap.data.errors import GapInputError
from simgap.execution.executors import HELP as EXECUTOR
from simgap.execution.executors import PROCESSES

if TYPE_CHECKING:
    from simgap.blind.run import Plan

# What does the work takes seconds to import, and help is asked for often: commands import it when they run.

TimeoutOption = Annotated[float, typer.Option(help="Of one case, in seconds.")]
BudgetOption = Annotated[float | None, typer.Option(help="Stop after so many seconds; what is left waits.")]
CaseOption = Annotated[list[str] | None, typer.Option(help="Only this case (may be repeated).")]
KeepOption = Annotated[bool, typer.Option(help="Keep every diagnosis.json.")]
AnswersOption = Annotated[
    list[Path] | None, typer.Option(help="Where answers lie: each process tries to read there, and must fail.")
]
ExecutorOption = Annotated[str, typer.Option(help=EXECUTOR)]

blind_app = typer.Typer(
    name="blind",
    help="The blind check: hidden faults, a diagnosis that cannot see them, and the score.",
    no_args_is_help=True,
    add_completion=False,
)


def _fail(message: str, status: int) -> NoReturn:
    typer.echo(message, err=True)
    raise typer.Exit(status)


@contextlib.contextmanager
def refusals() -> Iterator[None]:
    """What cannot be done ends the command with one sentence."""
    from simgap.blind.make import BlindError

    try:
        yield
    except (BlindError, GapInputError) as error:
        _fail(str(error), 2)


@blind_app.command("make")
def make_command(
    out: Annotated[Path, typer.Option(help="Folder for recordings, maps and models: what may be seen.")],
    cases: Annotated[int, typer.Option(help="How many: 20 % healthy, half with one fault, 15 % pairs, 15 % unknown.")],
    seed: Annotated[int, typer.Option(help="Of everything that is drawn. It is sealed with the answers.")],
    answers: Annotated[Path | None, typer.Option(help="Folder for the sealed answers; by default OUT-answers.")] = None,
    robots: Annotated[str | None, typer.Option(help="Comma-separated; by default all that come with it.")] = None,
    seconds: Annotated[float, typer.Option(help="Length of each recording, in seconds.")] = 15.0,
    workers: Annotated[int, typer.Option(help="Processes.")] = max((os.cpu_count() or 1) - 1, 1),
    salt: Annotated[str | None, typer.Option(help="Sealed with each answer; random by default.")] = None,
    faults: Annotated[
        str | None, typer.Option(help="Comma-separated names of effects, of which each case then has one.")
    ] = None,
) -> None:
    """Make recordings of robots with hidden faults, and seal the answers elsewhere.

    \b
    Examples:
      simgap blind make --out check --cases 200 --seed 2026 --answers sealed/check
      simgap blind make --out mounts --cases 20 --seed 7 --faults soft_mount,joint_elasticity
    """
    from simgap.blind.cases import SMALL
    from simgap.blind.make import make

    place = answers or out.with_name(out.name + "-answers")
    names = SMALL if robots is None else tuple(r for r in robots.split(",") if r)
    only = tuple(f for f in (faults or "").split(",") if f)
    with refusals():
        made = make(out, place, cases, seed, names, seconds, workers, salt, lambda i, n: say(f"made {i} of {n}"), only)
    typer.echo(f"{len(made['cases'])} cases in {out}, seed {seed}; answers sealed in {place}")


@blind_app.command("diagnose")
def diagnose_command(
    folder: Annotated[Path, typer.Argument(help="Folder of `make --out`.")],
    out: Annotated[Path, typer.Option(help="Folder for results.jsonl, a line a case as it comes; resumes it.")],
    workers: Annotated[int, typer.Option(help="Cases at a time.")] = 1,
    threads: Annotated[int, typer.Option(help="Of each case; 0 takes all processors.")] = 0,
    timeout: TimeoutOption = 1800.0,
    budget: BudgetOption = None,
    case: CaseOption = None,
    baselines: Annotated[bool, typer.Option(help="Also the alternatives (fit everything at once).")] = True,
    keep: KeepOption = False,
    answers: AnswersOption = None,
    executor: ExecutorOption = PROCESSES,
) -> None:
    """Diagnose all cases, each in a process that can read nothing but its own case.

    \b
    Example:
      simgap blind diagnose check --out results --workers 16 --threads 1
      simgap blind diagnose check --out results --threads 1 --executor dask:tcp://cluster:8786
    """
    from simgap.blind.run import Plan

    plan = Plan(
        cases=tuple(case or ()),
        threads=threads or None,
        baselines=baselines,
        answers=hidden_places(folder, answers),
        keep=keep,
        timeout=timeout,
        budget=budget,
        workers=workers,
        place=executor,
    )
    carry_out(folder, out, plan)


def carry_out(folder: Path, out: Path, plan: Plan) -> None:
    """Diagnose a check by a plan, telling of each case; ends the command where one failed."""
    from simgap.blind.run import results_file, run

    with refusals():
        found = run(folder, out, plan, _told)
    done = sum(r["status"] == "done" for r in found.values())
    typer.echo(f"{done} of {len(found)} diagnosed; {results_file(out)}")
    if any(r["status"] in ("failed", "refused") for r in found.values()):
        first = next(r for r in found.values() if r["status"] in ("failed", "refused"))
        _fail(f"case {first['id']} {first['status']}: {first.get('error')}", 1)


def hidden_places(folder: Path, answers: list[Path] | None) -> list[Path]:
    """Places that no diagnosing process may read: those given, and the default one where it exists."""
    usual = folder.resolve().with_name(folder.resolve().name + "-answers")
    return [*(a.resolve() for a in answers or ()), *([usual] if usual.exists() else [])]


@blind_app.command("score")
def score_command(
    folder: Annotated[Path, typer.Argument(help="Folder of `make --out`.")],
    answers: Annotated[Path, typer.Argument(help="Folder of the sealed answers.")],
    results: Annotated[Path, typer.Argument(help="Folder (or .jsonl file) of `diagnose --out`.")],
    json_: Annotated[Path | None, typer.Option("--json", help="File for the score.")] = None,
    markdown_: Annotated[Path | None, typer.Option("--markdown", help="File for the tables, as Markdown.")] = None,
) -> None:
    """Open the answers and score the results.

    \b
    Example:
      simgap blind score check sealed/check results --json score.json
    """
    from simgap.blind.score import markdown, score

    with refusals():
        scored = score(folder, answers, results)
    for path, text in ((json_, json.dumps(scored, indent=1) + "\n"), (markdown_, markdown(scored))):
        if path:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8")
    _print(scored)


@blind_app.command("calibrate")
def calibrate_command(
    folder: Annotated[Path, typer.Argument(help="Folder of `make --out`.")],
    answers: Annotated[Path, typer.Argument(help="Folder of the sealed answers.")],
    results: Annotated[Path, typer.Argument(help="Folder of `diagnose --out --keep`.")],
    json_: Annotated[Path | None, typer.Option("--json", help="File for the whole grid.")] = None,
) -> None:
    """Say which numbers of the decision (inference/calibrated.yaml) would give the truth the highest probability.

    A check that was used for this is no check of the result any more: make another one.

    \b
    Example:
      simgap blind calibrate check sealed/check results
    """
    from simgap.blind.calibrate import propose, read

    with refusals():
        found = propose(read(folder, answers, results))
    if json_:
        json_.parent.mkdir(parents=True, exist_ok=True)
        json_.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    used, best = found["in_use"], found["best"]
    typer.echo(f"{found['cases']} cases; mean log score {used['log_score']:.3f} with the numbers in use")
    typer.echo(
        f"law_error {best['law_error']:g}, sparsity {best['sparsity']:g}: {best['log_score']:.3f}, better by "
        f"{best['gain']:.3f} (standard error {best['standard_error']:.3f})"
    )


@blind_app.command("settle")
def settle_command(
    folder: Annotated[Path, typer.Argument(help="Folder of `make --out`.")],
    answers: Annotated[Path, typer.Argument(help="Folder of the sealed answers.")],
    results: Annotated[Path, typer.Argument(help="Folder of `diagnose --out`.")],
    out: Annotated[Path, typer.Option(help="Folder for the new check.")],
) -> None:
    """Run the proposed experiments of ambiguous cases on their hidden robots, as a check to diagnose and score again.

    \b
    Example:
      simgap blind settle check sealed/check results --out check_next
      simgap blind diagnose check_next --out results_next --answers sealed/check
      simgap blind score check_next sealed/check results_next
    """
    from simgap.blind.settle import settle

    with refusals():
        found = settle(folder, answers, results, out, lambda i, n: say(f"ran {i} of {n}"))
    typer.echo(f"{len(found)} cases in {out}: diagnose and score them with the same answers")


def _told(row: dict[str, Any], finished: int, total: int) -> None:
    verdict = row.get("verdict") or row["status"]
    named = ", ".join(f"{e['name']}@{e['site']}" for e in row.get("effects") or [])
    say(f"{finished}/{total} case {row['id']}: {verdict} {named} ({row['wall_s']:.0f} s)")


def say(text: str) -> None:
    """A line of progress."""
    typer.echo(text, err=True)


def _print(scored: dict[str, Any]) -> None:
    from rich.console import Console
    from rich.table import Table

    from simgap.blind.score import AIMS, TITLES, between, cell

    table = Table("what", "ours", "90 %", "n", "aim", "floor", "in sample", "fit all")
    others = scored["alternatives"]
    for name, (aim, floor) in AIMS.items():
        own = scored[name]
        interval = " to ".join(cell(v, name) for v in own["ci90"]) if own["ci90"] else "–"
        beside = [cell(others[o].get(name, {}).get("value"), name) for o in ("best_in_sample", "fit_everything")]
        row = [TITLES[name], cell(own["value"], name), interval, str(own["n"])]
        row += [between(aim, name), between(floor, name), *beside]
        table.add_row(*row)
    Console(markup=False, width=150).print(table)
    typer.echo(f"{scored['scored']} of {scored['made']} cases scored; status {scored['status']}")
