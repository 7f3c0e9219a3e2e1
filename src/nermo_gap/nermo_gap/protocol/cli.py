"""The words `gap record` and `gap detectability` of the `nermo` command."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from nermo_gap.console import refusals
from simgap.console import fail, progress, writable

if TYPE_CHECKING:
    from nermo_gap.protocol.through_graph import ThroughGraph

Port = Annotated[
    str, typer.Option(help="With --target: where the robot is; twin is an emulated device with the twin behind it.")
]
Calibration = Annotated[
    Path | None,
    typer.Option(exists=True, dir_okay=False, help="With --target serial: the file that nermo hw calibrate wrote."),
]

_through_graph: list[ThroughGraph] = []


def hand_in(through_graph: ThroughGraph) -> None:
    """Who has a graph hands in what plays a protocol through it."""
    _through_graph[:] = [through_graph]


def through_graph() -> ThroughGraph:
    """What was handed in; ends the command where nothing was."""
    if not _through_graph:
        fail("--target needs the graph: call this as nermo gap", 2)
    return _through_graph[0]


def record_command(
    out: Annotated[Path, typer.Option(help="New folder for the recordings, one folder in it for each segment.")],
    robot: Annotated[str, typer.Option(help="nermo, nermo_lite or a parameter file.")] = "nermo_lite",
    protocol: Annotated[str, typer.Option(help="standard, or walk: a minute of walking alone.")] = "standard",
    hidden: Annotated[
        int | None, typer.Option(min=0, help="Record hidden mouse NUMBER, whose fault lies sealed beside.")
    ] = None,
    fault: Annotated[str | None, typer.Option(help="With --hidden: the fault, instead of drawing one.")] = None,
    markers: Annotated[
        bool, typer.Option("--markers", help="The tracker sees a marker at each foot and at the rear torso too.")
    ] = False,
    film: Annotated[
        bool, typer.Option("--film", help="You film it: a walk begins with what tells the film's clock.")
    ] = False,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the sensors' noise.")] = 0,
    target: Annotated[
        Literal["sim", "serial", "link"] | None,
        typer.Option(help="Through the graph: on the twin, a robot at a cable, over Wi-Fi."),
    ] = None,
    port: Port = "twin",
    calibration: Calibration = None,
    dead_man: Annotated[
        Literal["space", "pad", "none"] | None,
        typer.Option(help="Held while the mouse moves. Default: the space bar; nothing where it is the twin."),
    ] = None,
    pad: Annotated[str, typer.Option(help="With --dead-man pad: which gamepad it is.")] = "xbox",
) -> None:
    """Play an experiment protocol: hung in a stand, standing, walking, still. `diagnose OUT` reads it.

    Without --target it is the twin's, in process and in seconds. With it each segment goes through a graph of its own:
    it says what to prepare, what comes next, and repeats a piece in which the space bar was let go.

    \b
    Examples:
      nermo gap record --protocol standard --out recordings/today
      nermo gap record --target serial --port /dev/ttyUSB0 --calibration my_robot.yaml --out recordings/today
      nermo gap diagnose recordings/today
      nermo gap record --hidden 7 --out mouse7
      nermo gap record --hidden 7 --markers --out mouse7
    """
    if fault is not None and hidden is None:
        fail("--fault goes with --hidden NUMBER", 2)
    with refusals():
        from nermo_description.robots import load_robot
        from nermo_gap.blind.mice.mouse import draw
        from nermo_gap.blind.mice.seal import Answer, seal
        from nermo_gap.protocol.play import Body
        from nermo_gap.protocol.record import record
        from nermo_gap.protocol.standard import protocol_of
        from nermo_gap.protocol.through_graph import Request

        parameters = load_robot(robot)
        chosen = protocol_of(protocol, parameters, markers, film)
        if target is not None:
            if hidden is not None:
                fail("--hidden is a mouse that is played in process: it does not go with --target", 2)
            asked = Request(chosen, parameters, robot, out, target, port, calibration, dead_man, pad, seed)
            if markers and asked.on_twin:
                fail("--markers: the twin in the graph wears none; leave --target out, or give the robot's --port", 2)
            folders = through_graph()(asked)
        else:
            twin = Body.twin(parameters, markers)
            body, wrong = (twin, None) if hidden is None else draw(parameters, hidden, fault, markers)
            with progress("record") as say:
                folders = record(chosen, body, out, seed, say)
            if hidden is not None and wrong is not None:
                seal(Answer.of(robot, hidden, wrong), out)
    typer.echo(f"{protocol}: {chosen.seconds:.0f} s of {parameters.name} in {len(folders)} segments")
    typer.echo(f"next: nermo gap diagnose {out}")


def detectability_command(
    robot: Annotated[str, typer.Option(help="nermo, nermo_lite or a parameter file.")] = "nermo_lite",
    protocol: Annotated[str, typer.Option(help="standard or walk.")] = "standard",
    sensors: Annotated[
        str,
        typer.Option(help="Of servos, knees, gyro, tracker, markers, with commas; by default what the robot has."),
    ] = "",
    json_: Annotated[Path | None, typer.Option("--json", help="File for the table.")] = None,
) -> None:
    """Say from which size on a protocol would show each effect of a mouse, in which piece and to which sensor.

    \b
    Example:
      nermo gap detectability --robot nermo_lite --protocol standard
      nermo gap detectability --robot nermo --sensors tracker,gyro
    """
    with refusals():
        from rich.console import Console
        from rich.table import Table

        from nermo_description.robots import load_robot
        from nermo_gap.protocol.detectable import channels_of, detectable
        from nermo_gap.protocol.standard import protocol_of
        from simgap.analysis.diagnose import write_report
        from simgap.console import size_of

        writable(None, json_)
        parameters = load_robot(robot)
        channels = channels_of(sensors, parameters)
        rows = detectable(parameters, protocol_of(protocol, parameters, channels.markers), channels)
    table = Table("effect", "site", "from", "seen most in", "by", "not told from")
    for row in rows:
        found = row.found
        smallest = "does not show" if found.smallest is None else f"{found.parameter} {size_of(found)}"
        table.add_row(found.effect, found.site, smallest, row.piece, found.sensor, found.rival or "")
    Console(markup=False).print(table)
    if json_ is not None:
        told = {"schema": "nermo_gap/detectability/1", "robot": parameters.name, "protocol": protocol}
        write_report({**told, "rows": [row.report() for row in rows]}, json_)
