"""The maze experiment (N 6.1.6, 6.2.4): a path of 5 m with bends, without the spine and with all of its functions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from nermo_control.path import Path, PathStatus
from nermo_control.types import ControlCommand, SpineModes, TrajectoryMode
from nermo_description.parameters import RobotParameters
from nermo_sim.experiments.experiment import Experiment, Facts
from nermo_sim.experiments.orientation import orientation_noise
from nermo_sim.experiments.runs import FALLEN, Job, Result, Settings, full_speed, mean, rounded, spread, standing_loop
from nermo_sim.experiments.turning import guide_points
from nermo_sim.loop import constant
from nermo_sim.twin import Twin

SCENE = "maze"
GAIT, FREQUENCY = "trot", 0.67
"""N A.4.2."""
WAYPOINTS = (
    (0.0, 0.0),
    (1.2, 0.0),
    (1.2, 0.4),
    (0.1, 0.4),
    (0.1, 0.8),
    (1.2, 0.8),
    (1.2, 1.2),
    (0.3, 1.2),
)
"""Corners of the way through `scenes/maze.xml`, from the first place of the shoulder axis [m]."""
CORNER_RADIUS = 0.2
"""[m], half the width of a corridor: two corners make a half circle. Only the spine alone cannot turn so tightly."""
LANES, QUICK_LANES = 4, 2
"""Of the maze, and of its part with --quick: two waypoints are one."""
THESIS = {
    False: {"time_s": 85.7, "speed_m_s": 0.060, "pitch_sd_deg": 0.75, "roll_sd_deg": 3.09},
    True: {"time_s": 61.1, "speed_m_s": 0.082, "pitch_sd_deg": 1.25, "roll_sd_deg": 4.13},
}
"""N table 6.6, without and with spine."""
TRACK_POINTS_EVERY = 20
"""Ticks between two points that are kept for the figure."""


@dataclass(frozen=True, slots=True)
class Case:
    """One row of the table: leg turning alone, or mix turning with stride extension and offset compensation."""

    spine: bool
    lanes: int = LANES
    """Of the maze, from its begin; `QUICK_LANES` of a quick run."""

    @property
    def key(self) -> str:
        """Name of the row."""
        return f"maze{'' if self.lanes == LANES else f' of {self.lanes} lanes'}, spine {'on' if self.spine else 'off'}"


def cases(quick: bool = False) -> list[Case]:
    """Both configurations of N."""
    return [Case(False), Case(True)]


def maze_path(start: tuple[float, float, float], lanes: int = LANES) -> Path:
    """The way through some lanes; the mouse stands at the scene's origin, so only its first place is taken from it."""
    points = WAYPOINTS[: 2 * lanes]
    return Path.polyline([(start[0] + x, start[1] + y) for x, y in points], CORNER_RADIUS)


def command(case: Case, settings: Settings) -> ControlCommand:
    """What the mouse is told all along: N's "constant forward velocity" (6.1.6), and how it turns."""
    return ControlCommand(
        0,
        forward_velocity=full_speed(settings, GAIT, FREQUENCY),
        gait=GAIT,
        gait_frequency=FREQUENCY,
        turning_strategy="mix" if case.spine else "leg",
        spine_modes=SpineModes(stride_extension=case.spine, offset_compensation=case.spine),
    )


def run(job: Job[Case]) -> Result:
    """Walks through the maze, or until the mouse falls or loses its way."""
    case, settings = job.case, job.settings
    loop, disturbed = standing_loop(job, SCENE)
    controller = loop.controller.high_level_controller
    speed = full_speed(settings, GAIT, FREQUENCY)
    path = maze_path(controller.guide_pose(loop.twin.odometry()), QUICK_LANES if settings.quick else case.lanes)
    controller.follow(path)
    told = constant(replace(command(case, settings), trajectory_mode=TrajectoryMode.PATH))
    farthest = 0.0

    def ended(twin: Twin[Any]) -> bool:
        nonlocal farthest
        farthest = max(farthest, abs(controller.cross_track))
        return twin.tilt() > FALLEN or controller.path_status not in (PathStatus.IDLE, PathStatus.FOLLOWING)

    recording = loop.run(told, 4.0 * path.length / speed, until=ended, before_tick=disturbed.tick)
    finished = controller.path_status is PathStatus.FINISHED
    duration = float(recording.time[-1])
    result: Result = {
        "time_s": duration if finished else None,
        "speed_m_s": path.length / duration if finished else None,
        **orientation_noise(recording, FREQUENCY),
        "finished": finished,
        "cross_track_m": farthest,
        "ended": str(controller.path_status),
    }
    if job.repeat == 0:
        result["track_m"] = rounded(guide_points(recording, loop.twin.robot)[::TRACK_POINTS_EVERY])
        result["path_m"] = rounded([path.pose(0.02 * step)[:2] for step in range(int(path.length / 0.02) + 1)])
    return result


def table(cases: Sequence[Case], settings: Settings, robot: RobotParameters, results: list[list[Result]]) -> list[Any]:
    """One row a case, with the keys of the JSON contract."""
    rows = []
    for case, runs in zip(cases, results, strict=True):
        measured = ("time_s", "speed_m_s", "pitch_sd_deg", "roll_sd_deg", "yaw_sd_deg")
        rows.append(
            {
                "spine": case.spine,
                "repeats": len(runs),
                **{name: mean(runs, name) for name in measured},
                "time_sd_s": spread(runs, "time_s"),
                "cross_track_m": mean(runs, "cross_track_m"),
                "finished": all(one["finished"] for one in runs),
                "ended": sorted({one["ended"] for one in runs}),
                **{f"thesis_{name}": None if settings.quick else value for name, value in THESIS[case.spine].items()},
                "track_m": next((one["track_m"] for one in runs if "track_m" in one), None),
                "path_m": next((one["path_m"] for one in runs if "path_m" in one), None),
            }
        )
    return rows


def _failure(facts: Facts) -> str | None:
    if all(row["finished"] for row in facts["rows"]):
        return None
    return "the mouse did not come out of the maze: see the column `ended` of the JSON file"


EXPERIMENT = Experiment(
    name="maze",
    title="Maze (N 6.2.4)",
    help="""A path of 5 m through a maze, without the spine and with all of its functions (N 6.1.6, 6.2.4).

    Exit status 1 if the mouse did not come out.

    With --target a mouse walks through a smaller one, steered by who stands beside it; with --film, then or later, it
    is measured.

    \b
    nermo experiment maze
    nermo experiment maze --quick --json maze.json
    nermo experiment maze --target serial --port /dev/ttyUSB0 --dead-man pad --out today
    nermo experiment maze --film films --camera camera.yaml --out today
    """,
    columns=(
        *("spine", "time_s", "thesis_time_s", "speed_m_s", "thesis_speed_m_s", "pitch_sd_deg", "roll_sd_deg"),
        "finished",
    ),
    cases=cases,
    run=run,
    table=table,
    tail="rigid",
    failure=_failure,
)
