"""The word `drive` of the `nermo` command."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from nermo_bringup.network import NetworkOption, use_network


def drive(
    robot: Annotated[
        str, typer.Option(help="nermo, nermo_lite, a mouse's parameter file, or cheetah_cub.")
    ] = "nermo_lite",
    scene: Annotated[str, typer.Option(help="Scene of the twin: a name, or an MJCF file.")] = "flat",
    pad: Annotated[str, typer.Option(help="Which gamepad it is, if one is plugged in.")] = "xbox",
    record: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder of the recording; default: a new one in recordings/.")
    ] = None,
    no_record: Annotated[bool, typer.Option("--no-record", help="Keep nothing.")] = False,
    web: Annotated[bool, typer.Option("--web", help="See and drive the mouse in the browser too.")] = False,
    web_port: Annotated[int, typer.Option(metavar="PORT", help="With --web: where the page is.")] = 8080,
    network: NetworkOption = None,
) -> None:
    """Bring the twin up and drive it with the keys of this terminal, or with a gamepad that is plugged in.

    The keys are shown as soon as the mouse stands. q ends all, and says how far it went and where the recording is.

    \b
    nermo drive
    nermo drive --robot nermo --scene maze
    nermo drive --record recordings/first_steps
    nermo drive --robot cheetah_cub --no-record
    """
    from nermo_bringup.drive.session import Settings, drive_twin

    use_network(network)
    drive_twin(Settings(robot, scene, pad, record, not no_record, web_port if web else None))
