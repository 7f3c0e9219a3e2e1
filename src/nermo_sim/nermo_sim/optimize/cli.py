"""The word `optimize` of the `nermo` command."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from nermo_sim.optimize.costs import COSTS, LIMIT_CYCLE, PARTS
from nermo_sim.options import RESULTS, Executor, Json, Quick, SearchRequest, Seed, Workers, check_robot

optimize_app = typer.Typer(
    rich_markup_mode=None, add_completion=False, help="Search gait and leg parameters on the twin for a stated cost."
)


@optimize_app.command()
def optimize(
    cost: Annotated[
        str,
        typer.Option(help="; ".join(f"{name}: {meaning}" for name, meaning in COSTS.items()) + "."),
    ] = "speed",
    weights: Annotated[
        str, typer.Option(help=f"Of a mix of {', '.join(PARTS)}, as in speed=1,roll=2; all 1 by default.")
    ] = "",
    least_speed: Annotated[
        float, typer.Option(min=0.0, max=1.0, help="Share of the thesis's speed below which a set is punished.")
    ] = 0.9,
    robot: Annotated[
        str | None,
        typer.Option(help="Name or parameter file; nermo_lite, and for limit-cycle cheetah_cub, by default."),
    ] = None,
    gait: Annotated[str, typer.Option(help="Gait of the knowledge-base that is tuned.")] = "trot",
    frequency: Annotated[float, typer.Option(help="Gait frequency in Hz; it stays.")] = 0.8,
    spine: Annotated[bool, typer.Option(help="With stride extension and offset compensation.")] = True,
    name: Annotated[
        str, typer.Option(help="Name of the saved set; default: optimized_COST, which the next search replaces.")
    ] = "",
    sets_folder: Annotated[
        Path | None, typer.Option(help="Folder of the named sets; default: where the knowledge-base looks.")
    ] = None,
    generations: Annotated[int | None, typer.Option(min=1, max=1000, help="Of the search for the cost.")] = None,
    seed: Seed = 0,
    quick: Quick = False,
    executor: Executor = "processes",
    workers: Workers = None,
    out: Annotated[Path, typer.Option(help="Folder for the rollouts and pictures, in `optimize/`.")] = RESULTS,
    json: Json = None,
    video: Annotated[bool, typer.Option(help="Of limit-cycle: also draw a video of the best gait.")] = True,
) -> None:
    """Search gait and leg parameters on the twin for a stated cost, and the front of speed against roll noise.

    What is best is judged on disturbances and a friction that the search did not see, and saved as a named set: load it
    with the service load_parameter_set, or start with it: nermo up gait_set:=optimized_speed. Rollouts are kept as they
    come; a search that was stopped goes on where it was.

    \b
    nermo optimize
    nermo optimize --cost roll --json roll.json
    nermo optimize --cost mix --weights speed=1,roll=2 --name calm
    nermo optimize --quick --executor dask:local
    nermo optimize --cost limit-cycle --generations 40      (C 3.2.4: staged fitness, particle swarm)
    """
    from nermo_sim.optimize.gait_command import GaitSearch, search_gait
    from nermo_sim.optimize.limit_cycle_command import search_limit_cycle

    request: dict[str, Any] = {
        "robot": robot or ("cheetah_cub" if cost == LIMIT_CYCLE else "nermo_lite"),
        "seed": seed,
        "quick": quick,
        "generations": generations,
        "executor": executor,
        "workers": workers,
        "folder": out / "optimize",
    }
    if cost == LIMIT_CYCLE:
        search_limit_cycle(SearchRequest(**request), json, video)
        return
    check_robot(request["robot"])
    wanted = GaitSearch(
        **request,
        cost=cost,
        weights=weights,
        least_speed=least_speed,
        gait=gait,
        frequency=frequency,
        spine=spine,
        name=name,
        sets_folder=sets_folder,
    )
    search_gait(wanted, json)
