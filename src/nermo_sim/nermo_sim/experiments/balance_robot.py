"""Balance on the real mouse (N 6.1.5, A.4.2; 6.2.3, table 6.5): one leg after the other lifted and swept."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from nermo_sim.experiments.balance import (
    END,
    EXPERIMENT,
    SWEEP_AT,
    SWEEP_DURATION,
    THESIS_PASSED,
    Case,
    cases,
    servo_angles,
    upright,
)
from nermo_sim.experiments.claims.board import Claims
from nermo_sim.experiments.claims.standing import robot
from nermo_sim.experiments.experiment import Row
from nermo_sim.experiments.on_robot import OnRobot, Posed, Way, mouse_of
from nermo_sim.experiments.runs import Result, Settings

PERIOD_NS = 5_000_000
"""Of the servo angles, the twin's."""


def _place(case: Case, settings: Settings) -> str:
    leg = case.leg.replace("_", " ")
    return (
        f"put the mouse on the rubber mat, a hand's width around it; it stands on four feet for a second, lifts the "
        f"{leg} leg and sweeps it once forth and back. Let it tip over if it does"
    )


def _played(case: Case, settings: Settings) -> Posed:
    mouse = mouse_of(settings.robot)
    angles = servo_angles(case, mouse, settings.gait_parameters, PERIOD_NS)
    return Posed(PERIOD_NS * 1e-9, tuple(dict(zip(mouse.servos, row, strict=True)) for row in angles))


def _measure(case: Case, way: Way, settings: Settings) -> Result:
    """Passed: the mouse was seen until the leg has been swept, and had not tipped."""
    seen = upright(way, case.leg, mouse_of(settings.robot), settings.gait_parameters)
    reached = bool(way.time[-1] >= SWEEP_AT + SWEEP_DURATION)
    return {**seen, "passed": reached and seen["tipped"] is False, "reached": reached}


def _thesis(case: Case) -> Row:
    """N table 6.5: its robot passes every lift with compensation, and none without."""
    return {
        "thesis_robot_passed": case.compensation,
        "thesis_twin_passed": THESIS_PASSED[case.leg, case.compensation],
    }


def _claims(rows: Sequence[Row]) -> list[Row]:
    claims = Claims()
    robot(claims, list(rows))
    return claims.rows


def _picture(rows: Sequence[Row], path: Path) -> None:
    from nermo_sim.plots import plot_bars_on_robot

    labels = [f"{row['leg'].replace('_', ' ')}\n{'compensated' if row['compensation'] else 'alone'}" for row in rows]
    plot_bars_on_robot(rows, path, "up_s", "time until it tips, or the test ends [s]", labels, "Balance")


ON_ROBOT = OnRobot(
    experiment=EXPERIMENT,
    cases=cases,
    name=lambda case: f"{case.leg}_{'compensation' if case.compensation else 'no_compensation'}",
    place=_place,
    played=_played,
    seconds=lambda case, settings: END,
    measure=_measure,
    measured=("up_s", "sunk_mm", "pitch_deg", "tilt_peak_deg"),
    every=("passed",),
    describe=asdict,
    thesis=_thesis,
    claims=_claims,
    other_distances=False,
    picture=_picture,
)
