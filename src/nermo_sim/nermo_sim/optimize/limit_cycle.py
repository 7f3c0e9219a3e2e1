"""Gaits of a robot with pantograph legs by staged fitness and particle swarm (C 3.2.4, table 3.4).

The stages are a weak ordering: who reaches a higher stage is better, and within a stage its own value counts. A swarm
needs no more than that. All is deterministic for a seed, and rollouts are kept: a search that was stopped begins anew,
finds its rollouts done, and goes on to the same end.
"""

from __future__ import annotations

import copy
import functools
import math
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import asdict, dataclass, field
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from nermo_control.pantograph_controller import LocusShape, PantographController, PantographGait
from nermo_control.types import ControlCommand, Posture
from nermo_description.model import build_model
from nermo_description.pantograph import PantographParameters
from nermo_description.robots import load_of_family
from nermo_sim.disturbance import Disturbance, DisturbedRun
from nermo_sim.divergence import SimulationDivergedError
from nermo_sim.experiments.losses import foot_motion
from nermo_sim.experiments.pantograph import FREQUENCY, STEP_LENGTH, TOUCHING
from nermo_sim.experiments.result_log import ResultLog, fingerprint, seed_for
from nermo_sim.experiments.runs import FALLEN
from nermo_sim.loop import Loop, constant
from nermo_sim.optimize.rollouts import Rollouts
from nermo_sim.run_table import Recording
from nermo_sim.twin import Twin

Array = NDArray[np.float64]
STAND = 0.3
"""[s]"""
_SHAPE = {
    "height": (0.105, 0.135),
    "step_height": (0.008, 0.035),
    "offset": (-0.045, 0.02),
    "compression": (0.5, 1.0),
    "touch_down_angle": (1.2, 2.2),
    "take_off_angle": (0.9, 1.9),
}
BOUNDS: dict[str, tuple[float, float]] = {
    **{f"{pair}.{name}": bounds for pair in ("front", "rear") for name, bounds in _SHAPE.items()},
    "duty_factor": (0.4, 0.7),
    "frequency_hz": (1.5, 3.5),
    "step_length_m": (0.05, 0.13),
}
"""Range of each open parameter (C table 3.3; C has 14 to 16): metres, radians, hertz."""
Values = dict[str, float]

SURVIVED, MISMATCH, SLIP = 0.98, 0.3, 0.3
"""What leads from one stage to the next [1]: share of the run survived (C has 0.5, with which a robot that falls in the
second half passes, and nothing later counts it), mismatch of phases and contacts (C, whose sign is misprinted), and
slip over way, where C prints the mismatch again."""
FINALISTS = 8
"""Leaders of a search that are judged once more, under disturbances that it did not see."""


@dataclass(frozen=True, slots=True)
class Trot:
    """What all rollouts of a search have in common."""

    robot: str = "cheetah_cub"
    duration: float = 4.0
    """[s]"""
    disturbance: Disturbance = field(default_factory=Disturbance)

    def digest(self) -> str:
        """Of all that a rollout depends on, but for its parameters and its trial."""
        robot = load_of_family(PantographParameters, self.robot).model_dump(mode="json")
        return fingerprint({**asdict(self), "robot": robot, "mujoco": mujoco.__version__})


@dataclass(frozen=True, slots=True)
class Rollout:
    """One job: plain, picklable data."""

    trot: Trot
    values: tuple[float, ...]
    """In the order of BOUNDS."""
    trial: int
    """Seed of the disturbances."""

    @property
    def key(self) -> str:
        """Name of the rollout, by its content."""
        return fingerprint([list(self.values), self.trial])[:24]


def gait_of(values: Sequence[float]) -> tuple[PantographGait, float, float]:
    """Gait, frequency [Hz] and step length [m] of values in the order of BOUNDS."""
    named = dict(zip(BOUNDS, values, strict=True))
    pairs = {pair: LocusShape(**{name: named[f"{pair}.{name}"] for name in _SHAPE}) for pair in ("front", "rear")}
    gait = PantographGait(**pairs, duty_factor=named["duty_factor"])
    return gait, named["frequency_hz"], named["step_length_m"]


