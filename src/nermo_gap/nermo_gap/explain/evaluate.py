"""What the twin's experiments give for a robot that deviates: in process, resumable, several at once."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from nermo_description.parameters import Deviation
from nermo_gap.explain.summary import QUANTITY, Run
from nermo_gap.robots.apply import write_robot
from nermo_sim.disturbance import NO_DISTURBANCE
from nermo_sim.divergence import SimulationDivergedError
from nermo_sim.experiments import balance, straight_line, turning
from nermo_sim.experiments.result_log import ResultLog, fingerprint
from nermo_sim.experiments.runs import Job, Settings
from simgap.execution.batch import run_batch
from simgap.execution.executors import PROCESSES

DISTANCE = 0.5
"""[m] of a straight run; a trot of six strides."""
Point = tuple[Deviation, ...]
Results = dict[str, float]
"""Result by the run's key: speed [m/s], time [s], or 1 and 0 for passed and failed."""
Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class _Task:
    robot: str
    run: Run
    key: str


class Evaluator:
    """Runs experiments of deviating robots; keeps what is done in a log, so that it goes on where it stopped.

    workers, place: as `open_pool` takes them.
    """

    def __init__(self, robot: str, folder: Path, workers: int | None = None, place: str = PROCESSES) -> None:
        # Workers elsewhere read the robots' files under the same path.
        folder = folder.resolve()
        self._robot, self._folder, self._workers, self._place = robot, folder, workers, place
        folder.mkdir(parents=True, exist_ok=True)
        digest = Settings(robot, DISTANCE, 1, 0, False, NO_DISTURBANCE).digest("explain")
        self._log = ResultLog(folder / "runs.jsonl", digest)

    def __call__(self, points: Sequence[Point], runs: Sequence[Run], progress: Progress | None = None) -> list[Results]:
        """Results of every run at every point (a set of deviations; the empty one is the twin itself)."""
        tasks = [
            _Task(self._file(point), run, _key(point, run))
            for point in points
            for run in runs
            if _key(point, run) not in self._log
        ]
        total = len(points) * len(runs)
        done = total - len(tasks)
        if progress is not None:
            progress(done, total)
        for task, result in run_batch(_run, tasks, self._workers, self._place):
            self._log.add(task.key, result)
            done += 1
            if progress is not None:
                progress(done, total)
        return [{run.key: _number(self._log[_key(point, run)]) for run in runs} for point in points]

    def _file(self, point: Point) -> str:
        """The robot with a point's deviations, as a parameter file."""
        if not point:
            return self._robot
        path = self._folder / f"robot_{_name(point)}.yaml"
        if not path.exists():
            write_robot(point, self._robot, path)
        return str(path)


def _name(point: Point) -> str:
    return fingerprint([d.model_dump(mode="json") for d in point])[:16] if point else "nominal"


def _key(point: Point, run: Run) -> str:
    return f"{_name(point)} {run.key}"


def _number(result: Any) -> float:
    return math.inf if result is None else float(result)


def _run(task: _Task) -> float | None:
    """One run; None is infinity: an arc that is not walked to its end."""
    settings = Settings(task.robot, DISTANCE, 1, 0, False, NO_DISTURBANCE)
    experiment: Any = {"straight_line": straight_line, "turning": turning, "balance": balance}[task.run.experiment]
    try:
        result = experiment.run(Job(task.run.case, 0, settings))
    except SimulationDivergedError:
        return None if task.run.experiment == "turning" else 0.0
    if task.run.experiment == "turning" and not result["followed"]:
        return None
    value = result[QUANTITY[task.run.experiment]]
    return None if value is None else float(value)
