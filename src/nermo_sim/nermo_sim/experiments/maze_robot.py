"""The maze on the real mouse (N 6.1.6, A.4.2; 6.2.4): a smaller one, through which whoever sees the mouse steers it.

N prints neither the plan of its robot's maze nor how the robot, which has no sensors (6.1.3), knew its path. A person
with a game console controller is the external trajectory mode of A.1.4.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict
from itertools import groupby
from pathlib import Path

import numpy as np

from nermo_control.driver import Steering
from nermo_control.path import PathFollower
from nermo_sim.experiments.claims.board import Claims
from nermo_sim.experiments.claims.mazes import robot
from nermo_sim.experiments.experiment import Row
from nermo_sim.experiments.maze import CORNER_RADIUS, EXPERIMENT, FREQUENCY, QUICK_LANES, Case, command, maze_path
from nermo_sim.experiments.on_robot import OnRobot, Said, Way, mouse_of
from nermo_sim.experiments.orientation import orientation_noise
from nermo_sim.experiments.runs import FALLEN, Result, Settings
from nermo_sim.experiments.turning import guide_points

LANES = 3
"""Of the twin's four: a bend to each side. Chosen; N 6.2.4 has "a smaller test environment" and prints no plan."""
SHARPEST = 0.75 * CORNER_RADIUS
"""[m] Radius with the stick fully pushed. Chosen: tighter than the bends, so that there is room to correct."""
ROOM = 2.0
"""Times that a run lasts longer than one of the no-slip speed: N's slowest robot took 1.2 times as long straight on,
2.3 times on an arc, and who steers lets go at the goal."""
ORIGIN = (0.0, 0.0, 0.0)


def cases(quick: bool = False) -> list[Case]:
    """N's two: turning by legs without the spine, and all functions of the spine."""
    lanes = QUICK_LANES if quick else LANES
    return [Case(spine, lanes) for spine in (False, True)]


def _place(case: Case, settings: Settings) -> str:
    parts = groupby(maze_path(ORIGIN, case.lanes).segments, key=lambda segment: segment.curvature)
    way = ", ".join(_part(curvature, sum(one.length for one in segments)) for curvature, segments in parts)
    return (
        f"put the mouse on the start line with its shoulders, along the first lane. The way, marked on the rubber mat, "
        f"with something between its lanes: {way}. You steer the mouse along it, and let go at the goal"
    )


def _part(curvature: float, length: float) -> str:
    """A line or an arc, in words."""
    if curvature == 0.0:
        return f"{length:g} m straight on"
    side = "left" if curvature > 0.0 else "right"
    return f"{math.degrees(length * abs(curvature)):.0f} deg to the {side} about {1.0 / abs(curvature):g} m"


def _played(case: Case, settings: Settings) -> Said:
    """Told how fast, and how to turn; where to is for who sees the mouse."""
    told = command(case, settings)
    return Said(told, Steering(maze_path(ORIGIN, case.lanes), told.forward_velocity / SHARPEST))


def _seconds(case: Case, settings: Settings) -> float:
    return ROOM * maze_path(ORIGIN, case.lanes).length / command(case, settings).forward_velocity


def _measure(case: Case, way: Way, settings: Settings) -> Result:
    """Time and speed to the end of the path, how far beside it the shoulders were, and what roll, pitch and yaw did.

    The path begins where the shoulders stood, along their heading. Finished: the mouse came to its end, in its lanes
    and on its feet.
    """
    points = guide_points(way, mouse_of(settings.robot))
    yaw = way.roll_pitch_yaw[:, 2]
    path = maze_path(ORIGIN, case.lanes).placed((float(points[0, 0]), float(points[0, 1]), float(yaw[0])))
    follower = PathFollower(path)
    deviations = [follower.step((float(x), float(y), float(turn))) for (x, y), turn in zip(points, yaw, strict=True)]
    beyond = np.array([one.progress >= path.length for one in deviations])
    reached = bool(beyond.any())
    end = max(int(np.argmax(beyond)) + 1, 2) if reached else len(points)
    walked = Way(way.time[:end], way.position[:end], way.roll_pitch_yaw[:end])
    beside = max(abs(one.cross_track) for one in deviations[:end])
    fell = bool(np.abs(walked.roll_pitch_yaw[:, :2]).max() > FALLEN)
    duration = float(walked.time[-1])
    return {
        "time_s": duration if reached else None,
        "speed_m_s": path.length / duration if reached else None,
        **orientation_noise(walked, FREQUENCY),
        "cross_track_m": beside,
        "finished": reached and not fell and beside <= CORNER_RADIUS,
        "fell": fell,
        "reached": reached,
    }


def _claims(rows: Sequence[Row]) -> list[Row]:
    claims = Claims()
    robot(claims, rows)
    return claims.rows


def _picture(rows: Sequence[Row], path: Path) -> None:
    from nermo_sim.plots import plot_bars_on_robot

    labels = [f"spine {'on' if row['spine'] else 'off'}" for row in rows]
    plot_bars_on_robot(rows, path, "time_s", "time [s]", labels, f"Maze of {rows[0]['lanes']} lanes")


ON_ROBOT = OnRobot(
    experiment=EXPERIMENT,
    cases=cases,
    name=lambda case: f"{case.lanes}_lanes_{'spine' if case.spine else 'no_spine'}",
    place=_place,
    played=_played,
    seconds=_seconds,
    measure=_measure,
    measured=("time_s", "speed_m_s", "pitch_sd_deg", "roll_sd_deg", "cross_track_m"),
    every=("finished",),
    describe=asdict,
    thesis=lambda case: {},
    claims=_claims,
    other_distances=False,
    picture=_picture,
)
