"""Runs the nodes of a launch description: output with names before it, respawn, and an end that leaves nothing behind.

Each node has a process group of its own, so that Ctrl-C reaches it once, through here, and dies with this process even
where that is killed outright.
"""

from __future__ import annotations

import asyncio
import contextlib
import ctypes
import os
import re
import signal
import sys
from collections.abc import Callable, Sequence
from typing import Any, TextIO

from nermo_bringup.launch.description import NodeAction
from nermo_bringup.launch.executables import command_line
from nermo_description.results import CommandError

# Each is given when the one before did not help within its time [s].
STOPPING: tuple[tuple[signal.Signals, float], ...] = (
    (signal.SIGINT, 6.0),
    (signal.SIGTERM, 3.0),
    (signal.SIGKILL, 5.0),
)
_COLOURS = (36, 32, 33, 35, 34, 96, 92, 93, 95, 94)
_PR_SET_PDEATHSIG = 1
_CHUNK = 65536
_FAILED, _WRONG_USAGE = 1, 2
_INTERRUPTED = ("Traceback ", "Fatal Python error: init")
"""So begins what a Python says that was interrupted."""
_STAMPS = re.compile(r"\x1b\[[0-9;]*m|^(\[[^]]*\] ?)+: ")
"""What stands before the sentence in a line of ROS's log, and its colours."""


def lead_own_life(parent: int) -> Callable[[], None]:
    """What a child does before it becomes a node: reacts to SIGINT, and dies when its parent is gone.

    A shell in the background hands on an ignored SIGINT, which a program inherits and Python then never notices.
    """
    libc = ctypes.CDLL(None) if sys.platform == "linux" else None

    def prepare() -> None:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        if libc is not None:
            libc.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
            if os.getppid() != parent:
                os._exit(1)

    return prepare


