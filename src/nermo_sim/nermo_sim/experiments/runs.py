"""What all experiments share: their settings, one run of one case, and how many runs become one row of a table."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

import mujoco
import numpy as np

from nermo_control.controller import Controller
from nermo_control.gait.knowledge_base import GaitParameters
from nermo_control.types import ControlCommand, Posture
from nermo_description.parameters import RobotParameters, TailModel
from nermo_description.robots import AnyRobot, ParameterError, load_any_robot
from nermo_sim.disturbance import Disturbance, DisturbedRun
from nermo_sim.experiments.result_log import ResultLog, fingerprint, seed_for
from nermo_sim.loop import Loop, constant
from nermo_sim.models import compiled
from nermo_sim.twin import Twin
from simgap.execution.batch import run_batch

REPEATS = 3
"""N A.4.2."""
SETTLE = 1.0
"""Time to stand still before the start [s]."""
FALLEN = math.radians(45.0)
"""Tilt beyond which the mouse has fallen."""

Progress = Callable[[int, int], None]
"""Called with the number of finished and of all runs."""
Result = dict[str, Any]
"""What one run gave: plain data, with units in the keys."""


class Case(Protocol):
    """One row of a table, a frozen dataclass of plain data."""

    @property
    def key(self) -> str:
        """Name of the row."""
        ...


CaseType = TypeVar("CaseType", bound=Case)


@dataclass(frozen=True, slots=True)
class Settings:
    """What all runs of all experiments have in common."""

    robot: str = "nermo_lite"
    distance: float = 2.0
    """Of the straight line [m], N 6.1.3 in simulation."""
    repeats: int = REPEATS
    seed: int = 0
    quick: bool = False
    disturbance: Disturbance = field(default_factory=Disturbance)
    gait_parameters: GaitParameters = field(default_factory=GaitParameters)
    tail: TailModel = "chain"
    variant: RobotParameters | None = None
    """A variation of the robot, in place of its file."""

    @property
    def parameters(self) -> AnyRobot:
        """Parameters of the robot as it runs. Raises ParameterError."""
        robot = self.variant or load_any_robot(self.robot)
        return robot.with_tail(self.tail) if isinstance(robot, RobotParameters) else robot

    @property
    def mouse(self) -> RobotParameters:
        """The same, where it must be a mouse. Raises ParameterError."""
        robot = self.parameters
        if not isinstance(robot, RobotParameters):
            raise ParameterError(f"robot {self.robot!r} is of the family {robot.family}; needed here is mouse")
        return robot

    @property
    def family(self) -> str:
        """Family of the robot. Raises ParameterError."""
        return self.parameters.family

    def digest(self, experiment: str) -> str:
        """Digest of all that the results depend on. The number of repeats is not part of it."""
        return fingerprint(
            {
                "experiment": experiment,
                "robot": self.parameters.model_dump(mode="json"),
                "gait_parameters": self.gait_parameters.model_dump(mode="json"),
                "distance": self.distance,
                "quick": self.quick,
                "seed": self.seed,
                "disturbance": asdict(self.disturbance),
                "mujoco": mujoco.__version__,
            }
        )


@dataclass(frozen=True, slots=True)
class Job(Generic[CaseType]):
    """One run of one case."""

    case: CaseType
    repeat: int
    settings: Settings

    @property
    def key(self) -> str:
        """Name of the run."""
        return f"{self.case.key}, run {self.repeat}"

    @property
    def seed(self) -> int:
        """Seed of the run's disturbances."""
        return seed_for(self.settings.seed, self.case.key, self.repeat)


def run_cases(
    run: Callable[[Job[CaseType]], Result],
    cases: Sequence[CaseType],
    settings: Settings,
    experiment: str,
    log_file: Path,
    workers: int | None = None,
    progress: Progress | None = None,
) -> list[list[Result]]:
    """Runs what is not yet in the log file; returns the results of each case's repeats, case by case.

    Raises ParameterError for an unusable robot and SimulationDivergedError.
    """
    log = ResultLog(log_file, settings.digest(experiment))
    jobs = [Job(case, repeat, settings) for case in cases for repeat in range(settings.repeats)]
    missing = [job for job in jobs if job.key not in log]
    done = len(jobs) - len(missing)
    if progress is not None:
        progress(done, len(jobs))
    for job, result in run_batch(run, missing, workers):
        log.add(job.key, result)
        done += 1
        if progress is not None:
            progress(done, len(jobs))
    return [[log[job.key] for job in jobs if job.case == case] for case in cases]


def standing_loop(job: Job[Any], scene: str = "flat") -> tuple[Loop[Any], DisturbedRun]:
    """The mouse on its feet at the start, and the disturbances that are to come."""
    settings, robot = job.settings, job.settings.mouse
    twin = Twin(robot, scene, model=compiled(robot, scene))
    loop = Loop(twin, Controller(robot, settings.gait_parameters, twin.period_ns))
    run = DisturbedRun(twin, settings.disturbance, job.seed)
    run.begin()
    loop.run(constant(ControlCommand(0, posture=Posture.STAND)), SETTLE, record=False)
    return loop, run


def full_speed(settings: Settings, gait: str, frequency: float) -> float:
    """No-slip speed [m/s] with the longest stride (5.21), which the high-level controller asks for (N A.4.2)."""
    return settings.gait_parameters.fastest(gait, frequency)


def mean(runs: Iterable[Result], name: str) -> float:
    """Mean of a quantity over the runs that have it; NaN where none has."""
    values = [run[name] for run in runs if run[name] is not None]
    return float(np.mean(values)) if values else math.nan


def spread(runs: Iterable[Result], name: str) -> float:
    """Standard deviation of a quantity over the runs that have it; NaN where none has."""
    values = [run[name] for run in runs if run[name] is not None]
    return float(np.std(values)) if values else math.nan


def rounded(values: Any, digits: int = 4) -> Any:
    """An array as nested lists of short numbers, to be kept as plain data."""
    return np.round(np.asarray(values, dtype=np.float64), digits).tolist()
