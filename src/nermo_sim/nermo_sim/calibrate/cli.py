"""The word `calibrate` of the `nermo` command."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from nermo_sim.options import RESULTS, Executor, Json, Quick, SearchRequest, Seed, Workers, check_robot

calibrate_app = typer.Typer(
    rich_markup_mode=None, add_completion=False, help="Fit the physical numbers that the thesis does not print."
)


@calibrate_app.command()
def calibrate(
    robot: Annotated[str, typer.Option(help="Name of a robot, or path of its parameter file: where it begins.")] = (
        "nermo_lite"
    ),
    seed: Seed = 0,
    quick: Quick = False,
    design: Annotated[int | None, typer.Option(min=2, help="Points spread over the bounds.")] = None,
    generations: Annotated[
        int | None, typer.Option(min=1, max=1000, help="Of the search from the best of them.")
    ] = None,
    executor: Executor = "processes",
    workers: Workers = None,
    out: Annotated[Path, typer.Option(help="Folder for trials, robot file and report, in `calibrate/`.")] = RESULTS,
    json: Json = None,
) -> None:
    """Fit what the thesis does not print to one half of its claims, and judge by the other half.

    The robot found is written to a file, for --robot of any command; nothing takes it over by itself. Trials are kept
    as they come: a calibration that was stopped goes on where it was, to the same end.

    \b
    nermo calibrate --json calibration.json
    nermo calibrate --quick --executor dask:local
    """
    from nermo_sim.calibrate.command import calibrate_robot

    check_robot(robot)
    wanted = SearchRequest(
        robot=robot,
        seed=seed,
        quick=quick,
        generations=generations,
        executor=executor,
        workers=workers,
        folder=out / "calibrate",
    )
    calibrate_robot(wanted, design, json)
