"""Options that several words of the `nermo` command have."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from nermo_description.results import CommandError
from simgap.execution.executors import HELP as EXECUTOR
from simgap.execution.executors import processors

Robot = Annotated[str, typer.Option(help="Name of a robot, or path of its parameter file.")]
Seed = Annotated[int, typer.Option(min=0, help="Seed of everything random.")]
Quick = Annotated[bool, typer.Option("--quick", help="Shorter and coarser, to see whether it works.")]
Json = Annotated[Path | None, typer.Option("--json", help="Write the results to this file.")]
Workers = Annotated[int | None, typer.Option(min=1, help="Processes; one a processor by default.")]
Out = Annotated[
    Path, typer.Option(help="Folder for finished runs, pictures and the report; each experiment has one in it.")
]
Executor = Annotated[str, typer.Option(help=EXECUTOR)]
RESULTS = Path("results")


@dataclass(frozen=True, slots=True, kw_only=True)
class SearchRequest:
    """What the user asks of any search with rollouts of a robot."""

    robot: str
    seed: int
    quick: bool
    generations: int | None
    executor: str
    workers: int | None
    folder: Path
    """Where rollouts and pictures are kept."""

    @property
    def processes(self) -> int:
        """How many work at once."""
        return self.workers or processors()


def check_robot(robot: str, families: Sequence[str] = ("mouse",)) -> None:
    """Nothing for a robot of these families that can be loaded. Raises CommandError (status 2)."""
    from nermo_description.robots import ParameterError, load_any_robot

    try:
        load_any_robot(robot, families)
    except ParameterError as error:
        raise CommandError(str(error), status=2) from error
