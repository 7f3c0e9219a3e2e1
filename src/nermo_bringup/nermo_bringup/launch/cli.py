"""The words `up` and `launch` of the `nermo` command."""

from __future__ import annotations

from typing import Annotated

import typer

from nermo_bringup.network import NetworkOption, use_network


def launch_file(
    package: Annotated[str, typer.Argument(help="A package, or the path of a launch file.")],
    file: Annotated[str | None, typer.Argument(help="Name of a launch file of the package.")] = None,
    arguments: Annotated[list[str] | None, typer.Argument(metavar="[NAME:=VALUE]...")] = None,
    show_args: Annotated[bool, typer.Option("--show-args", "-s", help="Show the file's arguments only.")] = False,
    network: NetworkOption = None,
) -> None:
    """Start the nodes of an XML launch file, as `ros2 launch` does, until Ctrl-C.

    \b
    nermo launch nermo_bringup nermo.launch.xml
    nermo launch nermo_bringup nermo.launch.xml robot:=nermo namespace:=mouse_2
    nermo launch nermo_bringup nermo.launch.xml --show-args
    """
    from nermo_bringup.launch.command import launch_words

    words = [word for word in (file, *(arguments or [])) if word is not None]
    if not show_args:
        use_network(network)
    raise typer.Exit(launch_words(package, words, show_args=show_args))


def up(
    robot: Annotated[str, typer.Option(help="nermo, nermo_lite, cheetah_cub, or a parameter file.")] = "nermo_lite",
    target: Annotated[
        str, typer.Option(help="sim: the MuJoCo twin. serial: the robot at a cable. link: over Wi-Fi.")
    ] = "sim",
    record: Annotated[
        str, typer.Option(metavar="DIR", help="Record every topic into this folder, or what record_include:= says.")
    ] = "",
    web: Annotated[bool, typer.Option("--web", help="See and drive the mouse in the browser.")] = False,
    web_host: Annotated[
        str, typer.Option(metavar="HOST", help="With --web: 0.0.0.0 opens the page to who has its token.")
    ] = "127.0.0.1",
    web_port: Annotated[int, typer.Option(metavar="PORT", help="With --web: where the page is.")] = 8080,
    network: NetworkOption = None,
    arguments: Annotated[list[str] | None, typer.Argument(metavar="[NAME:=VALUE]...")] = None,
) -> None:
    """Bring the whole graph up and keep it up until Ctrl-C.

    Further arguments are those of nermo.launch.xml (nermo launch nermo_bringup nermo.launch.xml --show-args).

    \b
    nermo up
    nermo up --robot nermo --record recordings/today
    nermo up --record recordings/walk record_include:='/nermo/odom /nermo/servo_*'
    nermo up --robot cheetah_cub
    nermo up --web
    nermo up teleop:=none real_time_factor:=0.5
    """
    from nermo_bringup.launch.command import bring_up

    page = [f"web:={str(web).lower()}", f"web_host:={web_host}", f"web_port:={web_port}"] if web else []
    raise typer.Exit(bring_up(robot, target, record, [*page, *(arguments or [])], network))