def default_values() -> tuple[float, ...]:
    """Of the gait that comes with the controller, within BOUNDS."""
    gait = PantographGait()
    named = {f"{pair}.{name}": getattr(getattr(gait, pair), name) for pair in ("front", "rear") for name in _SHAPE}
    named |= {"duty_factor": gait.duty_factor, "frequency_hz": FREQUENCY, "step_length_m": STEP_LENGTH}
    return tuple(min(max(named[name], low), high) for name, (low, high) in BOUNDS.items())


def run(rollout: Rollout) -> dict[str, float]:
    """Trots with the open-loop CPG; a fall or a simulation that runs away is a result."""
    try:
        recording, twin = walk(rollout)
    except SimulationDivergedError:
        return {"survived": 0.0, "speed_m_s": 0.0, "mismatch": 1.0, "slip": 1.0, "pitch_rad": 1.0, "roll_rad": 1.0}
    return measure(recording, twin.model, rollout.trot.duration)


def walk(rollout: Rollout) -> tuple[Recording, Twin[PantographParameters]]:
    """The trot of a rollout, until its end or a fall. Raises SimulationDivergedError."""
    robot, model = _compiled(rollout.trot.robot)
    gait, frequency, length = gait_of(rollout.values)
    twin = Twin(robot, model=copy.copy(model))
    loop = Loop(twin, PantographController(robot, gait, twin.period_ns))
    disturbed = DisturbedRun(twin, rollout.trot.disturbance, rollout.trial)
    velocity = length * frequency / gait.duty_factor
    command = ControlCommand(0, forward_velocity=velocity, gait="trot", gait_frequency=frequency)
    disturbed.begin()
    loop.run(constant(ControlCommand(0, posture=Posture.STAND)), STAND, record=False)
    recording = loop.run(
        constant(command), rollout.trot.duration, until=lambda twin: twin.tilt() > FALLEN, before_tick=disturbed.tick
    )
    return recording, twin


def measure(recording: Recording, model: mujoco.MjModel, duration: float) -> dict[str, float]:
    """t_r, V_com [m/s], c_mis, slip over way, and the deviations of pitch and roll [rad] (C table 3.4).

    Slip is how far the feet slide forward or back while they touch, over the way of the body, a mean over the feet.
    """
    time = recording.time
    survived = float(time[-1]) / duration
    # The planned phase is that of the tick; a foot touches where its sensor feels it.
    touching = recording.foot_forces > TOUCHING
    mismatch = float(np.mean(touching == (recording.phases == 1)))
    way = float(recording.position[-1, 0] - recording.position[0, 0])
    feet, _, _ = foot_motion(recording, model)
    moved = np.abs(np.diff(feet[:, :, 0], axis=0)) * (touching[1:] & touching[:-1])
    slip = float(moved.sum(axis=0).mean()) / max(abs(way), 0.05)
    angles = recording.roll_pitch_yaw
    return {
        "survived": min(survived, 1.0),
        "speed_m_s": way / max(float(time[-1]), 0.1),
        "mismatch": mismatch,
        "slip": slip,
        "pitch_rad": float(angles[:, 1].std()),
        "roll_rad": float(angles[:, 0].std()),
    }


def stage_and_value(metrics: dict[str, float]) -> tuple[int, float]:
    """Stage reached and its fitness (C table 3.4); the larger the better, stage first.

    A robot that walks backwards is worth nothing in any stage, and never passes the first.
    """
    speed = max(metrics["speed_m_s"], 0.0)
    value = speed * math.exp(metrics["survived"] - 1.0)
    if metrics["survived"] <= SURVIVED or speed == 0.0:
        return 0, value
    value = speed * math.exp(-10.0 * metrics["mismatch"] ** 2)
    if metrics["mismatch"] >= MISMATCH:
        return 1, value
    value *= math.exp(-((metrics["slip"] / SLIP) ** 2))  # C's l_slip^2 / 500 has no unit
    if metrics["slip"] >= SLIP:
        return 2, value
    return 3, value * math.exp(-(metrics["pitch_rad"] + metrics["roll_rad"]) / 0.3)


