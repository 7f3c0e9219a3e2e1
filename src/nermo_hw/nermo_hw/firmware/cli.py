"""The word `bench firmware` of the `nermo` command."""

from __future__ import annotations

from typing import Annotated

import typer

from nermo_description.results import CommandError, write_results
from nermo_hw.console import HELP, Json, print_facts, say

bench_app = typer.Typer(
    no_args_is_help=True,
    rich_markup_mode=None,
    add_completion=False,
    context_settings=HELP,
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
    json: Json = None,
) -> None:
    """Fuzz the firmware of Nermo-Lite's board under sanitizers, time its silences in virtual time, and its speed here.

    Needs a C++ compiler, and no board.

    \b
    nermo bench firmware
    nermo bench firmware --bytes 100000000 --json firmware.json
    """
    from nermo_hw.firmware.bench import bench_firmware as run
    from nermo_hw.firmware.build import FirmwareError

    exchanges = 100_000 if quick else 1_000_000
    size, trials, real_time = (500_000, 20, 2.0) if quick else (size, trials, real_time)
    try:
        facts = run(size, seed, trials, exchanges, real_time, say)
    except FirmwareError as error:
        raise CommandError(f"{error}.") from error
    print_facts(facts["fuzz"], "fuzzed, with address and undefined-behaviour sanitizers")
    silences = {
        row["state"]: ", ".join(f"{key} {value}" for key, value in row.items() if key != "state")
        for row in facts["silences"]
    }
    print_facts(silences, f"from the last good frame to the state, {trials} times in virtual time")
    print_facts(facts["line"], "an exchange on the line")
    print_facts(facts["real_time"], "an exchange of the driver on a pseudo-terminal, real time")
    each = {"exchanges_a_second": facts["exchanges_a_second_on_this_machine"]}
    print_facts(each, "the logic alone on this machine")
    if json is not None:
        write_results(json, "bench-firmware", facts, robot="nermo_lite", seed=seed)
    if not facts["passed"]:
        raise CommandError("the firmware did what it must not.")
