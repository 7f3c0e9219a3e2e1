"""The words `hw` and `bench serial` of the `nermo` command."""

from __future__ import annotations

import signal
import sys
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from nermo_description.results import CommandError, write_results

# Files and pipes have no width; the tables need one.
_console = Console(width=None if sys.stdout.isatty() else 160)

_HELP = {"help_option_names": ["-h", "--help"]}
Robot = Annotated[str, typer.Option(help="Name of a robot, or path of its parameter file.")]
Port = Annotated[
    str, typer.Option(help="A device path, usb:VID:PID[:SERIAL], or a URL of pyserial such as socket://host:port.")
]
Json = Annotated[Path | None, typer.Option("--json", help="Write the results to this file.")]

hw_app = typer.Typer(
    no_args_is_help=True,
    rich_markup_mode=None,
    add_completion=False,
    context_settings=_HELP,
    help="The real robot: look at it, calibrate it, emulate it.",
)
bench_app = typer.Typer(
    no_args_is_help=True,
    rich_markup_mode=None,
    add_completion=False,
    context_settings=_HELP,
    help="Measure the robot's lines.",
)


@hw_app.callback()
def hw() -> None:
    """The real robot: look at it, calibrate it, emulate it."""


@bench_app.callback()
def bench() -> None:
    """Measure the robot's lines."""


@hw_app.command("emulate")
def emulate(
    robot: Robot = "nermo_lite",
    link: Annotated[str, typer.Option(help="Where the pseudo-terminal shall be found; empty: none.")] = "",
    tcp_port: Annotated[int, typer.Option(help="Listen at this port for socket://; 0: any, -1: none.")] = -1,
    mounting: Annotated[str, typer.Option(help="Calibration file that says how the servos sit.")] = "",
    store: Annotated[str, typer.Option(help="YAML file of the non-volatile registers.")] = "",
    clock_ppm: Annotated[float, typer.Option(help="How much too fast the device's clocks run.")] = 0.0,
    seed: Annotated[int, typer.Option(min=0, help="Seed of everything random.")] = 0,
) -> None:
    """Be the robot's electronics on a pseudo-terminal or a TCP port, until Ctrl-C.

    The servos stand on a bench; `nermo up --target serial` puts the twin behind them.

    \b
    nermo hw emulate --link /tmp/mouse
    nermo hw emulate --robot nermo --tcp-port 3333
    """
    from pydantic import ValidationError

    from nermo_hw.device.setup import EmulatorSettings, make_emulator

    try:
        settings = EmulatorSettings(
            robot=robot, link=link, tcp_port=tcp_port, mounting=mounting, store=store, clock_ppm=clock_ppm, seed=seed
        )
        emulator = make_emulator(settings)
    except ValidationError as error:
        fault = error.errors()[0]
        raise CommandError(f"{fault['loc'][0]} = {fault['input']!r}: {fault['msg']}.", status=2) from error
    except ValueError as error:
        raise CommandError(str(error), status=2) from error
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: emulator.stop())
    places = [link] if link else []
    places += [f"socket://{settings.tcp_host}:{emulator.port}"] if tcp_port >= 0 else []
    print(f"an emulated {robot} is at {' and '.join(places)}", flush=True)
    emulator.run()


def show_json(path: Path | None, name: str, facts: dict[str, Any], **head: Any) -> None:
    """Writes results where they are wanted."""
    if path is not None:
        write_results(path, name, facts, **head)