def cost(metrics: dict[str, float]) -> float:
    """A number that orders as the stages do, to be minimised: minus the stage, minus the value in [0, 1)."""
    stage, value = stage_and_value(metrics)
    return -(stage + value / (1.0 + value))


@dataclass(slots=True)
class Found:
    """What a search found."""

    best: tuple[float, ...]
    best_metrics: dict[str, float]
    baseline_metrics: dict[str, float]
    unseen: dict[str, dict[str, float]]
    """Of baseline and best, under disturbances that the search did not see."""
    history: list[float]
    """Least cost after each iteration."""
    rollouts: int
    rollouts_now: int
    seconds: float
    """Spent on the rollouts of now."""


class Swarm:
    """A particle swarm over BOUNDS; executor and log as those of the other searches."""

    def __init__(
        self, executor: Executor, log: ResultLog, trot: Trot, seed: int, done: Callable[[], None] = lambda: None
    ) -> None:
        self._rollouts = Rollouts(run, executor, log, done)
        self._trot, self._seed = trot, seed
        self._low, self._high = np.array(list(BOUNDS.values())).T

    def search(self, particles: int, iterations: int, unseen: int = 4) -> Found:
        """Minimises `cost` of one disturbed trot; the start is the controller's own gait among random ones.

        A long search learns its one disturbance by heart. Of the last FINALISTS that led it, the one that does best
        under ``unseen`` others is taken; how good it is, is told by as many that had no say in anything.
        """
        from pymoo.algorithms.soo.nonconvex.pso import PSO

        from nermo_sim.optimize.search import minimise

        trial = [seed_for(self._seed, "search")]
        history: list[float] = []
        leaders: list[tuple[float, tuple[float, ...]]] = []

        def costs(points: Array) -> Array:
            values = [self._values(point) for point in points]
            found = [cost(metrics) for metrics in self._evaluate(values, trial)]
            best = min(zip(found, values, strict=True))
            if not leaders or best < leaders[-1]:
                leaders.append(best)
            history.append(leaders[-1][0])
            return np.array(found)[:, None]

        random = np.random.default_rng(self._seed)
        first = random.uniform(0.0, 1.0, (particles, len(BOUNDS)))
        first[0] = (np.array(default_values()) - self._low) / (self._high - self._low)
        algorithm = PSO(pop_size=particles, sampling=first, adaptive=True)
        minimise(algorithm, costs, len(BOUNDS), 1, iterations, self._seed)
        base, final = default_values(), [values for _, values in leaders[-FINALISTS:]]
        judged = self._evaluate(final, [seed_for(self._seed, "final", number) for number in range(unseen)])
        best = min(zip([cost(metrics) for metrics in judged], final, strict=True))[1]
        trials = [seed_for(self._seed, "unseen", number) for number in range(unseen)]
        return Found(
            best,
            self._evaluate([best], trial)[0],
            self._evaluate([base], trial)[0],
            {"baseline": self._evaluate([base], trials)[0], "best": self._evaluate([best], trials)[0]},
            history,
            self._rollouts.count,
            self._rollouts.run_now,
            self._rollouts.seconds,
        )

    def _values(self, point: Array) -> tuple[float, ...]:
        return tuple(np.round(self._low + np.clip(point, 0.0, 1.0) * (self._high - self._low), 6).tolist())

    def _evaluate(self, candidates: Sequence[tuple[float, ...]], trials: Sequence[int]) -> list[dict[str, float]]:
        """The mean over the trials of each candidate."""
        jobs = [[Rollout(self._trot, values, trial) for trial in trials] for values in candidates]
        return [_mean(each) for each in self._rollouts.results(jobs)]


def _mean(runs: Sequence[dict[str, Any]]) -> dict[str, float]:
    return {name: float(np.mean([one[name] for one in runs])) for name in runs[0]}


@functools.lru_cache(maxsize=2)
def _compiled(robot: str) -> tuple[PantographParameters, mujoco.MjModel]:
    parameters = load_of_family(PantographParameters, robot)
    return parameters, build_model(parameters)
