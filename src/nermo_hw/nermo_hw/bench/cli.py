"""The words `bench serial`, `bench link` and `bench faults` of the `nermo` command."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Iterator
from typing import Annotated

import typer

from nermo_description.results import CommandError, write_results
from nermo_hw.console import HELP, Json, Robot, print_facts, print_table, progress, say
from nermo_hw.link.transports import TRANSPORTS, words

bench_app = typer.Typer(
    no_args_is_help=True,
    rich_markup_mode=None,
    add_completion=False,
    context_settings=HELP,
    help="Measure the robot's lines.",
)
Transport = Annotated[
    str,
    typer.Option(help=f"What carries the link: {', '.join(TRANSPORTS)}; {' and '.join(words(encrypts=True))} encrypt."),
]


@bench_app.callback()
def bench() -> None:
    """Measure the robot's lines."""


@bench_app.command("link")
def bench_link(
    robot: Robot = "nermo_lite",
    transport: Transport = "quic",
    quick: Annotated[bool, typer.Option("--quick", help="400 commands a row, not 2000.")] = False,
    json: Json = None,
) -> None:
    """Send commands at 200 Hz over good and bad networks into an emulated device, and count what it executes.

    Needs network namespaces and /dev/net/tun; no rights where the kernel lets users make them.

    \b
    nermo bench link --json link.json
    nermo bench link --transport tls
    """
    from nermo_hw.bench.link import bench_link as run

    with _network_errors(transport):
        rows = run(robot, transport, 400 if quick else 2000, progress=say)
    print_table(rows, f"commands at 200 Hz over {transport}, from sending to the device")
    if json is not None:
        write_results(json, "bench-link", {"transport": transport, "rows": rows}, robot=robot, seed=0)
    if any(row["stale_executed"] for row in rows):
        raise CommandError("the device executed stale commands.")


@bench_app.command("faults")
def bench_faults(
    robot: Robot = "nermo_lite",
    transport: Transport = "quic",
    repeats: Annotated[int, typer.Option(min=1, max=1000, help="How often each fault is injected.")] = 20,
    fault: Annotated[list[str] | None, typer.Option(help="Only this fault; may be given several times.")] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the moments of injection.")] = 0,
    json: Json = None,
) -> None:
    """Inject every fault into a walking emulated robot, and say what state it reached, when, and whether it recovered.

    Last the network is cut for 3 s, five times, unless faults are named.

    \b
    nermo bench faults --json faults.json
    nermo bench faults --repeats 3 --fault network_cut --fault fall
    """
    from nermo_hw.bench.faults import bench_cut
    from nermo_hw.bench.faults import bench_faults as run

    with _network_errors(transport):
        rows = run(robot, repeats, seed, transport, tuple(fault or ()), progress=say)
        cut = None if fault else bench_cut(robot, transport=transport, repeats=min(repeats, 5))
    print_table(rows, "faults while walking")
    if cut is not None:
        print_facts(cut, "the network cut while walking")
    if json is not None:
        write_results(json, "bench-faults", {"transport": transport, "rows": rows, "cut": cut}, robot=robot, seed=seed)
    bad = [
        row["fault"]
        for row in rows
        if not row["injected"] == row["in_time"] == row["recovered"] or row["executed_after"]
    ]
    if bad:
        raise CommandError(f"not as it should be: {', '.join(bad)}.")


@contextlib.contextmanager
def _network_errors(transport: str) -> Iterator[None]:
    from nermo_hw.bench.json_lines import WordError
    from nermo_hw.bench.network import NoNamespacesError

    if transport not in TRANSPORTS:
        raise CommandError(f"--transport {transport} is not one of: {', '.join(TRANSPORTS)}.", status=2)
    try:
        yield
    except NoNamespacesError as error:
        raise CommandError(f"this measurement needs two machines in one: {error.strerror}.") from error
    except WordError as error:
        raise CommandError(f"{error}.") from error


@bench_app.command("serial")
def bench_serial(
    robot: Robot = "nermo_lite",
    duration: Annotated[
        float, typer.Option(min=1.0, max=1e5, help="Of each row of the table, in virtual seconds.")
    ] = 2000.0,
    real_time: Annotated[
        float, typer.Option(min=0.5, max=3600.0, help="Of the exchange in real time, in seconds.")
    ] = 10.0,
    quick: Annotated[bool, typer.Option("--quick", help="50 virtual seconds a row, 2 real ones.")] = False,
    fuzz: Annotated[bool, typer.Option("--fuzz", help="Fuzz the parser too, with 10 million bytes.")] = False,
    seed: Annotated[int, typer.Option(min=0, help="Seed of everything random.")] = 0,
    json: Json = None,
) -> None:
    """Track a trajectory at 500 Hz on four boards (C table 5.4), and measure an exchange with the emulated device.

    \b
    nermo bench serial --json serial.json
    nermo bench serial --quick --fuzz
    nermo bench serial --duration 600 --real-time 60
    """
    from nermo_hw.bench import serial as bench
    from nermo_hw.sbcp.fuzz import fuzz as run_fuzzer

    duration, real_time = (50.0, 2.0) if quick else (duration, real_time)
    with progress() as tell:
        facts = bench.bench_serial(robot, duration, real_time, seed, tell)
        if fuzz:
            size = 500_000 if quick else 10_000_000
            report = run_fuzzer(size, seed, progress=lambda done: tell("fuzzing the parser", done / size))
            facts["fuzz"] = {**dataclasses.asdict(report), "passed": report.passed}
    print_table(facts["rows"], "four boards at 500 Hz, virtual time (C table 5.4: 0 missed, about 1500 filled)")
    print_facts(facts["real_time"], "an exchange on a pseudo-terminal, real time")
    print_facts({key: facts[key] for key in bench.line_facts()}, "the line, (5.1)")
    if fuzz:
        print_facts(facts["fuzz"], "parser fuzzer")
    if json is not None:
        write_results(json, "bench-serial", facts, robot=robot, seed=seed)
    if fuzz and not facts["fuzz"]["passed"]:
        raise CommandError("the fuzzer has found something.")
