"""The word `hw` of the `nermo` command."""

from __future__ import annotations

import contextlib
import signal
import time
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table

from nermo_description.parameters import RobotParameters
from nermo_description.results import CommandError, write_results
from nermo_hw.console import HELP, Json, Robot, console

Port = Annotated[
    str, typer.Option(help="A device path, usb:VID:PID[:SERIAL], or a URL of pyserial such as socket://host:port.")
]

hw_app = typer.Typer(
    no_args_is_help=True,
    rich_markup_mode=None,
    add_completion=False,
    context_settings=HELP,
    help="The real robot: look at it, calibrate it, emulate it.",
)


@hw_app.callback()
def hw() -> None:
    """The real robot: look at it, calibrate it, emulate it."""


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
    console.print(scan_table(rows))
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
    console.print(table)
    print(f"written to {out}")


@hw_app.command("monitor")
def monitor(
    port: Port,
    robot: Robot = "nermo_lite",
    calibration: Annotated[Path | None, typer.Option(help="Calibration file.")] = None,
    once: Annotated[
        bool, typer.Option("--once", help="Show one sample and end; a complete one, if there is one in 1 s.")
    ] = False,
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
    from nermo_hw.serial.calibrate import PATIENCE
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
            Live(console=console, refresh_per_second=10, transient=False) as live,
        ):
            schedule, patience = FixedStepSchedule(0.1), time.monotonic() + PATIENCE
            while not (once and facts and (not facts["missing_boards"] or time.monotonic() > patience)):
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
