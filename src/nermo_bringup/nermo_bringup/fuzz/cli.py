"""The word `bench fuzz` of the `nermo` command."""

from __future__ import annotations

import dataclasses
import os
import tempfile
from pathlib import Path
from typing import Annotated

import typer

from nermo_description.results import CommandError, write_results

bench_app = typer.Typer(
    no_args_is_help=True,
    rich_markup_mode=None,
    add_completion=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

DOMAIN = "96"
"""A ROS domain of its own, unless one is chosen: another graph on this machine shall not be thrown at."""


@bench_app.callback()
def bench() -> None:
    """Measure what the nodes stand."""


@bench_app.command("fuzz")
def bench_fuzz(
    seconds: Annotated[float, typer.Option(min=1.0, help="Time for each node, in seconds.")] = 60.0,
    node: Annotated[list[str] | None, typer.Option(help="Only nodes of this executable; may be repeated.")] = None,
    seed: Annotated[int, typer.Option(help="What is thrown, and when.")] = 0,
    json: Annotated[Path | None, typer.Option("--json", help="Write the results to this file.")] = None,
) -> None:
    """Throw spoiled messages at every subscription of every node, and say what became of the nodes.

    Numbers of all magnitudes, lengths, names, enumerations and stamps, and messages cut short. Fails where a node ends,
    hangs, or takes over 50 ms for one message each time that it gets it.

    \b
    nermo bench fuzz
    nermo bench fuzz --node high_level_controller --seconds 600
    """
    from rich.console import Console
    from rich.table import Table

    from nermo_bringup.fuzz.subjects import subjects
    from nermo_bringup.nodes.fuzz import LONGEST_STALL, fuzz
    from nermo_node.network import loopback

    os.environ.setdefault("ROS_DOMAIN_ID", DOMAIN)
    os.environ.update(loopback(os.environ))
    console = Console(markup=False)
    outcomes = []
    with tempfile.TemporaryDirectory() as folder:
        chosen = [subject for subject in subjects(Path(folder)) if not node or subject.executable in node]
        if not chosen:
            known = ", ".join(sorted({subject.executable for subject in subjects(Path(folder))}))
            raise CommandError(f"--node {', '.join(node or [])}: there is no such node; there are: {known}.", status=2)
        for number, subject in enumerate(chosen, start=1):
            console.print(f"{number} of {len(chosen)}: {subject.name}, {seconds:g} s", highlight=False)
            outcomes.append(fuzz(subject, seconds, seed))
    table = Table(title=f"spoiled messages, {seconds:g} s a node, seed {seed}")
    table.add_column("node")
    for column in ("topics", "messages", "refused", "ended", "longest stall [ms]", "once [ms]"):
        table.add_column(column, justify="right")
    for outcome in outcomes:
        table.add_row(
            outcome.node,
            str(len(outcome.subscriptions)),
            str(outcome.messages),
            "-" if outcome.refusals is None else str(outcome.refusals),
            str(len(outcome.exits)),
            f"{outcome.longest_stall_s * 1e3:.1f}",
            f"{outcome.longest_once_s * 1e3:.1f}",
        )
    console.print(table)
    if json is not None:
        rows = [dataclasses.asdict(outcome) for outcome in outcomes]
        write_results(json, "bench-fuzz", {"seconds": seconds, "rows": rows}, seed=seed)
    bad = [f"{outcome.node} ended: {outcome.exits[0]}" for outcome in outcomes if outcome.exits]
    bad += [
        f"{outcome.node} took {outcome.longest_stall_s * 1e3:.0f} ms for a message on {outcome.worst}"
        for outcome in outcomes
        if outcome.longest_stall_s > LONGEST_STALL
    ]
    if bad:
        raise CommandError("; ".join(bad))
