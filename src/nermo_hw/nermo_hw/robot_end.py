"""The robot's end as one process: link, safety supervisor and driver. Runs where no ROS is installed.

    python -m nermo_hw.robot_end --robot nermo_lite --port /dev/ttyAMA0 --link link.yaml

SIGUSR1 is an emergency stop; SIGINT and SIGTERM make the servos limp and end the process. When it dies in any other
way, the device's watchdog makes them limp.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import signal
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Protocol

from pydantic import BaseModel, ConfigDict, Field

from nermo_description.parameter_files import ParameterError, read_yaml, validate
from nermo_description.parameters import RobotParameters
from nermo_description.robots import load_robot
from nermo_hw.link import stamp
from nermo_hw.link.clock import SteadyClock
from nermo_hw.link.config import DEFAULT, LinkConfig, Side, Topic, load_link
from nermo_hw.link.end import LinkEnd
from nermo_hw.link.log_tap import LogTap
from nermo_hw.link.messages import SensorMessages, decode_bool, decode_command, encode_diagnostics
from nermo_hw.link.session import LinkError
from nermo_hw.safety.causes import Cause, State
from nermo_hw.safety.supervisor import Output, RefusedCommandError, SafetySettings, SafetySupervisor
from nermo_hw.serial.calibration import load_calibration
from nermo_hw.serial.driver import Driver
from nermo_hw.types import LineError, LineLostError, SensorSample, ServoTargets, SilentLineError

REPLY_TIMEOUT = 0.02
"""How long the device may take to answer [s]: far longer than it needs, and a tick that is late is no danger."""
REOPEN_PERIOD = 0.5
"""Between two attempts to open the line [s]."""
OK, WARN, ERROR = 0, 1, 2
"""Levels of diagnostic_msgs/DiagnosticStatus."""


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


class Newest:
    """One place for the newest command: what comes before it is used takes its place, what is older never does."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._payload: bytes | None = None
        self._stamp = -1
        self.received = 0

    def put(self, payload: bytes) -> None:
        """Raises ValueError where it has no stamp."""
        at = stamp.read(payload)
        with self._lock:
            self.received += 1
            if self._payload is None or at > self._stamp:
                self._payload, self._stamp = payload, at

    def take(self) -> bytes | None:
        """The newest one, once."""
        with self._lock:
            payload, self._payload = self._payload, None
            return payload


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
    ) -> None:
        self._log = log
        self._settings = settings or RobotEndSettings()
        self._clock = clock or SteadyClock()
        self._line, self._open = line, False
        self._reopen_at = 0.0
        self._supervisor = SafetySupervisor(robot, self._settings.safety, now=self._clock())
        self._messages = SensorMessages(list(robot.servos))
        self._newest = Newest()
        self._lock = threading.Lock()
        """Guards the supervisor against the link's threads."""
        self._link = LinkEnd(link, Side.ROBOT, self._on_message, self._clock, self._on_heard)
        self._link.answer_release(self._release)
        self._releasing = threading.Event()
        self._auto_release, self._auto_release_at = release, 0.0
        self._released = threading.Event()
        self._left = ""
        self._stopping = threading.Event()
        self._stop_pressed = False
        self._robot = robot
        self._turned_away: Counter[str] = Counter()
        self._told_away: Counter[str] = Counter()
        self._line_trouble = "not opened yet"
        self._ticks = self._overruns = 0
        self._told_refused = 0
        self._diagnosed_at = 0.0
        self._told_state: tuple[State, tuple[Cause, ...]] | None = None

    def run(self) -> None:
        """Steps at the rate until `stop`. Raises LinkError where the link cannot be opened."""
        with self._link:
            period = 1.0 / self._settings.rate
            due = time.monotonic()
            try:
                while not self._stopping.is_set():
                    self._tick()
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
        self._supervisor.emergency_stop(source)

    def turned_away(self, sentence: str) -> None:
        """Somebody was refused at the door of the link."""
        self._turned_away[sentence] += 1

    # From the link's threads

    def _on_message(self, topic: Topic, payload: bytes) -> None:
        try:
            if topic.kind == "command":
                self._newest.put(payload)
            elif topic.name == "emergency_stop":
                self._on_emergency_stop(decode_bool(payload))
        except ValueError as error:
            self._refuse(f"{topic.name}: {error}")

    def _on_emergency_stop(self, pressed: bool) -> None:
        with self._lock:
            if pressed:
                self._supervisor.emergency_stop("topic emergency_stop")
            elif self._stop_pressed:
                self._supervisor.end_emergency_stop()
            self._stop_pressed = pressed

    def _on_heard(self) -> None:
        self._supervisor.heard(self._clock())

    def _release(self) -> str:
        """Answers the service; the tick does it, because the line is its own."""
        self._released.clear()
        self._releasing.set()
        done = self._released.wait(1.5)
        return self._left if done else "the control loop does not answer"

    def _refuse(self, why: str) -> None:
        self._supervisor.refused += 1
        self._supervisor.last_refusal = why

    # The tick

    def _tick(self) -> None:
        with self._lock:
            self._take_command()
            if self._releasing.is_set():
                self._left = self._do_release()
                self._releasing.clear()
                self._released.set()
            elif self._may_release_unasked():
                self._do_release()
            output = self._supervisor.step(self._clock())
            sample = self._exchange(output.targets)
            if sample is not None:
                self._supervisor.take_sensors(sample, self._clock())
        self._ticks += 1
        if sample is not None:
            for topic, payload in self._messages.of(sample, self._link.is_due):
                self._link.send(topic, payload)
        self._diagnose(output)

    def _may_release_unasked(self) -> bool:
        if not (self._auto_release and self._open and self._supervisor.waits_for_the_line_only):
            return False
        now = time.monotonic()
        due = now >= self._auto_release_at
        if due:
            self._auto_release_at = now + REOPEN_PERIOD
        return due

    def _take_command(self) -> None:
        payload = self._newest.take()
        if payload is None:
            return
        try:
            at, names, positions = decode_command(payload)
        except ValueError as error:
            self._refuse(str(error))
            return
        with contextlib.suppress(RefusedCommandError):  # counted, and told on the diagnostics
            self._supervisor.take_command(at, names, positions, self._clock())

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

    # Diagnostics

    def _write(self, output: Output) -> None:
        if self._log is None:
            return
        stamped = self._supervisor.command_stamp
        entry = {
            "monotonic_ns": time.monotonic_ns(),
            "state": str(output.state),
            "causes": [str(cause) for cause in output.causes],
            "command_age_ms": None if stamped is None else (self._clock() - stamped) * 1e-6,
            "commands_received": self._newest.received,
        }
        try:
            with self._log.open("a", encoding="utf-8") as file:
                file.write(json.dumps(entry) + "\n")
        except OSError as error:  # a full card is no reason to let go of the robot
            sys.stderr.write(f"robot_end: {self._log} cannot be written: {error}\n")
            self._log = None

    def _diagnose(self, output: Output) -> None:
        changed = (output.state, output.causes) != self._told_state
        now = time.monotonic()
        if not changed and now - self._diagnosed_at < 1.0:
            return
        self._diagnosed_at, self._told_state = now, (output.state, output.causes)
        supervisor = self._supervisor
        if changed:
            self._write(output)
        why = "; ".join(supervisor.reason(cause) for cause in output.causes)
        level = {State.FOLLOW: OK, State.HOLD: WARN}.get(output.state, ERROR)
        safety: dict[str, object] = {
            "state": output.state,
            "causes": ", ".join(str(cause) for cause in output.causes),
            "commands_received": self._newest.received,
            "commands_accepted": supervisor.accepted,
            "commands_refused": supervisor.refused,
            "last_refusal": supervisor.last_refusal,
        }
        parts = [("robot_end: safety", level, f"{output.state}: {why}" if why else str(output.state), safety)]
        if supervisor.refused > self._told_refused:
            self._told_refused = supervisor.refused
            parts.append(("robot_end: commands", WARN, f"refused: {supervisor.last_refusal}", {}))
        for sentence, count in list(self._turned_away.items()):
            if count > self._told_away[sentence]:
                self._told_away[sentence] = count
                parts.append(("robot_end: door", WARN, sentence, {"count": count}))
        line = (OK, "open") if self._open and not self._line_trouble else (ERROR, self._line_trouble)
        values: dict[str, object] = {"ticks": self._ticks, "overruns": self._overruns}
        parts.append(("robot_end: line", *line, values))
        status = self._link.status()
        connected = (OK, "connected") if status["connected"] else (WARN, "nobody is heard")
        parts.append(("robot_end: link", *connected, status))
        self._link.send("/diagnostics", encode_diagnostics(self._clock(), self._robot.name, parts))
        for name, at, sentence, _ in parts:
            if at != OK and (changed or name in ("robot_end: door", "robot_end: commands")):
                sys.stderr.write(f"{name}: {sentence}\n")


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
        reply_timeout=REPLY_TIMEOUT,
        clock=clock,
    )
    end = RobotEnd(robot, link, line, settings, clock, options.log, release=options.release)
    if link.keys is not None:
        LogTap(end.turned_away)
    else:
        sys.stderr.write("robot_end: the link has no keys: whoever reaches this machine may command the robot\n")
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: end.stop())
    signal.signal(signal.SIGUSR1, lambda *_: end.emergency_stop("SIGUSR1"))
    try:
        end.run()
    except LinkError as error:
        sys.stderr.write(f"robot_end: {error}\n")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
