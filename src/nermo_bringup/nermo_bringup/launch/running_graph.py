"""The main launch file's graph as a process of ours, quietly, and the player that commands it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

from nermo_bringup.launch.executables import find_executable
from nermo_bringup.launch.runner import lead_own_life
from nermo_bringup.recording.errors import RecordingError
from nermo_description.results import CommandError
from nermo_node.recording_reader import Recording

STARTUP_S = 60.0
"""Patience with a graph that comes up; it takes a few seconds."""
STOP_S = 20.0
_POLL_S = 0.2

ALIVE = ("servo_command", "leg_states", "foot_trajectories", "gait_parameters", "truth/odom", "odom")
"""Topics of which messages are recorded once the graph is up: every node of the control chain has spoken."""
ALIVE_STEPPED = ("gait_parameters", "truth/odom")
"""Likewise where every tick waits for an operator's command."""


class Graph:
    """A running graph. Its output goes to a log file."""

    def __init__(self, process: subprocess.Popen[bytes], log: Path, environment: Mapping[str, str]) -> None:
        self._process = process
        self._log = log
        self._environment = environment

    def check(self) -> None:
        """Nothing, while it runs.

        Raises:
            CommandError: the graph has ended, with what it said last, and its exit status where it means something.
        """
        status = self._process.poll()
        if status is not None:
            why = f"exit status {status}: {_tail(self._log)}"
            said = _last_line(self._log).removeprefix("nermo: ")
            raise CommandError(
                f"the graph has ended: {said if status in (1, 2) else why} (all of it: {self._log})",
                status=status if status in (1, 2) else 1,
            )

    def wait_until_alive(
        self,
        recording: Path,
        stepped: bool,
        topics: Sequence[str] = ALIVE,
        meanwhile: Callable[[], None] = lambda: None,
    ) -> None:
        """Wait until the recording shows that the nodes of the control chain have spoken on their topics.

        `meanwhile` is called five times a second, and may raise.

        Raises:
            CommandError: the graph ended, or is not up in time; with what is missing.
        """
        deadline = time.monotonic() + STARTUP_S
        while missing := _silent(recording, ALIVE_STEPPED if stepped else topics):
            self.check()
            meanwhile()
            if time.monotonic() > deadline:
                raise CommandError(
                    f"after {STARTUP_S:g} s nothing came on {', '.join(missing)}: {_tail(self._log)} "
                    f"(all of it: {self._log})"
                )
            time.sleep(_POLL_S)

    def play(self, file: Path, namespace: str, stepped: bool, patience: float, progress: Callable[[], None]) -> None:
        """Play a command file to its end.

        Raises:
            CommandError: the player failed, the graph ended, or it took longer than `patience` [s].
        """
        arguments = ["-r", f"__ns:=/{namespace}"]
        for setting in (f"file:={file}", "use_sim_time:=true", f"lockstep:={str(stepped).lower()}"):
            arguments += ["-p", setting]
        player = subprocess.Popen(
            [find_executable("nermo_bringup", "command_player"), "--ros-args", *arguments],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            env=dict(self._environment),
        )
        try:
            deadline = time.monotonic() + patience
            while player.poll() is None:
                self.check()
                progress()
                if time.monotonic() > deadline:
                    raise CommandError(f"the commands were not played within {patience:.0f} s; see {self._log}")
                time.sleep(_POLL_S)
            output = player.communicate()[0]
            if player.returncode != 0:
                raise CommandError(f"the command player failed: {output.strip()}")
        finally:
            _end(player)


@contextmanager
def running_graph(arguments: Mapping[str, str], log: Path, domain: int | None = None) -> Iterator[Graph]:
    """The main launch file's graph with these arguments, in a ROS domain or in ours; nothing of it stays behind."""
    environment = {**os.environ, "ROS_LOG_DIR": str(log.parent / "ros_logs")}
    if domain is not None:
        environment["ROS_DOMAIN_ID"] = str(domain)
    words = [f"{name}:={value}" for name, value in arguments.items()]
    with log.open("wb") as file:
        process = subprocess.Popen(
            [sys.executable, "-m", "nermo_bringup", "launch", "nermo_bringup", "nermo.launch.xml", *words],
            stdin=subprocess.DEVNULL,
            stdout=file,
            stderr=subprocess.STDOUT,
            env=environment,
            start_new_session=True,
            preexec_fn=lead_own_life(os.getpid()),
        )
        try:
            yield Graph(process, log, environment)
        finally:
            _end(process)


def _end(process: subprocess.Popen[bytes] | subprocess.Popen[str]) -> None:
    """Ask a process to end, then make it."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGKILL):
        if process.poll() is not None:
            return
        process.send_signal(number)
        try:
            process.wait(STOP_S)
        except subprocess.TimeoutExpired:
            continue


def _silent(recording: Path, wanted: Sequence[str]) -> list[str]:
    """Topics of which no message is recorded yet."""
    try:
        recorded = Recording(recording)
    except RecordingError:
        return list(wanted)
    return [name for name in wanted if not any(topic.endswith(f"/{name}") for topic in recorded.topics)]


def _last_line(log: Path) -> str:
    return next(iter(reversed(log.read_text(errors="replace").strip().splitlines())), "no output").strip()


def _tail(log: Path, lines: int = 3) -> str:
    text = log.read_text(errors="replace").strip().splitlines()
    return " | ".join(line.strip() for line in text[-lines:]) or "no output"
