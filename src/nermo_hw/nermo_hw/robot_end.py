"""The robot's end as one process: link, safety supervisor and driver. Runs where no ROS is installed.

    python -m nermo_hw.robot_end --robot nermo_lite --port /dev/ttyAMA0 --link link.yaml

SIGUSR1 is an emergency stop; SIGINT and SIGTERM make the servos limp and end the process. When it dies in any other
way, the device's watchdog makes them limp.
"""

from __future__ import annotations

import argparse
import contextlib
import signal
import sys
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Protocol

from pydantic import BaseModel, ConfigDict, Field

from nermo_description.parameter_files import ParameterError, read_yaml, validate
from nermo_description.parameters import RobotParameters
from nermo_description.robots import load_robot
from nermo_hw.link.clock import SteadyClock
from nermo_hw.link.config import DEFAULT, LinkConfig, Side, Topic, load_link
from nermo_hw.link.end import LinkEnd
from nermo_hw.link.intake import CommandIntake
from nermo_hw.link.messages import SensorMessages, decode_bool, decode_command
from nermo_hw.link.transport import KeysMissingError, LinkError, Transport
from nermo_hw.robot_report import Report
from nermo_hw.safety.supervisor import RefusedCommandError, SafetySettings, SafetySupervisor
from nermo_hw.serial.calibration import load_calibration
from nermo_hw.serial.driver import Driver
from nermo_hw.types import LineError, LineLostError, SensorSample, ServoTargets, SilentLineError

REOPEN_PERIOD = 0.5
"""Between two attempts to open the line [s]."""
RELEASE_PATIENCE = 1.5
"""How long a release waits for a tick to end [s]."""


