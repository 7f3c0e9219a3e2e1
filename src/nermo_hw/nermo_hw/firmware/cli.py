"""The word `bench firmware` of the `nermo` command."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from nermo_description.results import CommandError, write_results

bench_app = typer.Typer(
    no_args_is_help=True,
    rich_markup_mode=None,
    add_completion=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


@bench_app.callback()
def bench() -> None:
    """Measure the firmware of Nermo-Lite's board."""


@bench_app.command("firmware")
def bench_firmware(
    size: Annotated[int, typer.Option("--bytes", min=1000, help="So many bytes to fuzz with.")] = 10_000_000,
    trials: Annotated[int, typer.Option(min=1, max=10_000, help="Silences to time.")] = 200,
    real_time: Annotated[
        float, typer.Option(min=0.5, max=3600.0, help="Of the exchanges in real time, in seconds.")
    ] = 10.0,
    quick: Annotated[bool, typer.Option("--quick", help="500 000 bytes, 20 silences, 2 real seconds.")] = False,
    seed: Annotated[int, typer.Option(min=0, help="Seed of everything random.")] = 0,
    json: Annotated[Path | None, typer.Option("--json", help="Write the results to this file.")] = None,
) -> None:
    """Fuzz the firmware of Nermo-Lite's board under sanitizers, time its silences in virtual time, and its speed here.

    Needs a C++ compiler, and no board.

    \b
    nermo bench firmware
    nermo bench firmware --bytes 100000000 --json firmware.json
    """
    from rich.console import Console

    from nermo_hw.firmware.bench import bench_firmware as run
    from nermo_hw.firmware.build import FirmwareError

    exchanges = 100_000 if quick else 1_000_000
    size, trials, real_time = (500_000, 20, 2.0) if quick else (size, trials, real_time)
    try:
        facts = run(size, seed, trials, exchanges, real_time, lambda what: print(what, file=sys.stderr, flush=True))
    except FirmwareError as error:
        raise CommandError(f"{error}.") from error
    console = Console(width=None if sys.stdout.isatty() else 160)
    _print(console, "fuzzed, with address and undefined-behaviour sanitizers", facts["fuzz"])
    silences = {
        row["state"]: ", ".join(f"{key} {value}" for key, value in row.items() if key != "state")
        for row in facts["silences"]
    }
    _print(console, f"from the last good frame to the state, {trials} times in virtual time", silences)
    _print(console, "an exchange on the line", facts["line"])
    _print(console, "an exchange of the driver on a pseudo-terminal, real time", facts["real_time"])
    each = {"exchanges_a_second": facts["exchanges_a_second_on_this_machine"]}
    _print(console, "the logic alone on this machine", each)
    if json is not None:
        write_results(json, "bench-firmware", facts, robot="nermo_lite", seed=seed)
    if not facts["passed"]:
        raise CommandError("the firmware did what it must not.")


def _print(console: Any, title: str, facts: Mapping[str, Any]) -> None:
    from rich.table import Table

    table = Table(title=title, title_justify="left", show_header=False, min_width=len(title))
    for key, value in facts.items():
        table.add_row(key, _text(value))
    console.print(table)


def _text(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{key} {_text(part)}" for key, part in value.items())
    return f"{value:.5g}" if isinstance(value, float) else str(value)
