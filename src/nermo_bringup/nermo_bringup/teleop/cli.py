"""The word `play` of the `nermo` command."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Annotated

import typer

from nermo_bringup.network import NetworkOption, use_network
from nermo_bringup.recording.cli import Commands
from nermo_description.results import CommandError


def play(
    file: Annotated[Path, typer.Argument(help="Command file (.yaml), or a recording.")],
    commands: Annotated[Commands, typer.Option(help="Which commands of a recording.")] = Commands.CONTROL,
    namespace: Annotated[str, typer.Option(help="Namespace of the mouse.")] = "nermo",
    lockstep: Annotated[bool, typer.Option("--lockstep", help="For a graph in stepped mode.")] = False,
    sim_time: Annotated[
        bool | None, typer.Option(help="Follow the twin's /clock; by default, where there is one.")
    ] = None,
    network: NetworkOption = None,
) -> None:
    """Play commands into a running graph (`nermo up`), once.

    \b
    nermo play walk.yaml
    nermo play next_experiment.yaml
    nermo play recordings/today --commands servo --namespace mouse_2
    """
    from nermo_bringup.launch.executables import find_executable
    from nermo_bringup.recording.errors import RecordingError
    from nermo_bringup.teleop.script import load_script

    try:
        load_script(file, commands.value)
    except RecordingError as error:
        raise CommandError(str(error)) from error
    except ValueError as error:
        raise CommandError(str(error), status=2) from error
    player = find_executable("nermo_bringup", "command_player")
    use_network(network)
    values: dict[str, object] = {"file": str(file.absolute()), "commands": commands.value, "lockstep": lockstep}
    if sim_time is not None:
        values["use_sim_time"] = sim_time
    # JSON is YAML whose types cannot be mistaken.
    words = [word for name, value in values.items() for word in ("-p", f"{name}:={json.dumps(value)}")]
    os.execv(player, [str(player), "--ros-args", "-r", f"__ns:=/{namespace.strip('/')}", *words])
