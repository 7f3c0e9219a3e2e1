"""The words `replay` and `repair` of the `nermo` command."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from nermo_description.results import CommandError, write_results


class Commands(StrEnum):
    """Which commands of a recording."""

    SERVO = "servo"
    CONTROL = "control"


def replay(
    recording: Annotated[Path, typer.Argument(help="Directory or .mcap file of a recording.")],
    commands: Annotated[
        Commands, typer.Option(help="servo: what the servos were told. control: what the operator wanted.")
    ] = Commands.SERVO,
    robot: Annotated[str, typer.Option(help="Name or parameter file; default: the recorded robot.")] = "",
    out: Annotated[Path | None, typer.Option(help="Write recorded and replayed side by side into this .csv.")] = None,
    json: Annotated[Path | None, typer.Option("--json", help="Write the results to this file.")] = None,
    web: Annotated[bool, typer.Option("--web", help="See what was recorded in the browser, in its own time.")] = False,
    web_host: Annotated[
        str, typer.Option(metavar="HOST", help="With --web: 0.0.0.0 opens the page to who has its token.")
    ] = "127.0.0.1",
    web_port: Annotated[
        int, typer.Option(metavar="PORT", min=0, max=65535, help="With --web: where the page is; 0: any that is free.")
    ] = 8080,
) -> None:
    """Feed a recording's commands to a fresh twin and say how far it is from what was recorded.

    With --web it is shown instead, until Ctrl-C, again and again.

    \b
    nermo replay recordings/today
    nermo replay recordings/today --commands control --out comparison.csv
    nermo replay recordings/today --web
    """
    if web:
        _show(recording, robot, web_host, web_port, compared=out is not None or json is not None)
    from rich.console import Console
    from rich.progress import Progress
    from rich.table import Table

    from nermo_bringup.recording.errors import RecordingError
    from nermo_bringup.recording.replay import POSE, recorded_robot, replay_controls, replay_servos
    from nermo_control.gait.knowledge_base import GaitParameters
    from nermo_description.robots import load_robot
    from nermo_node.recording_reader import Recording

    console = Console(markup=False)
    try:
        source = Recording(recording)
        parameters = load_robot(robot or recorded_robot(source) or "nermo_lite")
        with Progress(console=console, transient=True) as bar:
            task = bar.add_task("replaying", total=None)

            def progress(done: int, total: int) -> None:
                bar.update(task, completed=done, total=total)

            if commands is Commands.SERVO:
                comparison = replay_servos(source, parameters, progress)
            else:
                comparison = replay_controls(source, parameters, GaitParameters(), progress)
        if out is not None:
            comparison.save(out)
    except RecordingError as error:
        raise CommandError(str(error)) from error
    differences = comparison.servo_difference()
    pose = comparison.final_pose_difference()
    cut = "" if source.complete else " (cut off; read up to the cut)"
    table = Table(title=f"{source.path.name}{cut} on a fresh twin of {parameters.name}, {comparison.time[-1]:.1f} s")
    table.add_column("servo")
    table.add_column("recorded to replayed, RMS [rad]", justify="right")
    for servo, difference in zip(comparison.servos, differences, strict=True):
        table.add_row(servo, f"{difference:.5f}")
    console.print(table)
    ends = ", ".join(
        f"{name} {value:+.4f} {'rad' if name == 'yaw' else 'm'}" for name, value in zip(POSE, pose, strict=True)
    )
    console.print(f"base_link at the end, replayed less recorded: {ends}", highlight=False)
    if json is not None:
        facts = {
            "recording": source.path,
            "complete": source.complete,
            "commands": commands.value,
            "duration_s": float(comparison.time[-1]),
            "servo_rms_rad": dict(zip(comparison.servos, differences.tolist(), strict=True)),
            "final_difference": {"x_m": pose[0], "y_m": pose[1], "yaw_rad": pose[2]},
        }
        write_results(json, "replay", facts, robot=parameters.name)


def _show(path: Path, robot: str, host: str, port: int, compared: bool) -> None:
    """In the browser; ends the command."""
    from nermo_bringup.network import use_network
    from nermo_bringup.nodes.shown_recording import show
    from nermo_bringup.recording.errors import RecordingError
    from nermo_bringup.recording.replay import recorded_robot
    from nermo_node.recording_reader import Recording

    if compared:
        raise CommandError("--web shows what was recorded and compares nothing: leave --out and --json out", status=2)
    use_network("localhost")
    try:
        source = Recording(path)
        source.topic_ending("odom")
        raise typer.Exit(show(source, robot or recorded_robot(source) or "nermo_lite", host, port))
    except RecordingError as error:
        raise CommandError(str(error)) from error


def repair(
    recording: Annotated[Path, typer.Argument(help="Directory of a recording whose recorder was killed.")],
) -> None:
    """Give a cut recording its index and metadata.yaml back, so that `ros2 bag` and Foxglove open it.

    What the file was before stays beside it, with .orig at the end of its name.

    \b
    nermo repair recordings/today
    """
    from rich.console import Console
    from rich.progress import Progress

    from nermo_bringup.recording import repair as repairing
    from nermo_bringup.recording.errors import RecordingError

    try:
        with Progress(console=Console(markup=False, stderr=True), transient=True) as bar:
            task = bar.add_task("repairing", total=None)
            done = repairing.repair(recording, lambda now, total: bar.update(task, completed=now, total=total))
    except RecordingError as error:
        raise CommandError(str(error)) from error
    if done.damaged_chunks:
        typer.echo(f"{done.damaged_chunks} damaged chunks are left out: their checksum does not hold")
    if done.backup is None:
        typer.echo(f"{recording} is whole, with {done.message_count} messages; its file is as it was")
    else:
        typer.echo(f"{recording} is whole, with {done.message_count} messages; the cut file is kept as {done.backup}")
