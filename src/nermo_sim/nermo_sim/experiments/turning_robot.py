"""Turning on the real mouse (N 6.1.4, table 6.3; 6.2.2, table 6.4): a quarter circle of 0.5 m to the left."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np

from nermo_control.types import ControlCommand
from nermo_description.parameters import RobotParameters
from nermo_sim.experiments.claims.board import Claims
from nermo_sim.experiments.claims.turning import robot
from nermo_sim.experiments.experiment import Row
from nermo_sim.experiments.on_robot import OnRobot, Said, Way, mouse_of
from nermo_sim.experiments.runs import FALLEN, Result, Settings, full_speed
from nermo_sim.experiments.turning import (
    ARC_ANGLE,
    EXPERIMENT,
    STRATEGIES,
    THESIS_TIMES,
    TOLERANCE,
    Case,
    fitted_radius,
    guide_points,
    smoothed,
)

RADIUS = 0.5
"""[m], N table 6.3."""
THESIS_ROBOT = {"spine": (15.5, False), "leg": (22.0, True), "mix": (16.3, True)}
"""Time [s], and whether the arc was followed: N table 6.4."""
ROOM = 3.0
"""Times that a run lasts longer than one of the no-slip speed. N's slowest robot took 2.3 times as long."""


def cases(quick: bool = False) -> list[Case]:
    """N's of table 6.3: the trot at 0.67 Hz, each way to turn."""
    return [Case("trot", 0.67, strategy, RADIUS) for strategy in STRATEGIES]


def _place(case: Case, settings: Settings) -> str:
    return (
        f"put the mouse on the start line with its shoulders; the end line is a quarter of a circle on, to the left, "
        f"about a point {RADIUS:g} m left of its shoulders; a metre of rubber mat around"
    )


def _played(case: Case, settings: Settings) -> Said:
    """Led without sight: nothing tells the mouse where it is, so it is told the curvature."""
    speed = full_speed(settings, case.gait, case.frequency_hz)
    return Said(
        ControlCommand(
            0,
            forward_velocity=speed,
            turn_rate=speed / RADIUS,
            gait=case.gait,
            gait_frequency=case.frequency_hz,
            turning_strategy=case.strategy,
        )
    )


def _seconds(case: Case, settings: Settings) -> float:
    return ROOM * settings.distance / full_speed(settings, case.gait, case.frequency_hz)


def _measure(case: Case, way: Way, settings: Settings) -> Result:
    return arc(way, case.frequency_hz, settings.distance / RADIUS, mouse_of(settings.robot))


def arc(way: Way, frequency: float, angle: float, mouse: RobotParameters) -> Result:
    """Time to the end of an arc of an angle [rad], how far beside it the mouse went, and the radius that it made.

    How far beside is told of the track without what swings with the gait. The radius needs three gait cycles.
    """
    points = guide_points(way, mouse)
    heading = float(way.roll_pitch_yaw[0, 2])
    middle = points[0] + RADIUS * np.array([-math.sin(heading), math.cos(heading)])
    off = points - middle
    gone = np.unwrap(np.arctan2(off[:, 1], off[:, 0]))
    beyond = gone - gone[0] >= angle
    reached = bool(beyond.any())
    end = max(int(np.argmax(beyond)) + 1, 2) if reached else len(points)
    walked = Way(way.time[:end], way.position[:end], way.roll_pitch_yaw[:end])
    smooth = smoothed(points[:end], walked, frequency)
    beside = float(np.abs(np.hypot(*(smooth - middle).T) - RADIUS).max()) if len(smooth) else 0.0
    fell = bool(np.abs(walked.roll_pitch_yaw[:, :2]).max() > FALLEN)
    return {
        "time_s": float(walked.time[-1]) if reached else None,
        "radius_m": fitted_radius(points[:end], walked, frequency),
        "cross_track_m": beside,
        "followed": reached and not fell and beside <= TOLERANCE,
        "fell": fell,
        "reached": reached,
    }


def _thesis(case: Case) -> Row:
    time, followed = THESIS_ROBOT[case.strategy]
    return {
        "thesis_robot_time_s": time,
        "thesis_robot_followed": followed,
        "thesis_twin_time_s": THESIS_TIMES[case.strategy],
    }


def _claims(rows: Sequence[Row]) -> list[Row]:
    claims = Claims()
    if len(rows) == len(STRATEGIES):
        robot(claims, rows)
    return claims.rows


def _picture(rows: Sequence[Row], path: Path) -> None:
    from nermo_sim.plots import plot_bars_on_robot

    labels = [row["strategy"] for row in rows]
    plot_bars_on_robot(rows, path, "time_s", "time [s]", labels, f"Arc of {RADIUS:g} m")


ON_ROBOT = OnRobot(
    experiment=EXPERIMENT,
    distance=RADIUS * ARC_ANGLE,
    cases=cases,
    name=lambda case: f"{case.gait}_{case.frequency_hz:g}Hz_{case.strategy}",
    place=_place,
    played=_played,
    seconds=_seconds,
    measure=_measure,
    measured=("time_s", "radius_m", "cross_track_m"),
    every=("followed",),
    describe=asdict,
    thesis=_thesis,
    claims=_claims,
    other_distances=False,
    picture=_picture,
)
