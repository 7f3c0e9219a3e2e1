"""The word `bench` of the `nermo` command: what is measured of the twin, the controller and the sensors."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from nermo_description.results import CommandError, write_results
from nermo_sim.console import console, print_facts
from nermo_sim.options import Json, Quick, Robot, check_robot

Facts = dict[str, Any]

bench_app = typer.Typer(
    rich_markup_mode=None,
    add_completion=False,
    subcommand_metavar="",
    context_settings={"allow_interspersed_args": True},
    help="Measure: the control tick, the in-process loop, the ROS graph.",
)


def _tick(robot: str, quick: bool) -> Facts:
    from nermo_sim.bench.loop import BenchSettings, bench_tick

    return bench_tick(BenchSettings(robot, duration=4.0 if quick else 20.0))


def _loop(robot: str, quick: bool) -> Facts:
    from nermo_sim.bench.loop import BenchSettings, bench_loop

    return bench_loop(BenchSettings(robot, duration=4.0 if quick else 20.0))


def _graph(robot: str, quick: bool) -> Facts:
    from nermo_sim.nodes.bench_graph import bench_graph

    return bench_graph(robot, duration=5.0 if quick else 20.0)


def _sensors(robot: str, quick: bool) -> Facts:
    from nermo_sensors.bench.command import bench_sensors

    return bench_sensors(quick=quick, pictures=Path("results/sensors"))


def _loads(robot: str, quick: bool) -> Facts:
    from nermo_sim.bench.loads import bench_loads
    from nermo_sim.nodes.bench_loads_graph import bench_loads_graph

    duration = 6.0 if quick else 30.0
    alone, graph = bench_loads(robot, duration), bench_loads_graph(robot, duration)
    return {**alone, **graph, "loads": [*alone["loads"], *graph["loads"]]}


BENCHES: dict[str, Callable[[str, bool], Facts]] = {
    "tick": _tick,
    "loop": _loop,
    "graph": _graph,
    "sensors": _sensors,
    "loads": _loads,
}
"""Measurements by name: each takes the robot, and whether it shall be quick."""


@bench_app.callback(invoke_without_command=True)
def bench(
    what: Annotated[list[str] | None, typer.Argument(help=f"{', '.join(BENCHES)}; all by default.")] = None,
    robot: Robot = "nermo_lite",
    quick: Quick = False,
    json: Json = None,
) -> None:
    """Measure: the control tick, the in-process loop, the ROS graph.

    \b
    nermo bench
    nermo bench tick loop
    nermo bench graph --json graph.json
    """
    check_robot(robot)
    names = tuple(BENCHES) if not what or "all" in what else tuple(what)
    facts: Facts = {}
    for name in names:
        with console.status(f"measuring: {name}"):
            found = run_bench(name, robot, quick)
        print_facts(name, found)
        facts.update(found)
    if json is not None:
        write_results(json, "bench", facts, robot=robot)


def run_bench(name: str, robot: str = "nermo_lite", quick: bool = False) -> Facts:
    """Runs one measurement.

    Raises CommandError with status 2 for an unknown name.
    """
    if name not in BENCHES:
        known = f"{', '.join(BENCHES)} and all (--help names more)"
        raise CommandError(f"bench {name!r} is unknown: choose among {known}", status=2)
    return BENCHES[name](robot, quick)
