"""The word `bench web` of the `nermo` command."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated

import typer

from nermo_description.results import write_results
from nermo_sim.options import Robot, check_robot

bench_app = typer.Typer(
    no_args_is_help=True,
    rich_markup_mode=None,
    add_completion=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


@bench_app.callback()
def bench() -> None:
    """Measure what the page in the browser costs."""


@bench_app.command("web")
def bench_web(
    viewers: Annotated[list[int] | None, typer.Option(min=0, max=50, help="How many look; may be repeated.")] = None,
    seconds: Annotated[float, typer.Option(min=1.0, help="Time for each row, in seconds.")] = 20.0,
    robot: Robot = "nermo_lite",
    json: Annotated[Path | None, typer.Option("--json", help="Write the results to this file.")] = None,
) -> None:
    """Walk the graph without the page, then with it before 0, 1 and 3 viewers: its cost, and the age of commands.

    Viewers are processes that take what a browser takes and draw nothing. They share this machine with the graph.

    \b
    nermo bench web
    nermo bench web --viewers 1 --seconds 600 --json web.json
    """
    from rich.console import Console
    from rich.table import Table

    from nermo_bringup.nodes.bench_web import bench_web as measure

    check_robot(robot)
    console = Console(markup=False)
    counts = viewers if viewers else [0, 1, 3]
    rows = measure(robot, counts, seconds, lambda what: console.print(f"{what}, {seconds:g} s", highlight=False))
    table = Table(title=f"the page of {robot}, {seconds:g} s a row")
    table.add_column("viewers", no_wrap=True)
    for column in ("web [% of a core]", "web [MB]", "to each [kB/s]", "age [ms]: p50", "p99", "max", "[Hz]"):
        table.add_column(column, justify="right")
    for row in rows:
        table.add_row(
            "no page" if row.viewers is None else str(row.viewers),
            "-" if row.web_percent is None else f"{row.web_percent:.1f}",
            "-" if row.web_mb is None else f"{row.web_mb[0]:.0f}-{row.web_mb[1]:.0f}",
            "-" if row.kb_s is None else f"{row.kb_s:.0f}",
            *(f"{row.age_ms[key]:.1f}" for key in ("p50", "p99", "max")),
            f"{row.rate_hz:.0f}",
        )
    console.print(table)
    if json is not None:
        facts = {"seconds": seconds, "rows": [dataclasses.asdict(row) for row in rows]}
        write_results(json, "bench-web", facts, robot=robot)
