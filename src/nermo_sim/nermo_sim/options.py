"""Options that several words of the `nermo` command have."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from nermo_description.results import CommandError

Robot = Annotated[str, typer.Option(help="Name of a robot, or path of its parameter file.")]
Seed = Annotated[int, typer.Option(min=0, help="Seed of everything random.")]
Quick = Annotated[bool, typer.Option("--quick", help="Shorter and coarser, to see whether it works.")]
Json = Annotated[Path | None, typer.Option("--json", help="Write the results to this file.")]
Workers = Annotated[int | None, typer.Option(min=1, help="Processes; one a processor by default.")]
Out = Annotated[
    Path, typer.Option(help="Folder for finished runs, pictures and the report; each experiment has one in it.")
]
RESULTS = Path("results")


def check_robot(robot: str, families: Sequence[str] = ("mouse",)) -> None:
    """Nothing for a robot of these families that can be loaded. Raises CommandError (status 2)."""
    from nermo_description.robots import ParameterError, load_any_robot

    try:
        load_any_robot(robot, families)
    except ParameterError as error:
        raise CommandError(str(error), status=2) from error
