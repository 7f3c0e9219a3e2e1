"""What is asked of whoever can play a protocol through the graph. It is handed in: graphs are not this package's."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from nermo_description.parameters import RobotParameters
from nermo_gap.protocol.types import Protocol
from nermo_sim.experiments.on_robot import TWIN, DeadMan, Target


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

    @property
    def on_twin(self) -> bool:
        """Whether it is the twin that moves, and nobody has to watch it."""
        return self.target == "sim" or self.port == TWIN

    @property
    def watched_by(self) -> DeadMan:
        """What is held while the mouse moves."""
        return self.dead_man or ("none" if self.on_twin else "space")


ThroughGraph = Callable[[Request], list[Path]]
"""Records a request; returns the folders of the segments, in order."""
