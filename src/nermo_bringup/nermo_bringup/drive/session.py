"""`nermo drive` from its first key to its last word."""

from __future__ import annotations

import shlex
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING

from rich.console import Console, RenderableType
from rich.live import Live
from rich.text import Text

from nermo_bringup.drive import display
from nermo_bringup.launch.command import MAIN_FILE, check_robot
from nermo_bringup.launch.description import load
from nermo_bringup.launch.executables import find_launch_file
from nermo_bringup.launch.running_graph import STARTUP_S, Graph, running_graph
from nermo_bringup.recording.taps import dated_directory
from nermo_bringup.teleop.keyboard import KeyboardError, KeyMapping, raw_terminal, read_keys
from nermo_control.driver import Driver, Limits
from nermo_description.invocation import called, run_line
from nermo_description.results import CommandError

if TYPE_CHECKING:
    from nermo_bringup.nodes.drive import Drive, Executor

NAMESPACE = "nermo"
COMMAND_PERIOD_S = 0.05
SCREEN_PERIOD_S = 0.1
KEY_PERIOD_S = 0.01
OTHERS_S = 2.5
"""So long we look for a graph that is up already; its nodes were seen within 1.1 s (nermo_node/loopback.xml)."""


@dataclass(frozen=True)
class Settings:
    """What was asked for."""

    robot: str = "nermo_lite"
    scene: str = "flat"
    pad: str = "xbox"
    record: Path | None = None
    """Where the recording goes; None: a new folder."""
    recording: bool = True
    web_port: int | None = None
    """Where the page in the browser is; None: there is none."""


class Keys:
    """The keys of the terminal. A stop counts at once; what else is typed while the graph comes up waits for it."""

    def __init__(self, driver: Driver, terminal: int) -> None:
        self.mapping = KeyMapping(driver)
        self.waiting: list[str] | None = []
        """Keys that wait; None when the graph is up."""
        self._terminal = terminal

    def read(self) -> None:
        """Takes what was typed since."""
        for key in read_keys(self._terminal):
            if self.waiting is None or self.mapping.leaves(key):
                self.mapping.press(key, time.monotonic())
                continue
            if key == "x":
                self.mapping.driver.emergency_stop()
            self.waiting.append(key)

    def begin(self) -> None:
        """The graph is up: what waits counts now, in its order."""
        for key in self.waiting or ():
            self.mapping.press(key, time.monotonic())
        self.waiting = None


class Signals:
    """SIGINT is a wish to leave; SIGTERM and SIGHUP too, and they are told on."""

    def __init__(self) -> None:
        self.received: int | None = None

    def __call__(self, number: int, frame: FrameType | None) -> None:
        self.received = number

    @contextmanager
    def taken(self) -> Iterator[None]:
        """While the block runs, signals end nothing by themselves."""
        before = {number: signal.signal(number, self) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
        try:
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)


def drive_twin(settings: Settings) -> None:
    """Runs `nermo drive`.

    Raises:
        CommandError: There is no terminal, an option is wrong, or the graph did not come up or broke down.
        SystemExit: After SIGTERM or SIGHUP.
    """
    check_robot(settings.robot)
    bag = (settings.record or dated_directory(Path("recordings"))).absolute() if settings.recording else None
    if bag is not None and bag.exists():
        raise CommandError(f"--record {bag} exists already; name a new folder.", status=2)
    signals = Signals()
    with signals.taken(), ExitStack() as stack:
        try:
            stack.enter_context(raw_terminal(sys.stdin.fileno()))
        except (KeyboardError, ValueError) as error:
            raise CommandError(
                f"drive takes its keys from a terminal, and its input is none; {called()} play FILE plays commands "
                f"into the graph of {called()} up.",
                status=2,
            ) from error
        _Session(settings, bag, signals).run()
    if signals.received not in (None, signal.SIGINT):
        sys.exit(128 + signals.received)


