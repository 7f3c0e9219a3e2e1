"""Segments of a protocol, each through a graph of its own, from what to prepare to its recording."""

from __future__ import annotations

import os
import select
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from nermo_bringup.drive.session import OTHERS_S, Signals
from nermo_bringup.launch.command import MAIN_FILE, make_missing_keys
from nermo_bringup.launch.description import load
from nermo_bringup.launch.executables import find_launch_file
from nermo_bringup.launch.running_graph import ALIVE, Graph, running_graph
from nermo_bringup.nodes.conductor import ConductorNode, in_graph
from nermo_bringup.protocol.dead_man import Watch, hint, watching
from nermo_bringup.protocol.pilot import Pilot
from nermo_description.model import build_model
from nermo_description.parameter_files import write_yaml
from nermo_description.results import CommandError
from nermo_description.stand import Stand
from nermo_gap.protocol.conduct import STAND, Conductor, Played
from nermo_gap.protocol.scene import BAG_FOLDER, SCENE_FILE, SceneFile
from nermo_gap.protocol.through_graph import Request
from nermo_gap.protocol.types import Segment
from nermo_sim.experiments.on_robot import TWIN
from simgap.data.errors import GapInputError

NAMESPACE = "nermo"
END_S = 1.0
"""So long the mouse is told to stand before the graph goes down."""
SPOILED = 5
"""So often a piece is played again though nobody let go."""
CHECK_S = 0.5
"""So often we look whether the graph is still there."""


class LeftError(Exception):
    """Somebody wants to leave."""


def record_through_graph(request: Request) -> list[Path]:
    """Record a protocol; returns the folders of its segments, in order.

    Raises:
        GapInputError: the folder holds something already.
        CommandError: there is no terminal to ask at, the graph broke down, or somebody left before the end; what was
            recorded until then is kept.
    """
    if request.out.exists() and any(request.out.iterdir()):
        raise GapInputError(f"{request.out}: holds something already; give a folder that is new or empty")
    with session(request) as opened:
        return opened.run()


@contextmanager
def session(request: Request) -> Iterator[Session]:
    """A session, while the block runs; signals are its then.

    Raises:
        CommandError: a real mouse would have nobody who watches it, or who steers it where that is needed.
    """
    unwatched = request.on_twin and request.watched_by == "none"
    steered = any(segment.steered for segment in request.protocol.segments)
    if steered and not request.on_twin and (request.watcher is not None or request.watched_by == "none"):
        raise CommandError("somebody has to steer a real mouse: --dead-man space or pad", status=2)
    if request.watcher is None and not unwatched and not sys.stdin.isatty():
        raise CommandError(
            "a real mouse is watched: it waits for Enter, and moves while the space bar is held, so that "
            "this needs a terminal as its input",
            status=2,
        )
    if request.target == "link" and request.port == TWIN:
        make_missing_keys()
    signals = Signals()
    with signals.taken():
        yield Session(request, signals)


