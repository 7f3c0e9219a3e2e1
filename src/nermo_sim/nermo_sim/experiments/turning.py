"""The turning experiment (N 6.1.4, 6.2.2): time on arcs and smallest radius by gait, frequency and strategy."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from nermo_control.high_level_controller import HighLevelController, HighLevelControllerConfig
from nermo_control.path import Path, PathStatus
from nermo_control.types import ControlCommand, TrajectoryMode, TurningStrategy
from nermo_description.parameters import RobotParameters
from nermo_sim.experiments.experiment import Experiment
from nermo_sim.experiments.orientation import tick
from nermo_sim.experiments.runs import FALLEN, Job, Result, Settings, full_speed, mean, spread, standing_loop
from nermo_sim.experiments.straight_line import FREQUENCIES, GAITS
from nermo_sim.loop import constant
from nermo_sim.run_table import Moved
from nermo_sim.twin import Twin

STRATEGIES: tuple[TurningStrategy, ...] = get_args(TurningStrategy)
RADII = (1.0, 0.5)
"""[m], N table 6.3."""
FULL_LOCK = 0.0
"""The path radius of N table 6.3 that stands for the largest turn rate all the time."""
ARC_ANGLE = 0.5 * math.pi
"""Part of the circle that is walked [rad]. N does not print it (figure 6.4): a quarter circle of 0.5 m at N's speeds on
the straight line comes nearest to the 13 s of table 6.4 among quarter, half and whole circles."""
LOCK_ANGLE = math.pi
"""How far the mouse turns at full lock [rad]."""
HARD_LEFT = 100.0
"""A turn rate beyond any strategy's, clipped to full lock [rad/s]."""
LONGEST = 60.0
"""A run at full lock ends after this time at the latest [s]."""
TOLERANCE = 0.05
"""Farther from the arc the mouse does not follow it [m]: a tenth of the smaller radius, less than half its width."""
RADIUS_AT = "shoulder_axis"
THESIS_TIMES = {"spine": 13.0, "leg": 18.4, "mix": 14.5}
"""[s], trot at 0.67 Hz on the 0.5 m arc, N table 6.4."""
THESIS_RADII = {
    ("trot", 0.67, "leg"): 0.174,
    ("trot", 0.67, "mix"): 0.135,
    ("lateral_walk", 0.5, "spine"): 0.49,
    ("lateral_walk", 0.8, "spine"): 0.96,
}
"""[m], N 6.2.2; the first two are printed without a frequency."""

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Case:
    """One row of the table."""

    gait: str
    frequency_hz: float
    strategy: TurningStrategy
    path_radius_m: float

    @property
    def key(self) -> str:
        """Name of the row."""
        path = f"arc of {self.path_radius_m} m" if self.path_radius_m else "full lock"
        return f"{self.gait} {self.frequency_hz} Hz, {self.strategy}, {path}"


def cases(quick: bool = False) -> list[Case]:
    """All rows of N table 6.3; quick keeps the trot at 0.67 Hz and the one case that failed."""
    if quick:
        rows = [Case("trot", 0.67, strategy, radius) for strategy in STRATEGIES for radius in (0.5, FULL_LOCK)]
        return [*rows, Case("lateral_walk", 0.8, "spine", 0.5)]
    return [
        Case(gait, frequency, strategy, radius)
        for gait in GAITS
        for frequency in FREQUENCIES
        for strategy in STRATEGIES
        for radius in (*RADII, FULL_LOCK)
    ]


def theory_radius(case: Case, settings: Settings, robot: RobotParameters) -> float:
    """Predicted radius [m]: the arc's own, or that of full lock by (5.40)-(5.44)."""
    controller = HighLevelController(robot, settings.gait_parameters)
    return case.path_radius_m or controller.smallest_radius(case.strategy)


def run(job: Job[Case]) -> Result:
    """Walks an arc to its end, or half a circle at full lock; the path lost is a result, not an error."""
    case, settings = job.case, job.settings
    loop, disturbed = standing_loop(job)
    controller = loop.controller.high_level_controller
    controller.set_config(HighLevelControllerConfig(lockstep=True, path_tolerance=TOLERANCE))
    speed = full_speed(settings, case.gait, case.frequency_hz)
    command = ControlCommand(
        0,
        forward_velocity=speed,
        turn_rate=HARD_LEFT,
        trajectory_mode=TrajectoryMode.PATH if case.path_radius_m else TrajectoryMode.EXTERNAL,
        gait=case.gait,
        gait_frequency=case.frequency_hz,
        turning_strategy=case.strategy,
    )
    longest = LONGEST
    if case.path_radius_m:
        path = Path.arc(controller.guide_pose(loop.twin.odometry()), case.path_radius_m, ARC_ANGLE)
        controller.follow(path)
        longest = 4.0 * path.length / speed
    turned, last, farthest = 0.0, loop.twin.odometry().yaw, 0.0

    def ended(twin: Twin[Any]) -> bool:
        nonlocal turned, last, farthest
        yaw = twin.odometry().yaw
        turned += (yaw - last + math.pi) % (2.0 * math.pi) - math.pi
        last = yaw
        farthest = max(farthest, abs(controller.cross_track))
        if twin.tilt() > FALLEN:
            return True
        if case.path_radius_m:
            return controller.path_status not in (PathStatus.IDLE, PathStatus.FOLLOWING)
        return abs(turned) >= LOCK_ANGLE

    recording = loop.run(constant(command), longest, until=ended, before_tick=disturbed.tick)
    finished = controller.path_status is PathStatus.FINISHED if case.path_radius_m else abs(turned) >= LOCK_ANGLE
    fell = loop.twin.tilt() > FALLEN
    points = guide_points(recording, loop.twin.robot)
    radius = fitted_radius(points, recording, case.frequency_hz)
    return {
        "time_s": float(recording.time[-1]) if finished else None,
        "radius_m": radius,
        "followed": finished and not fell,
        "cross_track_m": farthest if case.path_radius_m else None,
        "speed_m_s": _speed(points, recording, case.frequency_hz),
        "ended": str(controller.path_status) if case.path_radius_m else ("full lock" if finished else "time is up"),
        "fell": fell,
    }