class _Session:
    """One drive: the graph, the node that drives it, the keys and the screen."""

    def __init__(self, settings: Settings, bag: Path | None, signals: Signals) -> None:
        self._settings, self._bag, self._signals = settings, bag, signals
        self._driver = Driver(Limits())
        self._keys = Keys(self._driver, sys.stdin.fileno())
        self._console = Console(markup=False, highlight=False)

    def run(self) -> None:
        """Brings the graph up, drives until somebody leaves, brings it down and says how it was."""
        from nermo_bringup.nodes.drive import in_graph

        with (
            in_graph(self._driver, NAMESPACE) as (node, executor),
            Live(
                console=self._console,
                auto_refresh=False,
                transient=True,
                redirect_stdout=False,
                redirect_stderr=False,
            ) as live,
        ):
            walked = self._drive(node, executor, live)
        self._tell(node, walked)

    def _drive(self, node: Drive, executor: Executor, live: Live) -> bool:
        """Whether the graph came up before somebody left."""
        pad = _plugged_in()
        arguments = {
            "robot": self._settings.robot,
            "scene": self._settings.scene,
            "namespace": NAMESPACE,
            "teleop": "joystick" if pad else "none",
            "pad": self._settings.pad,
            **({} if self._bag is None else {"record": str(self._bag)}),
            **({} if self._settings.web_port is None else {"web": "true", "web_port": str(self._settings.web_port)}),
        }
        expected = [action.full_name for action in load(find_launch_file("nermo_bringup", MAIN_FILE), arguments).nodes]
        self._refuse_another_graph(node, executor, set(expected))
        log = Path(tempfile.mkdtemp(prefix="nermo_drive_")) / "graph.log"
        with running_graph(arguments, log) as graph:
            if answers := self._wait(node, executor, live, graph, expected):
                self._keys.begin()
                self._loop(node, executor, live, graph, pad)
            live.update(Text("bringing the graph down"), refresh=True)
        shutil.rmtree(log.parent)
        return answers

    def _refuse_another_graph(self, node: Drive, executor: Executor, expected: set[str]) -> None:
        until = time.monotonic() + OTHERS_S
        while time.monotonic() < until and not self._leaves():
            executor.spin_once(timeout_sec=KEY_PERIOD_S)
            self._keys.read()
            if there := node.present() & expected:
                raise CommandError(
                    f"a graph is up already ({', '.join(sorted(there))}): drive that one with "
                    f"{run_line('nermo_bringup', 'keyboard_teleop')} --ros-args -r __ns:=/{NAMESPACE}, end it, or take "
                    "another ROS_DOMAIN_ID."
                )

    def _wait(self, node: Drive, executor: Executor, live: Live, graph: Graph, expected: list[str]) -> bool:
        """Until the graph answers; false where somebody leaves before."""
        began = time.monotonic()
        needs_gaits = f"/{NAMESPACE}/gait_knowledge_base" in expected
        while not node.alive(needs_gaits):
            if self._leaves():
                return False
            self._spin(node, executor)
            node.operator.send(None)
            graph.check()
            waited, up = time.monotonic() - began, node.present() & set(expected)
            if waited > STARTUP_S:
                missing = ", ".join(sorted(set(expected) - up)) or "none of the nodes"
                raise CommandError(f"after {STARTUP_S:g} s the graph does not answer; missing: {missing}.")
            line = display.starting(self._settings.robot, len(up), len(expected), waited, self._keys.waiting or ())
            live.update(line, refresh=True)
        return True

    def _loop(self, node: Drive, executor: Executor, live: Live, graph: Graph, pad: str) -> None:
        shown = 0.0
        while not self._leaves():
            self._spin(node, executor)
            node.operator.send(self._keys.mapping.command(time.monotonic(), node.time_ns))
            graph.check()
            if time.monotonic() - shown >= SCREEN_PERIOD_S:
                shown = time.monotonic()
                live.update(self._screen(node, pad), refresh=True)
        node.operator.send(self._driver.command(node.time_ns, 0.0, 0.0))

    def _spin(self, node: Drive, executor: Executor) -> None:
        """Serves the node for one period of commands, and the keys meanwhile; a stop cuts it short."""
        until = time.monotonic() + COMMAND_PERIOD_S
        while time.monotonic() < until and not self._leaves() and not node.operator.stop_is_news:
            executor.spin_once(timeout_sec=KEY_PERIOD_S)
            self._keys.read()

    def _leaves(self) -> bool:
        return self._keys.mapping.left or self._signals.received is not None

    def _screen(self, node: Drive, pad: str) -> RenderableType:
        forward, turn = node.commanded
        where = f"recording {_short(self._bag)}" if self._bag is not None else "not recorded"
        where += f", {pad}: hold its dead-man button" if pad else ""
        if self._settings.web_port is not None:
            where += f", http://127.0.0.1:{self._settings.web_port}/"
        return display.screen(
            display.View(
                title=f"{self._settings.robot} on its twin, {where}",
                driver=self._driver,
                odometer=node.odometer,
                forward_velocity=forward,
                turn_rate=turn,
                state=node.servos,
                fallen=node.fallen,
                trouble=node.trouble,
                real_time_factor=node.real_time_factor,
            )
        )

    def _tell(self, node: Drive, walked: bool) -> None:
        """The last words."""
        if not walked:
            self._console.print("ended before the twin was up; nothing was driven")
            return
        self._console.print(f"{node.odometer}{', and lies on its side' if node.fallen else ''}", style="bold")
        if self._bag is not None:
            recording = shlex.quote(_short(self._bag))
            self._console.print(
                f"recording: {recording}\n"
                "what to do with it:\n"
                f"  {called()} replay {recording}          its commands on a fresh twin, compared\n"
                f"  {called()} gap diagnose {recording}    where and why robot and twin differ (minutes)",
                soft_wrap=True,
            )


def _plugged_in() -> str:
    """Name of the gamepad that is plugged in, or an empty string."""
    from nermo_bringup.teleop.joystick import JoystickError, PadReader

    try:
        with PadReader() as reader:
            return next(iter(reader.names), "")
    except JoystickError:
        return ""


def _short(path: Path) -> str:
    """The path from here where it lies below, else whole."""
    return str(path.relative_to(Path.cwd())) if path.is_relative_to(Path.cwd()) else str(path)
