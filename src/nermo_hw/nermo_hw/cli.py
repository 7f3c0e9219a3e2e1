"""The words `hw` and `bench serial` of the `nermo` command."""

from __future__ import annotations

import contextlib
import dataclasses
import signal
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from nermo_description.parameters import RobotParameters
from nermo_description.results import CommandError, write_results
from nermo_hw.link.transports import TRANSPORTS, words

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
    bus: Annotated[str, typer.Option(help="servo_boards or pwm_board; by default what the robot's file says.")] = "",
    link: Annotated[str, typer.Option(help="Where the pseudo-terminal shall be found; empty: none.")] = "",
    tcp_port: Annotated[int, typer.Option(help="Listen at this port for socket://; 0: any, -1: none.")] = -1,
    mounting: Annotated[str, typer.Option(help="Calibration file that says how the servos sit.")] = "",
    store: Annotated[str, typer.Option(help="YAML file of the non-volatile registers.")] = "",
    clock_ppm: Annotated[float, typer.Option(help="How much too fast the device's clocks run.")] = 0.0,
    seed: Annotated[int, typer.Option(min=0, help="Seed of everything random.")] = 0,
) -> None:
    """Be the robot's electronics on a pseudo-terminal or a TCP port, until Ctrl-C.

    Nermo's boards, or the firmware of Nermo-Lite's, built for this machine. The servos stand on a bench;
    `nermo up --target serial` puts the twin behind them.

    \b
    nermo hw emulate --link /tmp/mouse
    nermo hw emulate --robot nermo --tcp-port 3333
    """
    from pydantic import ValidationError

    from nermo_hw.device.setup import EmulatorSettings, make_emulator
    from nermo_hw.firmware.build import FirmwareError

    try:
        settings = EmulatorSettings(
            robot=robot,
            bus=bus,
            link=link,
            tcp_port=tcp_port,
            mounting=mounting,
            store=store,
            clock_ppm=clock_ppm,
            seed=seed,
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
    try:
        emulator.run()
    except FirmwareError as error:
        raise CommandError(f"{error}.") from error


@hw_app.command("scan")
def scan(
    port: Annotated[list[str] | None, typer.Option(help="Look here too; may be given several times.")] = None,
    timeout: Annotated[float, typer.Option(min=0.001, max=10.0, help="For each answer, in seconds.")] = 0.1,
    json: Json = None,
) -> None:
    """Look at every serial port for a Nermo: its boards and versions. Nothing moves.

    Exit status 1 if nobody answers anywhere.

    \b
    nermo hw scan
    nermo hw scan --port socket://192.168.4.1:3333
    """
    from nermo_hw.monitor import scan as scan_ports
    from nermo_hw.monitor import scan_table, serial_ports

    names = [*serial_ports(), *(port or [])]
    if not names:
        raise CommandError("this machine has no serial port; is the cable in? --port looks elsewhere.")
    rows = scan_ports(names, _robot("nermo_lite"), timeout)  # what it has, every bus can drive
    _console.print(scan_table(rows))
    if json is not None:
        write_results(json, "hw-scan", {"rows": rows})
    if all(row["error"] is not None for row in rows):
        raise CommandError("no Nermo was found.")


@hw_app.command("calibrate")
def calibrate(
    port: Port,
    out: Annotated[Path, typer.Option(help="Calibration file to write; what it has and is not found anew stays.")],
    robot: Robot = "nermo_lite",
    posture: Annotated[str, typer.Option(help="Posture in which the robot is held for the zeros.")] = "stand",
    directions: Annotated[bool, typer.Option("--directions", help="Find the servos' directions too.")] = False,
    knees: Annotated[bool, typer.Option("--knees", help="Find the knee encoders' zeros too.")] = False,
    timeout: Annotated[float, typer.Option(min=1.0, max=3600.0, help="For each step, in seconds.")] = 60.0,
) -> None:
    """Find zero positions and directions of the servos, moved by hand; all servos are limp.

    Nothing is asked: what the hands do is the answer. The driver takes the file as its parameter `calibration`.

    \b
    nermo hw calibrate --port /dev/ttyUSB0 --out mouse.yaml --directions --knees
    nermo up --target serial port:=/dev/ttyUSB0 calibration:=$PWD/mouse.yaml
    """
    from nermo_description.parameter_files import ParameterError
    from nermo_hw.serial.calibrate import CalibrationError
    from nermo_hw.serial.calibrate import calibrate as run_calibration
    from nermo_hw.serial.calibration import load_calibration, save_calibration
    from nermo_hw.serial.driver import Driver
    from nermo_hw.types import LineError

    parameters = _robot(robot)
    if posture not in parameters.postures:
        raise CommandError(f"--posture {posture} is not one of: {', '.join(parameters.postures)}.", status=2)
    try:
        before = load_calibration(out, parameters) if out.exists() else None
        with Driver(parameters, port) as driver:
            found = run_calibration(
                driver,
                posture,
                before,
                lambda line: print(line, flush=True),
                directions=directions,
                knees=knees,
                timeout=timeout,
            )
        save_calibration(found, out)
    except ParameterError as error:
        raise CommandError(str(error), status=2) from error
    except (CalibrationError, LineError) as error:
        raise CommandError(f"{error}; nothing was written.") from error
    table = Table("servo", "zero [rad]", "direction")
    for name, mounting in found.servos.items():
        table.add_row(name, f"{mounting.zero:+.4f}", f"{mounting.direction:+d}")
    for leg, mounting in found.knee_encoders.items():
        table.add_row(f"{leg} knee encoder", f"{mounting.zero:+.4f}", f"{mounting.direction:+d}")
    _console.print(table)
    print(f"written to {out}")


@hw_app.command("monitor")
def monitor(
    port: Port,
    robot: Robot = "nermo_lite",
    calibration: Annotated[Path | None, typer.Option(help="Calibration file.")] = None,
    once: Annotated[bool, typer.Option("--once", help="Show one sample and end.")] = False,
    json: Json = None,
) -> None:
    """Show what the robot's sensors say, live, until Ctrl-C. The servos are limp; `serial_driver` must not run.

    \b
    nermo hw monitor --port usb:0403:6010 --robot nermo
    nermo hw monitor --port /tmp/mouse --once --json now.json
    """
    import numpy as np
    from rich.live import Live

    from nermo_description.parameter_files import ParameterError
    from nermo_hw.monitor import monitor_view, sample_facts
    from nermo_hw.serial.calibration import load_calibration
    from nermo_hw.serial.driver import Driver
    from nermo_hw.serial.schedule import FixedStepSchedule
    from nermo_hw.types import LineError, ServoTargets, SilentLineError

    parameters = _robot(robot)
    try:
        mounted = load_calibration(calibration, parameters) if calibration is not None else None
    except ParameterError as error:
        raise CommandError(str(error), status=2) from error
    limp = ServoTargets(np.zeros(len(parameters.servos)), energised=False)
    facts: dict[str, Any] = {}
    try:
        with (
            Driver(parameters, port, calibration=mounted) as driver,
            Live(console=_console, refresh_per_second=10, transient=False) as live,
        ):
            schedule = FixedStepSchedule(0.1)
            while not (facts and once):
                schedule.wait()
                with contextlib.suppress(SilentLineError):
                    facts = sample_facts(driver.names, driver.exchange(limp), driver.counters)
                    live.update(monitor_view(facts, parameters))
    except KeyboardInterrupt:
        pass
    except LineError as error:
        raise CommandError(f"{error}.") from error
    if json is not None:
        write_results(json, "hw-monitor", facts, robot=robot)


def _robot(name: str) -> RobotParameters:
    from nermo_description.robots import ParameterError, load_robot

    try:
        return load_robot(name)
    except ParameterError as error:
        raise CommandError(str(error), status=2) from error


@hw_app.command("keys")
def keys(
    names: Annotated[
        list[str] | None, typer.Argument(help="Ends and observers; robot and workstation by default.")
    ] = None,
    folder: Annotated[Path, typer.Option(help="Where they go.")] = Path("~/.config/nermo/keys"),
    days: Annotated[int, typer.Option(min=1, max=3650, help="How long new certificates are valid.")] = 365,
    renew: Annotated[bool, typer.Option("--renew", help="Make new ones also for ends that have one.")] = False,
    revoke: Annotated[
        bool, typer.Option("--revoke", help="Refuse the certificates that these ends have, and make new ones.")
    ] = False,
) -> None:
    """Make a certificate authority for the Wi-Fi link, and a certificate for each end that has none yet.

    The robot needs ca.pem, robot.pem, robot.key and, once there is one, the list `revoked`; ca.key stays on the
    workstation. What is made counts from the next start of robot_end and zenoh_link.

    \b
    nermo hw keys
    nermo hw keys robot workstation observer --folder keys
    nermo hw keys --renew --days 90
    nermo hw keys workstation --revoke
    """
    from datetime import UTC, datetime

    from nermo_hw.link.keys import SOON_DAYS, KeysError, make_keys, revoke_keys, valid_until
    from nermo_hw.link.revocation import LIST

    folder, ends = folder.expanduser(), names or ["robot", "workstation"]
    if revoke and not names:
        raise CommandError("--revoke needs the names of those whose certificates are to be refused.", status=2)
    try:
        made = revoke_keys(folder, ends, days=days) if revoke else make_keys(folder, ends, days=days, renew=renew)
        for path in made:
            print(f"{path}, until {valid_until(path).date()}")
        for path in (folder / f"{end}.pem" for end in ends):
            left = (valid_until(path) - datetime.now(UTC)).days
            if left < min(SOON_DAYS, days):
                print(f"{path} {'has ended' if left < 0 else f'ends in {left} days'}: --renew makes a new one")
    except KeysError as error:
        raise CommandError(f"{error}.", status=2) from error
    if revoke:
        print(f"copy {folder / LIST} to the folder of the keys at the other end, and start that again")
    if not made:
        print(f"{folder} has them all")


@hw_app.command("release")
def release(
    link: Annotated[
        Path | None, typer.Option(help="The link's YAML file; by default the one that comes along.")
    ] = None,
    endpoint: Annotated[str, typer.Option(help="Where the robot is, as in quic/10.0.0.7:7447?rel=0.")] = "",
) -> None:
    """Let the robot go on over Wi-Fi: take back every latched fault whose reason has gone.

    \b
    nermo hw release
    nermo hw release --endpoint "quic/10.0.0.7:7447?rel=0"
    """
    from nermo_description.parameter_files import ParameterError
    from nermo_hw.link.clock import SteadyClock
    from nermo_hw.link.config import DEFAULT, Side, load_link
    from nermo_hw.link.end import LinkEnd
    from nermo_hw.link.transport import LinkError

    overrides = [("workstation.endpoints", [endpoint])] if endpoint else []
    try:
        config = load_link(link or DEFAULT, overrides)
        with LinkEnd(config, Side.WORKSTATION, lambda *_: None, SteadyClock()) as end:
            if not end.wait(5.0):
                raise CommandError(f"no robot answers at {', '.join(config.workstation.endpoints)}.")
            left = end.ask_release()
    except ParameterError as error:
        raise CommandError(str(error), status=2) from error
    except LinkError as error:
        raise CommandError(f"{error}.") from error
    if left:
        raise CommandError(f"the robot is not released: {left}.")
    print("released")


Transport = Annotated[
    str,
    typer.Option(help=f"What carries the link: {', '.join(TRANSPORTS)}; {' and '.join(words(encrypts=True))} encrypt."),
]


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
        rows = run(robot, transport, 400 if quick else 2000, progress=_say)
    _print_table(rows, f"commands at 200 Hz over {transport}, from sending to the device")
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
        rows = run(robot, repeats, seed, transport, tuple(fault or ()), progress=_say)
        cut = None if fault else bench_cut(robot, transport=transport, repeats=min(repeats, 5))
    _print_table(rows, "faults while walking")
    if cut is not None:
        _print_facts(cut, "the network cut while walking")
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


def _say(what: str) -> None:
    print(what, file=sys.stderr, flush=True)


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
    with _progress() as progress:
        facts = bench.bench_serial(robot, duration, real_time, seed, progress)
        if fuzz:
            size = 500_000 if quick else 10_000_000
            report = run_fuzzer(size, seed, progress=lambda done: progress("fuzzing the parser", done / size))
            facts["fuzz"] = {**dataclasses.asdict(report), "passed": report.passed}
    _print_table(facts["rows"], "four boards at 500 Hz, virtual time (C table 5.4: 0 missed, about 1500 filled)")
    _print_facts(facts["real_time"], "an exchange on a pseudo-terminal, real time")
    _print_facts({key: facts[key] for key in bench.line_facts()}, "the line, (5.1)")
    if fuzz:
        _print_facts(facts["fuzz"], "parser fuzzer")
    if json is not None:
        write_results(json, "bench-serial", facts, robot=robot, seed=seed)
    if fuzz and not facts["fuzz"]["passed"]:
        raise CommandError("the fuzzer has found something.")


@contextlib.contextmanager
def _progress() -> Iterator[Callable[[str, float], None]]:
    """A bar on a terminal, lines elsewhere."""
    if _console.is_terminal:
        with Progress(console=_console, transient=True) as bar:
            task = bar.add_task("", total=1.0)
            yield lambda what, share: bar.update(task, description=what, completed=share)
        return
    told = ""

    def tell(what: str, share: float) -> None:
        nonlocal told
        line = f"{what}: {100 * share:.0f} %"
        if line != told and round(100 * share) % 10 == 0:
            told = line
            print(line, file=sys.stderr, flush=True)

    yield tell


def _print_table(rows: Sequence[Mapping[str, Any]], title: str) -> None:
    table = Table(title=title, title_justify="left")
    for key in rows[0]:
        table.add_column(key)
    for row in rows:
        table.add_row(*(_text(value) for value in row.values()))
    _console.print(table)


def _print_facts(facts: Mapping[str, Any], title: str) -> None:
    table = Table(title=title, title_justify="left", show_header=False)
    for key, value in facts.items():
        table.add_row(key, _text(value))
    _console.print(table)


def _text(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{key} {_text(part)}" for key, part in value.items())
    if isinstance(value, list | tuple):
        return " ".join(_text(part) for part in value)
    return f"{value:.5g}" if isinstance(value, float) else str(value)