class Session:
    """One protocol: what to prepare, the graph, the pieces, the recording, segment by segment."""

    def __init__(self, request: Request, signals: Signals) -> None:
        self._request, self._signals = request, signals
        self._console = Console(markup=False, highlight=False, stderr=True)
        # A domain of its own, so that neither another graph on this machine nor this one is disturbed.
        self._domain = int(os.environ.get("ROS_DOMAIN_ID") or 1 + os.getpid() % 100)
        os.environ["ROS_DOMAIN_ID"] = str(self._domain)
        self._rest = Stand().rest(build_model(request.robot))

    def run(self) -> list[Path]:
        """All segments."""
        request, folders = self._request, list[Path]()
        try:
            for number, segment in enumerate(request.protocol.segments):
                folder = request.out / f"{number + 1}_{segment.name}"
                self._prepare(segment)
                folder.mkdir(parents=True)
                self.record(segment, folder)
                folders.append(folder)
        except LeftError:
            kept = f"{len(folders)} of {len(request.protocol.segments)} segments are whole in {request.out}"
            raise CommandError(f"left before the end; {kept}, and pieces that were played are kept") from None
        return folders

    def _prepare(self, segment: Segment) -> None:
        """Says what to prepare; beside a real mouse, waits until it is."""
        self.announce(f"{segment.name}: {segment.tell}")
        if not self._request.on_twin and self._request.watcher is None:
            self.ask("press Enter when it is so (Ctrl-C leaves)")

    def announce(self, text: str) -> None:
        """Says what is next."""
        self._console.print(text, style="bold", soft_wrap=True)

    def ask(self, question: str) -> str:
        """A line from whoever stands beside the mouse, without what surrounds it.

        Raises:
            LeftError: somebody wants to leave.
        """
        self._console.print(question)
        while not select.select([sys.stdin], [], [], 0.1)[0]:
            self._look_for_leaving()
        if not (line := sys.stdin.readline()):
            raise LeftError
        return line.strip()

    def record(self, segment: Segment, folder: Path, again: bool = True, ready: str = "") -> str:
        """Play a segment and record it into a folder that is there; returns why it was broken off, or nothing.

        ``again``: as of `Conductor`. ``ready``: what is to be told when the graph is up, before the mouse moves.

        Raises:
            CommandError, LeftError: as `record_through_graph`; what was played is kept.
        """
        request, bag, log = self._request, (folder / BAG_FOLDER).absolute(), (folder / "graph.log").absolute()
        arguments = {
            "robot": request.robot_file,
            "namespace": NAMESPACE,
            "teleop": "none",
            "target": request.target,
            "port": request.port,
            "calibration": "none" if request.calibration is None else str(request.calibration.absolute()),
            "scene": "hung" if segment.scene == "hung" and request.on_twin else "flat",
            # Where the clock is the twin's, it waits for each command: nothing is missed on a busy machine.
            "stepped": str(request.target == "sim").lower(),
            "seed": str(request.seed),
            "record": str(bag),
        }
        played: list[Played] = []
        skipped = 0.0
        try:
            with (
                self._watched(segment) as held,
                in_graph(NAMESPACE, sim_time=request.target == "sim") as node,
            ):
                self._refuse_another_graph(node, arguments)
                with running_graph(arguments, log, self._domain) as graph:
                    alive = [topic for topic in ALIVE if request.on_twin or topic != "truth/odom"]
                    graph.wait_until_alive(bag, request.target == "sim", alive, self._look_for_leaving)
                    conductor = Conductor(segment, request.robot, self.tell, again)
                    played = conductor.played
                    if ready:
                        self.tell(ready)
                    before = node.skipped
                    try:
                        with self._progress(segment) as advance:
                            held = self._pilot(segment, conductor, node) or held
                            self._play(segment, conductor, node, graph, held, advance, log)
                    finally:
                        skipped = node.skipped - before
                    return conductor.broken
        finally:
            # Also of a segment that was not played to its end.
            if played:
                scene = SceneFile.of(
                    request.protocol, segment, request.robot.name, Stand(), np.asarray(self._rest), played, skipped
                )
                if scene.slow_motion:
                    self.tell(f"warning: {scene.slow_motion}")
                write_yaml(scene.model_dump(mode="json", exclude_none=True), folder / SCENE_FILE)

    def _refuse_another_graph(self, node: ConductorNode, arguments: Mapping[str, str]) -> None:
        """Two graphs with the same names would hear each other's clocks and commands."""
        expected = {n.full_name for n in load(find_launch_file("nermo_bringup", MAIN_FILE), arguments).nodes}
        until = time.monotonic() + OTHERS_S
        while time.monotonic() < until:
            self._look_for_leaving()
            node.serve(CHECK_S)
            if there := node.present() & expected:
                raise CommandError(
                    f"a graph is up already in ROS_DOMAIN_ID={self._domain} ({', '.join(sorted(there)[:3])}): end it, "
                    "or take another ROS_DOMAIN_ID"
                )

    def _play(
        self,
        segment: Segment,
        conductor: Conductor,
        node: ConductorNode,
        graph: Graph,
        held: Watch,
        advance: Callable[[float], None],
        log: Path,
    ) -> None:
        """Until all pieces are played, or somebody leaves; the mouse stands then."""
        last, before, checked, stepped = -1, False, 0.0, self._request.target == "sim"
        watcher = self._request.watcher
        if (what := watcher.hint if watcher else hint(self._request.watched_by, segment.steered)) != "":
            self.tell(f"{what}: the mouse stands up and begins; let go and it stands still (Ctrl-C leaves)")
        begun = False
        try:
            while not (conductor.over or conductor.broken):
                self._look_for_leaving()
                if node.stopped:
                    raise CommandError(
                        "emergency stop: the recording ends here, and what was played before this piece is kept"
                    )
                now = node.next_tick(last)
                if time.monotonic() - checked > CHECK_S:
                    checked = time.monotonic()
                    graph.check()
                    advance(conductor.seconds(now))
                turn = held()
                holds = turn is not None
                if holds and not before:
                    node.release()
                before, begun = holds, begun or holds
                # A stepped twin waits: what it was told may have been lost.
                if begun and (now > last or stepped):
                    node.outlet.send(*conductor.step(now, holds, node.commanded, turn or 0.0), every_tick=stepped)
                    if conductor.spoiled >= SPOILED:
                        raise CommandError(
                            f"a piece was broken off {SPOILED} times: this machine is too slow for the graph, or the "
                            f"line to the mouse is lost; what was played is kept, and {log} has what the graph said"
                        )
                last = now
        finally:
            if begun:
                self._stand(node, last, stepped)

    @staticmethod
    def _stand(node: ConductorNode, last: int, stepped: bool) -> None:
        until = time.monotonic() + END_S
        while time.monotonic() < until:
            now = node.next_tick(last)
            if now > last or stepped:
                node.outlet.send(replace(STAND, stamp=now), None, every_tick=stepped)
            last = now

    def tell(self, text: str) -> None:
        """Says what happens."""
        self._console.print(f"  {text}")
        if self._request.watcher:
            self._request.watcher.tell(text)

    @contextmanager
    def _watched(self, segment: Segment) -> Iterator[Watch]:
        """What tells whether somebody lets the mouse move."""
        if (watcher := self._request.watcher) is not None:
            yield lambda: 0.0 if watcher.held() else None
            return
        with watching(self._request.watched_by, self._request.pad, segment.steered) as held:
            yield held

    def _pilot(self, segment: Segment, conductor: Conductor, node: ConductorNode) -> Watch | None:
        """Who steers an emulated mouse where nobody else does."""
        if not (segment.steered and self._request.on_twin and self._request.watched_by == "none"):
            return None
        node.see_truth()
        pilot = Pilot(self._request.robot)
        return lambda: pilot.steer(conductor.piece, node.truth)

    def _look_for_leaving(self) -> None:
        watcher = self._request.watcher
        if self._signals.received is not None or (watcher and watcher.gone()):
            raise LeftError

    @contextmanager
    def _progress(self, segment: Segment) -> Iterator[Callable[[float], None]]:
        """A bar on a terminal; elsewhere the lines say enough."""
        if not self._console.is_terminal:
            yield lambda done: None
            return
        columns = (TextColumn(segment.name), BarColumn(), TimeRemainingColumn())
        with Progress(*columns, console=self._console, transient=True, redirect_stdout=False) as bar:
            task = bar.add_task(segment.name, total=segment.seconds)
            yield lambda done: bar.update(task, completed=done)
