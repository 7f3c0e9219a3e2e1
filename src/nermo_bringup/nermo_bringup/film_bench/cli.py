"""The word `bench film` of the `nermo` command."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from nermo_description.results import write_results
from nermo_track.telling import print_rows, told

bench_app = typer.Typer(
    no_args_is_help=True,
    rich_markup_mode=None,
    add_completion=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

FAULTS = (
    "none",
    "slippery_feet",
    "late_hips",
    "heavy_torso",
    "com_back",
    "soft_ankles",
    "weak_knee",
    "draught",
)


@bench_app.callback()
def bench() -> None:
    """Measure what a film alone tells of a mouse."""


@bench_app.command("film")
def bench_film(
    out: Annotated[Path, typer.Option(help="Folder: one folder in it for each mouse.")],
    fault: Annotated[
        list[str] | None, typer.Option(help="One mouse with this fault; may be repeated. By default eight mice.")
    ] = None,
    number: Annotated[
        int, typer.Option(min=0, help="Of the first mouse; it decides by how much its other numbers are off.")
    ] = 201,
    budget: Annotated[float, typer.Option(min=1.0, help="Seconds that each diagnosis may take.")] = 1500.0,
    robot: Annotated[str, typer.Option(help="nermo, nermo_lite or a parameter file.")] = "nermo_lite",
    json: Annotated[Path | None, typer.Option("--json", help="Write the results to this file.")] = None,
) -> None:
    """Film hidden mice, track them, diagnose what was tracked, open the seals: which faults does a film alone find?

    A mouse takes ten to twenty minutes. What each step takes and leaves is kept: the films, what the servos were told
    (told), the poses beside it (filmed), the page (diagnosis). When it is stopped, the same command goes on there.

    \b
    nermo bench film --out filmed_mice
    nermo bench film --fault late_hips --fault none --out two_mice --json two_mice.json
    """
    from nermo_bringup.film_bench.whole_way import whole_way
    from nermo_description.robots import load_robot
    from nermo_gap.blind.mice.mouse import draw
    from nermo_gap.console import refusals
    from nermo_track.errors import TrackError
    from simgap.console import progress, silence

    rows: list[dict[str, object]] = []
    with told(), refusals():
        parameters = load_robot(robot)
        mice = list(enumerate(fault or FAULTS, start=number))
        for mouse, kind in mice:
            draw(parameters, mouse, kind)  # refuses a fault that is none before hours have passed
        for mouse, kind in mice:
            typer.echo(f"mouse {mouse}: film, track, diagnose")
            try:
                with silence() as terminal, progress("film", terminal) as say:
                    folder = out / f"{parameters.name}_{mouse}_{kind}"
                    row = whole_way(parameters, robot, mouse, kind, folder, budget, say)
            except TrackError as error:
                typer.echo(f"mouse {mouse}: {error}", err=True)
                rows.append({"mouse": mouse, "untracked": str(error)})
            else:
                rows.append(row)
                print_rows([row])
            if json is not None:
                write_results(json, "bench-film", {"rows": rows, "budget": budget}, robot=robot, seed=number)
