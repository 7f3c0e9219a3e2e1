"""The word `demo` of the `nermo` command."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from nermo_bringup.network import NetworkOption, use_network


def demo(
    robot: Annotated[str, typer.Option(help="Name of a robot, or path of its parameter file.")] = "nermo_lite",
    out: Annotated[Path | None, typer.Option(help="Folder for all results; default: a new one.")] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Shorter walks.")] = False,
    video: Annotated[bool, typer.Option(help="Draw a video; needs OpenGL.")] = True,
    real_time_factor: Annotated[
        float, typer.Option(min=0.05, max=5.0, help="Simulated time over wall time; below 1 for a slow machine.")
    ] = 1.0,
    stepped: Annotated[
        bool, typer.Option("--stepped", help="The twin waits for each command: as slow as it must, and deterministic.")
    ] = False,
    seed: Annotated[
        int | None, typer.Option(min=0, help="Of the twin's sensor noise, 0 by default; with --gap the hidden mouse.")
    ] = None,
    gap: Annotated[
        bool, typer.Option("--gap", help="Find the hidden fault of a made-up mouse instead, without the graph.")
    ] = False,
    fault: Annotated[str | None, typer.Option(help="With --gap: this fault, instead of drawing one.")] = None,
    budget: Annotated[
        float | None,
        typer.Option(
            min=10.0, help="With --gap: seconds that the diagnosis may take; by default 150, more on a slow machine."
        ),
    ] = None,
    network: NetworkOption = None,
    json: Annotated[Path | None, typer.Option("--json", help="Write the results to this file.")] = None,
) -> None:
    """Walk the mouse through all it can do, in the whole ROS graph on the twin.

    It stands, walks each gait on a straight line, turns both ways by its legs and once with its spine, balances on
    three feet and sits. A recording, a table, pictures and a video tell how it went. Exit status 0 only if the mouse
    did it.

    \b
    nermo demo
    nermo demo --quick --out /tmp/demo --json demo.json
    nermo demo --gap                                       # a fault is drawn, recorded, diagnosed, and then revealed
    """
    from rich.console import Console

    from nermo_bringup.demo.command import Settings, run_demo

    if fault is not None and not gap:
        raise typer.BadParameter("--fault goes with --gap")
    if gap:
        raise typer.Exit(_hidden_mouse(robot, seed, out, fault, budget))
    use_network(network)
    settings = Settings(robot, out, quick, real_time_factor, stepped, video, seed or 0)
    raise typer.Exit(0 if run_demo(settings, json, Console(markup=False)) else 1)


def _hidden_mouse(robot: str, number: int | None, out: Path | None, fault: str | None, budget: float | None) -> int:
    """Exit status: 0 where a mouse was recorded, diagnosed and revealed, whatever came out."""
    import secrets

    from nermo_bringup.recording.taps import dated_directory
    from nermo_gap.blind.mice.show import demonstrate

    chosen = secrets.randbelow(10_000) if number is None else number
    return demonstrate(robot, chosen, out or dated_directory(Path("demo")), fault, budget)
