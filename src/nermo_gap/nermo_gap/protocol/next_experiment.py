"""The next experiment that a diagnosis proposes, played through the graph while a hand holds the page's button."""

from __future__ import annotations

import itertools
import math
import shlex
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from nermo_control.holding import WhoHolds
from nermo_description.results import CommandError
from nermo_description.robots import load_robot
from nermo_gap.protocol.through_graph import Request, ThroughGraph, is_twin
from nermo_gap.protocol.types import Protocol, Rows, Segment
from nermo_sim.experiments.on_robot import TWIN, Target
from simgap.analysis.experiment import Experiment
from simgap.data.plant import Plant
from simgap.live.player import Hand, Played, Tell

NAME = "next_experiment"
LOOK_S, BEFORE_S = 1.2, 0.15
"""[s] between two places where a diagnosis looks, and from the first one to the first motion: about as in the standard
protocol, so that each look has a motion in it and none overlaps another."""
ALONE_S = 30.0
"""So long the graph, once it is up, waits for a hand; then it goes down."""


def protocol_of(experiment: Experiment, plant: Plant) -> Protocol:
    """An experiment as a protocol of one piece."""
    names = [channel.name for channel in plant.inputs]
    seconds = len(experiment.inputs) * experiment.period
    looks, last = [experiment.settle - BEFORE_S], seconds - LOOK_S
    while looks[-1] + LOOK_S < last:
        looks.append(looks[-1] + LOOK_S)
    rows = tuple(dict(zip(names, map(float, row), strict=True)) for row in experiment.inputs)
    tell = experiment.description
    piece = Rows(experiment.name, tell, seconds, looks=tuple(looks), period=experiment.period, rows=rows)
    return Protocol(NAME, (Segment(experiment.name.replace(" ", "_"), "floor", tell, (piece,)),))


@dataclass
class Beside:
    """What a diagnosis knows beside the experiment.

    Attributes:
        robot: name or parameter file of the mouse.
        recordings: what was diagnosed.
        folder: of the diagnosis; recordings of the experiment come beside it there.
        named: whether the recordings do not say themselves which robot they are of.
    """

    robot: str
    recordings: Sequence[Path]
    folder: Path
    named: bool


class HeldPlayer:
    """A `simgap.live.player.Player` of the mouse.

    Args:
        through_graph: records a request.
        target, port, calibration: as `nermo up` has them.
        patience: [s] for which a graph waits for a hand.
        clock: [s], never back.
    """

    hint = "hold the button"

    def __init__(
        self,
        through_graph: ThroughGraph,
        target: Target,
        port: str = TWIN,
        calibration: Path | None = None,
        patience: float = ALONE_S,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._clock = clock
        self._through_graph, self._target, self._port, self._calibration = through_graph, target, port, calibration
        twin = is_twin(target, port)
        self.robot = "the twin" if twin else "the robot"
        self.prepare = "" if twin else "Set the mouse down on the floor, with half a metre in front of it."
        self.beside: Beside | None = None
        """To be given before something is played."""
        self._hands, self._guard = WhoHolds(), threading.Lock()
        self._patience, self._wanted, self._say = patience, 0.0, list[Tell]()

    # What pages do, in their threads

    def join(self, viewer: int) -> None:
        """See `Player`."""
        with self._guard:
            self._hands.join(viewer)

    def leave(self, viewer: int) -> None:
        """See `Player`."""
        with self._guard:
            self._hands.leave(viewer, self._clock())

    def hold(self, hand: Hand) -> str:
        """See `Player`."""
        arrived = self._clock()
        with self._guard:
            if not self._hands.knows(hand.viewer):
                return "this page is not known here: load it again"
            return self._hands.press(hand.viewer, hand.press, hand.sent * 1e-3, arrived) or ""

    # What plays, in the command's

    def held(self) -> bool:
        """See `Player`."""
        with self._guard:
            held = self._hands.holds(self._clock())
        if held:
            self._wanted = max(self._wanted, self._clock())
        return held

    def tell(self, sentence: str) -> None:
        """Whoever looks at the page is told."""
        self._wanted = self._clock()
        for say in self._say:
            say(sentence)

    def gone(self) -> bool:
        """Whether nobody has held it for long."""
        return not self.held() and self._clock() - self._wanted > self._patience

    def play(self, experiment: Experiment, plant: Plant, tell: Tell) -> Played:
        """See `Player`."""
        assert self.beside is not None
        beside, self._say = self.beside, [tell]
        numbered = (beside.folder / f"{NAME}_{number}" for number in itertools.count(1))
        out = next(folder for folder in numbered if not folder.exists())
        self.tell("the graph comes up, which takes some seconds")
        self._wanted = math.inf  # until it is up, and the session says so
        request = Request(
            protocol_of(experiment, plant),
            load_robot(beside.robot),
            beside.robot,
            out,
            self._target,
            self._port,
            self._calibration,
            watcher=self,
        )
        try:
            self._through_graph(request)
        except CommandError as error:
            return Played(f"Not played to its end: {error}")
        finally:
            self._say = []
            with self._guard:
                # Who still presses has to press again.
                self._hands.let_go(self._clock())
        robot = ("--robot", beside.robot) if beside.named else ()
        words = ("nermo", "gap", "diagnose", *map(str, beside.recordings), str(out), *robot)
        return Played("Played to its end, and recorded:", str(out), shlex.join(words))
