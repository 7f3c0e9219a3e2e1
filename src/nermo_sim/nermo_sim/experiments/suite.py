"""All experiments under their names, and one run of the lot."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

from nermo_sim.batch import processors
from nermo_sim.experiments import (
    balance,
    coordination,
    footstep,
    gap_step,
    gaze,
    maze,
    push,
    stability,
    straight_line,
    transition,
    turning,
)
from nermo_sim.experiments.ablation import ablation
from nermo_sim.experiments.claims import comparison, score, summary
from nermo_sim.experiments.orientation import AXES
from nermo_sim.experiments.result_log import ResultLog
from nermo_sim.experiments.runs import Progress, Settings, run_cases

EXPERIMENTS: dict[str, ModuleType] = {
    "straight-line": straight_line,
    "turning": turning,
    "balance": balance,
    "maze": maze,
    "gaze": gaze,
}
"""Those of N chapter 6. Each has `cases(quick)`, `run(job)` and `table(cases, settings, robot, results)`."""
FURTHER: dict[str, ModuleType] = {
    "coordination": coordination,
    "push": push,
    "footstep": footstep,
    "gap-step": gap_step,
    "transition": transition,
    "stability": stability,
}
"""Experiments beyond N's, run one by one; made alike."""
ROBOTS = ("nermo_lite", "nermo")
"""N's robots. The neck of `nermo` tilts too, so that `all` looks at the gaze of both."""
RIGID_TAIL = frozenset({"straight-line", "turning", "balance", "maze"})
"""Experiments whose results with a rigid tail are those with the chain, within bands that a test has. The chain takes
1.5 times as long. The gaze needs it: how far the neck's residue wanders differs."""
COM_KEY = "com interval"


def run_experiment(
    name: str, settings: Settings, folder: Path, workers: int | None = None, progress: Progress | None = None
) -> dict[str, Any]:
    """Runs what is not yet in the folder and returns `rows`, and for balance the interval of the fore-aft COM.

    Raises ParameterError for an unusable robot and SimulationDivergedError.
    """
    experiment = {**EXPERIMENTS, **FURTHER}[name]
    settings = replace(settings, tail="rigid") if name in RIGID_TAIL else settings
    cases, log_file = experiment.cases(settings.quick), folder / "runs.jsonl"
    results = run_cases(experiment.run, cases, settings, name, log_file, workers, progress)
    robot = settings.parameters
    facts: dict[str, Any] = {"rows": experiment.table(cases, settings, robot, results)}
    if name == "balance":
        log = ResultLog(log_file, settings.digest(name))
        if COM_KEY not in log:
            log.add(COM_KEY, balance.com_interval(settings, workers or processors()))
        facts.update(log[COM_KEY])
    if name == "stability":
        facts.update(stability.further(cases, settings, stability.pantograph_robot(settings.robot), results))
    if name == "transition":
        facts["series"] = transition.series(cases, results)
    if name == "footstep":
        facts["fit"] = footstep.fit(facts["rows"])
    if name == "gap-step":
        facts["runs"] = gap_step.crossings(cases, results)
    return facts


def run_all(
    settings: Settings,
    folder: Path,
    workers: int | None = None,
    progress: Callable[[str], AbstractContextManager[Progress | None]] = lambda name: nullcontext(),
) -> dict[str, Any]:
    """Runs every experiment, each in its folder, and draws the conclusions: the keys of `experiment all`.

    progress: gives each experiment its own reporter.
    """
    facts: dict[str, Any] = {}
    for name in EXPERIMENTS:
        with progress(name) as report:
            facts[name] = run_experiment(name, settings, folder / name, workers, report)
    if settings.robot in ROBOTS:
        (other,) = (name for name in ROBOTS if name != settings.robot)
        with progress(f"gaze, {other}") as report:
            more = run_experiment("gaze", replace(settings, robot=other), folder / "gaze", workers, report)
        facts["gaze"]["rows"] += more["rows"]
    facts["orientation"] = {"rows": [_orientation(row) for row in facts["straight-line"]["rows"]]}
    facts["theory_against_twin"] = {"rows": _losses(facts["straight-line"]["rows"])}
    facts["ablation"] = {"rows": ablation(facts)}
    facts["comparison"] = {"rows": comparison(facts)}
    facts["summary"] = summary(facts)
    facts["score"] = score(facts["summary"])
    return facts


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


_CASE = ("gait", "frequency_hz", "stride_m", "spine", "offset_compensation")