class RobotEndSettings(BaseModel):
    """What the YAML file of `--settings` may say."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    safety: SafetySettings = SafetySettings()
    rate: float = Field(200.0, ge=20.0, le=500.0, description="Control ticks", json_schema_extra={"unit": "Hz"})


class Line(Protocol):
    """What drives the servos; `nermo_hw.serial.driver.Driver` does."""

    def open(self) -> Any:
        """Opens it. Raises LineError."""

    def exchange(self, targets: ServoTargets | None = None) -> SensorSample:
        """One exchange. Raises SilentLineError, LineLostError."""

    def release(self) -> None:
        """Acknowledges latched faults. Raises LineError."""

    def close(self) -> None:
        """Closes it."""


class RobotEnd:
    """Link, supervisor and driver, stepped by `run`.

    line: what leads to the servos; it need not be open. clock: stamps all sensor data [ns]. log: gets every change of
    state or causes as a JSON line.
    """

    def __init__(
        self,
        robot: RobotParameters,
        link: LinkConfig,
        line: Line,
        settings: RobotEndSettings | None = None,
        clock: Callable[[], int] | None = None,
        log: Path | None = None,
        release: bool = False,
        *,
        transport: Transport | None = None,
        monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        self._settings = settings or RobotEndSettings()
        self._clock = clock or SteadyClock()
        self._line, self._open = line, False
        self._reopen_at = 0.0
        self._supervisor = SafetySupervisor(robot, self._settings.safety, now=self._clock())
        self._messages = SensorMessages(robot)
        self._lock = threading.Lock()
        """Guards supervisor and line against the link's threads."""
        self.link = LinkEnd(
            link,
            Side.ROBOT,
            self._on_message,
            self._clock,
            self._on_heard,
            stops=self._supervisor.stops,
            transport=transport,
            monotonic=monotonic,
        )
        self.link.answer_release(self._release)
        self._commands = CommandIntake(self.link.name_of, lambda: round(monotonic() * 1e9))
        self._auto_release, self._auto_release_at = release, 0.0
        self._stopping = threading.Event()
        self._line_trouble = "not opened yet"
        self._overruns = 0
        self._report = Report(robot.name, self._supervisor, self._commands, log, monotonic)

    def run(self) -> None:
        """Steps at the rate until `stop`. Raises LinkError where the link cannot be opened."""
        with self.link:
            period = 1.0 / self._settings.rate
            due = time.monotonic()
            try:
                while not self._stopping.is_set():
                    self.tick()
                    due += period
                    late = time.monotonic() - due
                    if late > 0.0:
                        self._overruns += late > period
                        due += late if late > period else 0.0
                    else:
                        self._stopping.wait(-late)
            finally:
                self._go_limp()

    def stop(self) -> None:
        """Ends `run` after the present tick."""
        self._stopping.set()

    def emergency_stop(self, source: str) -> None:
        """Limp at the next tick. Called from a signal handler, hence without a lock."""
        self._supervisor.stops.press(source)

    def turned_away(self, sentence: str) -> None:
        """Somebody was refused at the door of the link."""
        self._report.turned_away(sentence)

    # From the link's threads

    def _on_message(self, topic: Topic, payload: bytes, sender: str) -> None:
        try:
            if topic.kind == "command":
                self._commands.put(payload, sender)
            elif topic.name == "emergency_stop":  # from an official bridge, which knows no sources
                self._supervisor.stops.say("emergency_stop", decode_bool(payload), "a bridge")
        except RefusedCommandError:
            pass  # counted, and told on the diagnostics
        except ValueError as error:
            self._refuse(f"{topic.name}: {error}")

    def _on_heard(self) -> None:
        self._supervisor.heard(self._clock())

    def _release(self) -> str:
        """Answers the service."""
        if not self._lock.acquire(timeout=RELEASE_PATIENCE):
            return "the control loop does not answer"
        try:
            return self._do_release()
        finally:
            self._lock.release()

    def _refuse(self, why: str) -> None:
        self._supervisor.refused += 1
        self._supervisor.last_refusal = why

    # The tick

    def tick(self) -> None:
        """One control tick; `run` does them at the rate."""
        with self._lock:
            self._take_commands()
            if self._may_release_unasked():
                self._do_release()
            output = self._supervisor.step(self._clock())
            sample = self._exchange(output.targets)
            if sample is not None:
                self._supervisor.take_sensors(sample, self._clock())
        if sample is not None:
            for topic, payload in self._messages.of(sample, self.link.is_due):
                self.link.send(topic, payload)
        diagnostics = self._report.of(output, self._line_trouble, self._overruns, self._clock(), self.link.status)
        if diagnostics is not None:
            self.link.send("/diagnostics", diagnostics)

    def _take_commands(self) -> None:
        """Executes the first usable one; whoever sent it owns the robot from then on."""
        for sender, payload in self._commands.take().items():
            try:
                at, names, positions = decode_command(payload)
                self._supervisor.take_command(at, names, positions, self._clock())
            except RefusedCommandError:
                continue  # counted, and told on the diagnostics
            except ValueError as error:
                self._refuse(str(error))
                continue
            self._commands.accepted(sender)
            return

    def _may_release_unasked(self) -> bool:
        if not (self._auto_release and self._open and self._supervisor.waits_for_the_line_only):
            return False
        now = time.monotonic()
        due = now >= self._auto_release_at
        if due:
            self._auto_release_at = now + REOPEN_PERIOD
        return due

    def _exchange(self, targets: ServoTargets) -> SensorSample | None:
        if not self._open and not self._reopen():
            return None
        try:
            sample = self._line.exchange(targets)
            self._line_trouble = ""
            return sample
        except SilentLineError as error:
            self._line_trouble = str(error)
        except LineLostError as error:
            self._line_trouble = str(error)
            self._open = False
        self._supervisor.device_silent(self._line_trouble, self._clock())
        return None

    def _reopen(self) -> bool:
        now = time.monotonic()
        if now < self._reopen_at:
            self._supervisor.device_silent(self._line_trouble, self._clock())
            return False
        try:
            self._line.open()
            self._open, self._line_trouble = True, ""
        except LineError as error:
            self._line_trouble = str(error)
            self._reopen_at = time.monotonic() + REOPEN_PERIOD
            self._supervisor.device_silent(self._line_trouble, self._clock())
        return self._open

    def _do_release(self) -> str:
        if not self._open:
            return f"line_lost ({self._line_trouble})"
        try:
            self._line.release()
        except LineError as error:
            return f"line_lost ({error})"
        return self._supervisor.release(self._clock())

    def _go_limp(self) -> None:
        with contextlib.suppress(LineError):
            if self._open:
                self._line.exchange(ServoTargets(self._supervisor.step(self._clock()).targets.positions, False))
        self._line.close()


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the robot's end; exit status 0 after a signal, 1 where it failed, 2 for wrong usage."""
    parser = argparse.ArgumentParser(prog="robot_end", description=__doc__.partition("\n")[0])
    parser.add_argument("--robot", default="nermo_lite", help="name of the robot, or its parameter file")
    parser.add_argument("--port", required=True, help="serial port: a path, usb:VID:PID, or socket://HOST:PORT")
    parser.add_argument("--link", type=Path, default=DEFAULT, help="the link's YAML file")
    parser.add_argument(
        "--endpoint", help="where to listen instead of what the file says, as in quic/0.0.0.0:7447?rel=0"
    )
    parser.add_argument("--namespace", help="of the ROS topics, instead of what the file says")
    parser.add_argument(
        "--release",
        action="store_true",
        help="give power unasked, at the start and when the device was away: for emulated robots",
    )
    parser.add_argument("--calibration", type=Path, help="file that `nermo hw calibrate` wrote")
    parser.add_argument(
        "--log", type=Path, help="append every change of state or causes to this file, a JSON line each"
    )
    parser.add_argument("--settings", type=Path, help="YAML file with `safety` thresholds and the `rate`")
    words = list(sys.argv[1:] if arguments is None else arguments)
    if "--ros-args" in words:  # a launch file appends them; this is no ROS node
        words = words[: words.index("--ros-args")]
    options = parser.parse_args(words)
    overrides: list[tuple[str, object]] = []
    if options.endpoint:
        overrides.append(("robot.endpoints", [options.endpoint]))
    if options.namespace is not None:
        overrides.append(("namespace", options.namespace.strip("/")))
    try:
        robot = load_robot(options.robot)
        link = load_link(options.link, overrides)
        data = read_yaml(options.settings) if options.settings else {}
        settings = validate(data, options.settings or "settings", RobotEndSettings)
        calibration = load_calibration(options.calibration, robot) if options.calibration else None
    except ParameterError as error:
        sys.stderr.write(f"robot_end: {error}\n")
        return 2
    clock = SteadyClock()
    period = 1.0 / settings.rate
    line = Driver(
        robot,
        options.port,
        calibration=calibration,
        point_period=period,
        clock=clock,
    )
    end = RobotEnd(robot, link, line, settings, clock, options.log, release=options.release)
    if link.keys is not None:
        end.link.tell_refused(end.turned_away)
    else:
        sys.stderr.write("robot_end: the link has no keys: whoever reaches this machine may command the robot\n")
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: end.stop())
    signal.signal(signal.SIGUSR1, lambda *_: end.emergency_stop("SIGUSR1"))
    try:
        end.run()
    except LinkError as error:
        sys.stderr.write(f"robot_end: {error}\n")
        return 2 if isinstance(error, KeysMissingError) else 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
