"""What is asked of whoever can play a protocol through the graph. It is handed in: graphs are not this package's."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol as Interface

from nermo_description.parameters import RobotParameters
from nermo_gap.protocol.types import Protocol
from nermo_sim.experiments.on_robot import TWIN, DeadMan, Target


def is_twin(target: Target, port: str) -> bool:
    """Whether a target is the twin."""
    return target == "sim" or port == TWIN


class Watcher(Interface):
    """Whoever watches the mouse, where that is nobody at this terminal."""

    hint: str
    """What they are to do."""

    def held(self) -> bool:
        """Whether they let it move."""
        ...

    def tell(self, sentence: str) -> None:
        """They are told what happens."""
        ...

    def gone(self) -> bool:
        """Whether nobody waits for it any more."""
        ...


@dataclass(frozen=True)
class Request:
    """A protocol that is to be recorded through the graph, into a folder for each segment.

    Attributes:
        robot_file: name or parameter file of the robot, for the graph.
        out: a folder that is new or empty.
        target, port, calibration: as `nermo up` has them.
        dead_man: None is the space bar, and nothing where the twin is behind it.
        pad: which gamepad it is.
        seed: of the twin's sensors.
        watcher: instead of somebody at this terminal; then nothing is asked here, and `dead_man` does not count.
    """

    protocol: Protocol
    robot: RobotParameters
    robot_file: str
    out: Path
    target: Target
    port: str = TWIN
    calibration: Path | None = None
    dead_man: DeadMan | None = None
    pad: str = "xbox"
    seed: int = 0
    watcher: Watcher | None = None

    @property
    def on_twin(self) -> bool:
        """Whether it is the twin that moves, and nobody has to watch it."""
        return is_twin(self.target, self.port)

    @property
    def watched_by(self) -> DeadMan:
        """What is held while the mouse moves."""
        return self.dead_man or ("none" if self.on_twin else "space")


ThroughGraph = Callable[[Request], list[Path]]
"""Records a request; returns the folders of the segments, in order."""
