"""All experiments of N chapter 6 in one run, and what follows from them together."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

from nermo_sim.experiments import balance, gaze, maze, straight_line, turning
from nermo_sim.experiments.ablation import ablation
from nermo_sim.experiments.claims import comparison, score, summary
from nermo_sim.experiments.experiment import Experiment, Facts, Row, run_experiment
from nermo_sim.experiments.orientation import AXES
from nermo_sim.experiments.runs import Progress, Settings

CHAPTER: dict[str, Experiment[Any]] = {
    module.EXPERIMENT.name: module.EXPERIMENT for module in (straight_line, turning, balance, maze, gaze)
}
"""Those of N chapter 6."""
GAZE_ROBOTS = ("nermo_lite", "nermo")
"""N's robots: `all` looks at the gaze of both, since only the neck of `nermo` tilts too."""
_CASE = ("gait", "frequency_hz", "stride_m", "spine", "offset_compensation")
_COLUMNS = {
    "theory against twin": (
        *(*_CASE, "theory_m_s", "steering_m_s", "spine_m_s", "legs_m_s"),
        *("pitch_m_s", "yaw_m_s", "slip_m_s", "contact_m_s", "reached_m_s"),
    ),
    "ablation": ("off", "speed_m_s", "roll_sd_deg", "pitch_sd_deg", "radius_m", "arc_time_s", "lifts_passed"),
    "comparison": ("quantity", "theory", "twin", "robot", "ours", "ratio"),
    "summary": ("claim", "kind", "half", "thesis", "ours", "ratio", "band", "within"),
}


def run_all(
    settings: Settings,
    folder: Path,
    workers: int | None = None,
    progress: Callable[[str], AbstractContextManager[Progress | None]] = lambda name: nullcontext(),
) -> Facts:
    """Runs every experiment, each in its folder, and draws the conclusions: the keys of `experiment all`.

    progress: gives each experiment its own reporter.
    """
    facts: Facts = {}
    for name, experiment in CHAPTER.items():
        with progress(name) as report:
            facts[name] = run_experiment(experiment, settings, folder / name, workers, report)
    for other in robots_beside(settings.robot):
        with progress(f"gaze, {other}") as report:
            more = run_experiment(gaze.EXPERIMENT, replace(settings, robot=other), folder / "gaze", workers, report)
        facts["gaze"]["rows"] += more["rows"]
    facts["orientation"] = {"rows": [_orientation(row) for row in facts["straight-line"]["rows"]]}
    facts["theory_against_twin"] = {"rows": _losses(facts["straight-line"]["rows"])}
    facts["ablation"] = {"rows": ablation(facts)}
    facts["comparison"] = {"rows": comparison(facts)}
    facts["summary"] = summary(facts)
    facts["score"] = score(facts["summary"])
    return facts


def tables(facts: Facts) -> list[tuple[str, list[Row], tuple[str, ...]]]:
    """What the terminal shows of them: titles, rows and their columns."""
    rows = {
        "theory against twin": facts["theory_against_twin"]["rows"],
        "ablation": facts["ablation"]["rows"],
        "comparison": facts["comparison"]["rows"],
        "summary": facts["summary"],
    }
    return [(title, rows[title], columns) for title, columns in _COLUMNS.items()]


def robots_beside(robot: str) -> list[str]:
    """Robots whose gaze stands beside that of one of N's."""
    return [other for other in GAZE_ROBOTS if other != robot] if robot in GAZE_ROBOTS else []


def _orientation(row: dict[str, Any]) -> dict[str, Any]:
    quantities = [f"{axis}_{kind}_deg" for axis in AXES for kind in ("mean", "sd", "amplitude")]
    return {name: row[name] for name in (*_CASE, *quantities)}


def _losses(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Where the speed goes (N 7.2.1), for the rows in which the mouse walks."""
    return [
        {**{name: row[name] for name in _CASE}, **row["losses"], "early_touch_down": row["early_touch_down"]}
        for row in rows
        if row["losses"]
    ]