def guide_points(moved: Moved, robot: RobotParameters) -> Array:
    """Track of the middle of the shoulder axis, (n, 2) [m]."""
    yaw = moved.roll_pitch_yaw[:, 2]
    ahead = robot.hip_positions[0][0] * np.stack([np.cos(yaw), np.sin(yaw)], axis=1)
    return np.asarray(moved.position[:, :2] + ahead)


def fitted_radius(points: Array, moved: Moved, frequency: float) -> float | None:
    """Radius [m] of the circle nearest to the track, without the first two gait cycles and what swings with the gait.

    None where the track is too short to tell.
    """
    begin = np.searchsorted(moved.time, 2.0 / frequency)
    smooth = smoothed(points[begin:], moved, frequency)
    if len(smooth) < 3:
        return None
    # Algebraic fit: x^2 + y^2 = 2 a x + 2 b y + c.
    system = np.column_stack([2.0 * smooth, np.ones(len(smooth))])
    (a, b, c), *_ = np.linalg.lstsq(system, (smooth**2).sum(axis=1), rcond=None)
    return float(math.sqrt(max(0.0, c + a * a + b * b)))


def _speed(points: Array, moved: Moved, frequency: float) -> float | None:
    """Speed along the track [m/s], without what swings with the gait; None where the track is too short to tell."""
    steps = np.diff(smoothed(points, moved, frequency), axis=0)
    if not len(steps):
        return None
    return float(np.hypot(*steps.T).mean()) / tick(moved)


def smoothed(points: Array, moved: Moved, frequency: float) -> Array:
    """Moving mean over one gait cycle."""
    if len(points) < 2:
        return np.zeros((0, 2))
    cycle = round(1.0 / (frequency * tick(moved)))
    if len(points) <= cycle:
        return np.zeros((0, 2))
    sums = np.vstack([np.zeros((1, 2)), np.cumsum(points, axis=0)])
    return np.asarray((sums[cycle:] - sums[:-cycle]) / cycle)


def table(cases: Sequence[Case], settings: Settings, robot: RobotParameters, results: list[list[Result]]) -> list[Any]:
    """One row a case, with the keys of the JSON contract."""
    return [_row(case, settings, robot, runs) for case, runs in zip(cases, results, strict=True)]


def _row(case: Case, settings: Settings, robot: RobotParameters, runs: list[Result]) -> dict[str, Any]:
    on_table = (case.gait, case.frequency_hz, case.path_radius_m) == ("trot", 0.67, 0.5)
    at_lock = case.path_radius_m == FULL_LOCK
    return {
        **asdict(case),
        "repeats": len(runs),
        "time_s": mean(runs, "time_s"),
        "time_sd_s": spread(runs, "time_s"),
        "radius_m": mean(runs, "radius_m"),
        "radius_sd_m": spread(runs, "radius_m"),
        "followed": all(one["followed"] for one in runs),
        "radius_at": RADIUS_AT,
        "thesis_s": THESIS_TIMES[case.strategy] if on_table else None,
        "thesis_radius_m": THESIS_RADII.get((case.gait, case.frequency_hz, case.strategy)) if at_lock else None,
        "theory_radius_m": theory_radius(case, settings, robot),
        "speed_m_s": mean(runs, "speed_m_s"),
        "cross_track_m": mean(runs, "cross_track_m") if case.path_radius_m else None,
        "ended": sorted({one["ended"] for one in runs}),
        "fell": any(one["fell"] for one in runs),
    }


EXPERIMENT = Experiment(
    name="turning",
    title="Turning (N 6.2.2)",
    help="""Time on arcs of 1.0 and 0.5 m, and the smallest radius, by gait, frequency and strategy (N 6.1.4, 6.2.2).

    An arc that cannot be followed is a result (`followed`), not a failure.

    With --target the runs of N's real robot are played on a mouse, with --film, then or later, they are measured.

    \b
    nermo experiment turning
    nermo experiment turning --quick --json turning.json
    nermo experiment turning --target link --port quic/nermo.local:7447?rel=0 --out today
    nermo experiment turning --film films --camera camera.yaml --out today
    """,
    columns=(
        *("gait", "frequency_hz", "strategy", "path_radius_m", "time_s", "thesis_s", "radius_m", "thesis_radius_m"),
        *("theory_radius_m", "followed"),
    ),
    cases=cases,
    run=run,
    table=table,
    tail="rigid",
)
