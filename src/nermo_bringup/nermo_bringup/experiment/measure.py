"""N's dependent variables of a recorded run, and how well whoever watched the mouse knows them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from nermo_gap.protocol.scene import BAG_FOLDER, SceneFile
from nermo_gap.protocol.types import REST
from nermo_gap.robots.mcap_table import TRACKERS
from nermo_node.recording_reader import Recording, RecordingError
from nermo_sim.experiments.on_robot import Way
from nermo_sim.experiments.runs import Result

Array = NDArray[np.float64]

LONGEST_GAP = 0.5
"""[s] Poses farther apart are warned of: a third of the slowest stride."""
LEAST = 10
"""Poses that a run needs."""
DRAWS = 100
"""Of the tracker's error; the deviation that they tell is then itself uncertain by 7 %."""


@dataclass(frozen=True)
class Seen:
    """Where somebody outside saw base_link."""

    topic: str
    stamp: NDArray[np.int64]
    """(n,) [ns], rising."""
    position: Array
    """(n, 3) [m]"""
    rotation: Rotation
    """n of them"""
    covariance: Array
    """(n, 6, 6) [m, rad, fixed axes]; zero where it is not told."""


@dataclass(frozen=True)
class Measured:
    """What a run gave."""

    result: Result
    tracker: dict[str, float]
    """By quantity: its standard deviation because of the tracker; empty where the tracker tells none."""
    topic: str
    """Whose poses these are."""
    gap: float
    """[s] Longest time without a pose."""


def seen_in(folder: Path) -> Seen | None:
    """The tracker's poses in a run's recording; a simulation's truth stands in for one. None where nobody saw it.

    Raises:
        RecordingError: the recording cannot be read, or holds hardly a pose.
    """
    recording = Recording(folder / BAG_FOLDER)
    ends = [[topic for topic in recording.topics if topic.endswith(f"/{name}")] for name in TRACKERS]
    topic = next((min(found, key=len) for found in ends if found), None)
    if topic is None:
        return None
    data = recording.read([topic])[topic]
    stamp, rows = np.unique(data.stamp, return_index=True)
    place = np.column_stack([data[f"pose.pose.position.{axis}"] for axis in "xyz"])[rows]
    turn = np.column_stack([data[f"pose.pose.orientation.{part}"] for part in "wxyz"])[rows]
    usable = np.isfinite(place).all(axis=1) & (np.abs(np.linalg.norm(turn, axis=1) - 1.0) < 0.01)
    if usable.sum() < LEAST:
        raise RecordingError(f"{folder}: {topic} holds {usable.sum()} poses; a run needs {LEAST}")
    covariance = np.nan_to_num(np.asarray(data["pose.covariance"], dtype=np.float64)[rows].reshape(-1, 6, 6))
    return Seen(
        topic,
        stamp[usable],
        place[usable],
        Rotation.from_quat(turn[usable], scalar_first=True),
        np.where((covariance[:, :1, :1] < 0.0), 0.0, covariance)[usable],
    )


@dataclass(frozen=True)
class _Walked:
    """A walk at equal steps, from the mean pose of the stand before it."""

    time: Array
    position: Array
    rotation: Rotation
    rows: NDArray[np.int64]
    """(n,) Of the poses from which these come, as far as their errors go."""

    def way(self, error: Array | None = None) -> Way:
        """With errors (n, 6) [m, rad, fixed axes], or without."""
        place, turn = self.position, self.rotation
        if error is not None:
            place, turn = place + error[:, :3], Rotation.from_rotvec(error[:, 3:]) * turn
        angles = turn.as_euler("ZYX")[:, ::-1].copy()
        angles[:, 2] = np.unwrap(angles[:, 2])
        return Way(self.time, place, angles)


