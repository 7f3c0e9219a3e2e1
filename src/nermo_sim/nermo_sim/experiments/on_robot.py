"""An experiment on the real mouse as N did it: what is played, where the mouse is put, and what is measured of it."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Generic, Literal

import numpy as np
from numpy.typing import NDArray

from nermo_control.driver import Steering
from nermo_control.types import ControlCommand
from nermo_description.parameters import RobotParameters
from nermo_sim.experiments.experiment import Experiment, Repeats, Row
from nermo_sim.experiments.runs import CaseType, Result, Settings

Array = NDArray[np.float64]

Target = Literal["sim", "serial", "link"]
"""What takes the servo commands: the twin in the graph, the robot at a cable, over Wi-Fi."""
DeadMan = Literal["space", "pad", "none"]
"""What the person beside the mouse holds while it moves."""
SHORTEST, LONGEST = 0.25, 20.0
"""[m] of a run: the shortest has a whole stance of each leg, without which the twin's losses mean nothing."""
TWIN = "twin"
"""The port of an emulated device with the twin behind it."""


@dataclass(frozen=True, slots=True)
class Way:
    """How a mouse went in one run, from when it was told to walk; see `run_table.Moved`."""

    time: Array
    """(n,) [s], at equal steps."""
    position: Array
    """(n, 3) [m]"""
    roll_pitch_yaw: Array
    """(n, 3) [rad]"""

    def __post_init__(self) -> None:
        if len(self.time) < 2:
            raise ValueError("a way has two poses at least")

    def until(self, distance: float) -> Way:
        """The part up to the end line, ``distance`` [m] along the first heading; all of it where none is crossed."""
        beyond = self.along() >= distance
        end = max(int(np.argmax(beyond)) + 1, 2) if beyond.any() else len(self.time)
        return Way(self.time[:end], self.position[:end], self.roll_pitch_yaw[:end])

    def along(self) -> Array:
        """(n,) [m] From the first pose along its heading."""
        heading = float(self.roll_pitch_yaw[0, 2])
        off = self.position[:, :2] - self.position[0, :2]
        return np.asarray(off @ np.array([math.cos(heading), math.sin(heading)]), dtype=np.float64)


@functools.cache
def mouse_of(robot: str) -> RobotParameters:
    """Parameters of the mouse of this name or file, read once. Raises ParameterError."""
    return Settings(robot).mouse


@dataclass(frozen=True, slots=True)
class Said:
    """A run of which an operator says what the mouse is to do."""

    command: ControlCommand
    """For the whole of the run."""
    steering: Steering | None = None
    """How whoever stands beside the mouse steers it meanwhile; None where nobody does."""


@dataclass(frozen=True, slots=True)
class Posed:
    """A run that says where the servos are, tick by tick."""

    period: float
    """[s] From one row to the next."""
    rows: tuple[Mapping[str, float], ...]
    """[rad] by servo."""


@dataclass(frozen=True, slots=True, kw_only=True)
class OnRobot(Generic[CaseType]):
    """How one experiment is done on the real mouse. To add one, write such a record and name it in `registry.py`."""

    experiment: Experiment[CaseType]
    """The same on the twin."""
    distance: float | None = None
    """[m] of a run, N's; None where the case says it, or nothing is walked."""
    cases: Callable[[bool], Sequence[CaseType]]
    """N's on the robot; fewer where the argument, `quick`, is true."""
    name: Callable[[CaseType], str]
    """Short, as a folder may be named."""
    place: Callable[[CaseType, Settings], str]
    """Where the mouse is to be put for a run, and how much room it needs."""
    played: Callable[[CaseType, Settings], Said | Posed]
    """What the mouse is told in a run."""
    seconds: Callable[[CaseType, Settings], float]
    """[s] After which a run ends by itself."""
    measure: Callable[[CaseType, Way, Settings], Result]
    """N's dependent variables of a run."""
    measured: tuple[str, ...]
    """Those of which the table shows means and uncertainties; the first is the one that N prints."""
    every: tuple[str, ...] = ()
    """What is so of a row where it is so of every run."""
    describe: Callable[[CaseType], Row]
    """What a row says of its case."""
    thesis: Callable[[CaseType], Row]
    """N's printed numbers: `thesis_robot_*` and `thesis_twin_*`, None where N prints none."""
    claims: Callable[[Sequence[Row]], list[Row]]
    """N's claims of its robot beside these rows, as `claims.board` has them."""
    picture: Callable[[Sequence[Row], Path], None]
    """Draws the rows."""
    other_distances: bool = True
    """Whether a run may be over another distance than N's, on the twin too."""
    repeats: Repeats = field(default_factory=Repeats)


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotRequest:
    """What the user asks of an experiment on the real mouse; None is what the folder, or N, says."""

    name: str
    """Of the experiment."""
    folder: Path
    """Of this experiment's results."""
    json: Path | None
    robot: str | None
    seed: int
    quick: bool
    repeats: int | None
    workers: int | None
    distance: float | None
    target: Target | None
    """None: nothing is played; what is recorded is evaluated."""
    port: str
    calibration: Path | None
    dead_man: DeadMan | None
    pad: str
    yes: bool
    film: Sequence[Path]
    camera: Sequence[Path]
    tags: Path | None
    fps: float | None


OnTheRobot = Callable[[RobotRequest], None]
"""Does a request: plays, evaluates, prints and writes."""