class Runner:
    """Starts nodes, watches over them and stops them.

    Args:
        nodes: The nodes.
        output: Where their lines go.
        stopping: Signals to stop them with, each with the time [s] it is given.
    """

    def __init__(
        self,
        nodes: Sequence[NodeAction],
        output: TextIO | None = None,
        stopping: Sequence[tuple[signal.Signals, float]] = STOPPING,
    ) -> None:
        self._commands = [(node, command_line(node)) for node in nodes]
        self._output = output or sys.stdout
        self._stopping = stopping
        self._processes: dict[asyncio.subprocess.Process, str] = {}
        self._labels = _labels(nodes)
        self._width = max(map(len, self._labels), default=0)
        self._stop = asyncio.Event()
        self._urgency = 0
        self._last: dict[str, str] = {}
        """The last line of each node."""
        self._failed: list[str] = []
        self._status = 0

    def run(self) -> int:
        """Runs until all nodes have ended or a SIGINT or SIGTERM comes.

        Returns:
            0; 1 where a node that is not started again ended with an error; 2 where a node refused its parameters or
            arguments, which ends the launch.
        """
        return asyncio.run(self._run())

    async def _run(self) -> int:
        loop = asyncio.get_running_loop()
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            loop.add_signal_handler(number, self._request_stop)
        lives = [
            asyncio.create_task(self._live(index, node, command))
            for index, (node, command) in enumerate(self._commands)
        ]
        stopped = asyncio.create_task(self._stop.wait())
        all_ended = asyncio.gather(*lives)
        waited_for: set[asyncio.Future[Any]] = {all_ended, stopped}
        try:
            await asyncio.wait(waited_for, return_when=asyncio.FIRST_COMPLETED)
            if self._stop.is_set():
                self._say("launch", f"stopping {len(self._processes)} nodes")
            await self._end_all()
            await all_ended
        finally:
            self._kill_all()
            stopped.cancel()
        for text in self._failed:
            print(f"nermo: {text}", file=sys.stderr)
        return self._status

    def _request_stop(self) -> None:
        """The first request stops in order, every further one makes more haste."""
        self._urgency += 1
        self._stop.set()

    async def _live(self, index: int, node: NodeAction, command: list[str]) -> None:
        """The life of one node, with its rebirths."""
        label = self._labels[index]
        while not self._stop.is_set():
            try:
                process = await asyncio.create_subprocess_exec(
                    *command,
                    stdin=asyncio.subprocess.DEVNULL,
                    stdout=asyncio.subprocess.PIPE,
                    stderr=asyncio.subprocess.PIPE,
                    env={**os.environ, **self._terminal_settings(), **node.environment},
                    start_new_session=True,
                    preexec_fn=lead_own_life(os.getpid()),
                )
            except OSError as error:
                self._failed.append(f"{label} cannot be started: {command[0]}: {error.strerror}.")
                self._status = self._status or _FAILED
                return
            self._processes[process] = label
            if self._stop.is_set():  # it came too late for the signal to all
                process.send_signal(signal.SIGINT)
            self._say(label, f"started with process id {process.pid}", index)
            assert process.stdout is not None
            assert process.stderr is not None
            show = node.output != "log"
            _, interrupted = await asyncio.gather(
                self._relay(process.stdout, label, index, show), self._relay(process.stderr, label, index, True)
            )
            status = await process.wait()
            del self._processes[process]
            how = f"killed by {signal.Signals(-status).name}" if status < 0 else f"ended with exit status {status}"
            if self._stop.is_set():
                if status not in (0, 130, -signal.SIGINT, -signal.SIGTERM) and not interrupted:
                    self._say(label, how, index)
                return
            if status == _WRONG_USAGE:  # it would end so again
                said = _STAMPS.sub("", self._last.get(label, ""))
                self._say(label, how, index)
                self._failed.append(f"{label} refused what it was given: {said or 'see above'}")
                self._status = _WRONG_USAGE
                self._stop.set()
                return
            if not node.respawn:
                self._say(label, how, index)
                if status != 0:
                    self._failed.append(f"{label} {how}.")
                    self._status = self._status or _FAILED
                return
            self._say(label, f"{how}; starting it again in {node.respawn_delay:g} s", index)
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._stop.wait(), node.respawn_delay)

    async def _end_all(self) -> None:
        """Stops what still runs, with more and more force."""
        for step, (number, patience) in enumerate(self._stopping):
            if not self._processes:
                return
            if step > 0:
                waiting = ", ".join(sorted(self._processes.values()))
                self._say("launch", f"{number.name} to what has not stopped: {waiting}")
            self._signal_all(number)
            loop = asyncio.get_running_loop()
            deadline = loop.time() + patience
            while self._processes and loop.time() < deadline and self._urgency <= step + 1:
                await asyncio.sleep(0.02)

    def _signal_all(self, number: signal.Signals) -> None:
        for process in self._processes:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, number)

    def _kill_all(self) -> None:
        self._signal_all(signal.SIGKILL)

    def _terminal_settings(self) -> dict[str, str]:
        settings = {"PYTHONUNBUFFERED": "1"}
        if self._coloured:
            settings.setdefault("RCUTILS_COLORIZED_OUTPUT", "1")
        return settings

    @property
    def _coloured(self) -> bool:
        return self._output.isatty() and "NO_COLOR" not in os.environ

    async def _relay(self, stream: asyncio.StreamReader, label: str, index: int, show: bool) -> bool:
        """Hands on whole lines, each with the node's name before it; whether the node was interrupted at its start.

        A Python that is interrupted before its node can take the signal ends in a traceback, or several where that
        happens in an import: what comes after the first is held back until all is heard.
        """
        rest = b""
        held: list[str] = []
        while chunk := await stream.read(_CHUNK):
            *lines, rest = (rest + chunk).split(b"\n")
            for line in lines if show else ():
                text = line.decode(errors="replace")
                if held or (self._stop.is_set() and text.startswith(_INTERRUPTED)):
                    held.append(text)
                else:
                    self._say(label, text, index)
        if interrupted := _was_interrupted(held):
            held.clear()
        for text in [*held, *([rest.decode(errors="replace")] if rest else [])] if show else ():
            self._say(label, text, index)
        return interrupted

    def _say(self, label: str, text: str, index: int | None = None) -> None:
        self._last[label] = text or self._last.get(label, "")
        name = f"[{label}]".ljust(self._width + 2)
        if self._coloured and index is not None:
            name = f"\x1b[{_COLOURS[index % len(_COLOURS)]}m{name}\x1b[0m"
        with contextlib.suppress(BrokenPipeError):
            print(f"{name} {text}", file=self._output, flush=True)


def _was_interrupted(told: Sequence[str]) -> bool:
    """Whether these tracebacks tell of a KeyboardInterrupt, or of what an import made of one, and of no other error."""
    if "KeyboardInterrupt" not in told:
        return False
    last = max(number for number, line in enumerate(told) if line == "KeyboardInterrupt")
    return not any(line.startswith("During handling ") for line in told[last:])


def _labels(nodes: Sequence[NodeAction]) -> list[str]:
    """Names to show: short where they are unambiguous, with the namespace where they are not."""
    short = [node.name or node.executable for node in nodes]
    return [
        node.full_name.lstrip("/") if short.count(name) > 1 else name for node, name in zip(nodes, short, strict=True)
    ]


def launch(nodes: Sequence[NodeAction]) -> int:
    """Runs nodes until they end or Ctrl-C; returns the exit status.

    Raises:
        CommandError: There is nothing to run, or an executable does not exist.
    """
    if not nodes:
        raise CommandError("the launch file starts no node with these arguments.")
    return Runner(nodes).run()