def measure(
    seen: Seen, scene: SceneFile, seconds: float, of_way: Callable[[Way], Result], clock: float = 0.0, seed: int = 0
) -> Measured:
    """What ``of_way`` makes of the walk of a run, and by how much the tracker's error moves it.

    The error of each pose is drawn from its covariance anew. What the poses share, as where the camera is, then counts
    as if it were not shared: a speed looks no better than it is. ``clock`` [s] is the deviation of the film's clock,
    which moves the begin of the walk. ``seconds`` is what the walk's piece would have lasted.

    Raises:
        RecordingError: the mouse was not seen before or during its walk.
    """
    walked, gap = _walked(seen, scene, seconds)
    result, random = of_way(walked.way()), np.random.default_rng(seed)
    if not seen.covariance.any() and clock == 0.0:
        return Measured(result, {}, seen.topic, gap)
    roots = _roots(seen.covariance)
    numbers = [name for name, value in result.items() if isinstance(value, float)]
    drawn = np.empty((DRAWS, len(numbers)))
    for row in range(DRAWS):
        if clock > 0.0:
            walked, _ = _walked(seen, scene, seconds, clock * float(random.standard_normal()))
        error = np.einsum("nij,nj->ni", roots[walked.rows], random.standard_normal((len(walked.rows), 6)))
        other = of_way(walked.way(error))
        drawn[row] = [math.nan if other[name] is None else other[name] for name in numbers]
    deviation = dict(zip(numbers, map(float, np.nanstd(drawn, axis=0)), strict=True))
    return Measured(result, deviation, seen.topic, gap)


def _walked(seen: Seen, scene: SceneFile, seconds: float, late: float = 0.0) -> tuple[_Walked, float]:
    """The walk, and the longest time [s] without a pose in it; ``late`` [s]: by how much poses are later than told."""
    if scene.begun is None:
        raise RecordingError("a run of no graph has no clock")
    walk = scene.pieces[-1]
    begin = scene.begun + round((walk.begin + REST) * 1e9)
    time = np.asarray((seen.stamp - begin) * 1e-9 + late, dtype=np.float64)
    before = (time >= -REST) & (time <= 0.0)
    # Whoever lets go ends the walk at once; a piece that ends by itself stands for a while before.
    end = min(walk.end - walk.begin, seconds - REST) - REST
    during = (time > 0.0) & (time <= end)
    if not before.any():
        raise RecordingError("the mouse was not seen in the stand before its walk: film from before it moves")
    if during.sum() < LEAST:
        raise RecordingError(f"the mouse was seen {during.sum()} times in its walk; a run needs {LEAST}")
    rows = np.concatenate([[int(np.flatnonzero(before)[-1])], np.flatnonzero(during)])
    own = np.concatenate([[0.0], time[during]])
    place = np.vstack([seen.position[before].mean(axis=0), seen.position[during]])
    turn = Rotation.concatenate([seen.rotation[before].mean(), seen.rotation[during]])
    steps = max(round(float(own[-1] / np.median(np.diff(own)))), 1)
    even = np.linspace(0.0, own[-1], steps + 1)
    next_pose = np.minimum(np.searchsorted(own, even), len(own) - 1)
    position = np.column_stack([np.interp(even, own, column) for column in place.T])
    return _Walked(even, position, Slerp(own, turn)(even), rows[next_pose]), float(np.diff(own).max())


def _roots(covariance: Array) -> Array:
    """(n, 6, 6) Square roots of covariances (n, 6, 6)."""
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :], dtype=np.float64)


def summary(runs: list[Measured], names: tuple[str, ...]) -> dict[str, Any]:
    """Of some repeats: means, `scatter_*` between them, `tracker_*` of one, by quantity; None where no run has it.

    The scatter is the standard deviation of a sample, None of a single run. The tracker's deviation is that of a run
    in the root mean square, None where it tells none: repeats are filmed by the same camera, whose place is off in the
    same way in all of them.
    """
    row: dict[str, Any] = {}
    for name in names:
        values = [float(run.result[name]) for run in runs if run.result[name] is not None]
        row[name] = float(np.mean(values)) if values else None
        row[f"scatter_{name}"] = float(np.std(values, ddof=1)) if len(values) > 1 else None
        told = [run.tracker[name] ** 2 for run in runs if name in run.tracker]
        row[f"tracker_{name}"] = float(np.sqrt(np.mean(told))) if told else None
    return row
