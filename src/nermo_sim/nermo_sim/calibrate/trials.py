"""What one set of numbers is tried with: cases of the experiments, and the claims that their tables answer."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from nermo_sim.divergence import SimulationDivergedError
from nermo_sim.experiments import balance, maze, straight_line, turning
from nermo_sim.experiments.claims import summary
from nermo_sim.experiments.lookup import Row
from nermo_sim.experiments.result_log import fingerprint
from nermo_sim.experiments.runs import Job, Settings
from nermo_sim.experiments.suite import CHAPTER

EXPERIMENTS = {name: experiment for name, experiment in CHAPTER.items() if name != "gaze"}
"""Those of N of which its twin or robot claims something."""
WORST = 3.0
"""No claim is missed by more than this, in halves of its band."""
WORDS_MISSED = 1.5
"""A claim in words that does not hold counts as one missed by this."""


@dataclass(frozen=True, slots=True)
class Trial:
    """One case with one variant: plain, picklable data."""

    experiment: str
    case: Any
    settings: Settings
    repeat: int = 0

    @property
    def key(self) -> str:
        """Name of the trial, by its content."""
        return fingerprint([self.settings.digest(self.experiment), self.case.key, self.repeat])[:24]


def run(trial: Trial) -> dict[str, Any]:
    """A simulation that runs away, or a mouse that takes no whole step, is a result.

    A quick maze is half of one; its time is that of the whole at the same speed.
    """
    try:
        result = dict(EXPERIMENTS[trial.experiment].run(Job(trial.case, trial.repeat, trial.settings)))
    except (SimulationDivergedError, ValueError) as error:
        return {"failed": str(error)}
    if trial.experiment == "maze" and trial.settings.quick and result["finished"]:
        result["time_s"] = maze.maze_path((0.0, 0.0, 0.0)).length / result["speed_m_s"]
    return result


def all_cases() -> list[tuple[str, Any]]:
    """Every case of every experiment of N."""
    return [(name, case) for name, experiment in EXPERIMENTS.items() for case in experiment.cases(False)]


def cheap_cases() -> list[tuple[str, Any]]:
    """Those of the search: of each experiment what the fitted half asks for, so that every claim of it has an answer.

    Whole are walks, lifts and maze. A claim about all arcs or all full locks is asked of those here. The arc of N table
    6.4, the trot's at 0.67 Hz, is not among them: its times are in the checked half.
    """
    locks = (
        *(("trot", 0.5, strategy, turning.FULL_LOCK) for strategy in turning.STRATEGIES),
        *(("lateral_walk", 0.8, strategy, turning.FULL_LOCK) for strategy in turning.STRATEGIES),
        ("lateral_walk", 0.5, "spine", turning.FULL_LOCK),
    )
    arcs = (
        *(("trot", frequency, strategy, 0.5) for frequency in (0.5, 0.8) for strategy in turning.STRATEGIES),
        ("lateral_walk", 0.8, "spine", 0.5),
    )
    cases: dict[str, Sequence[Any]] = {
        "straight-line": straight_line.cases(),
        "turning": [turning.Case(*each) for each in (*locks, *arcs)],
        "balance": balance.cases(),
        "maze": maze.cases(),
    }
    return [(name, case) for name, each in cases.items() for case in each]


def tables(
    cases: Sequence[tuple[str, Any]], settings: Settings, results: Sequence[Sequence[dict[str, Any]]]
) -> dict[str, Any]:
    """The tables of the experiments, by name; a case of which a run failed is left out."""
    robot, settings = settings.mouse, replace(settings, quick=False)  # as beside N's numbers
    facts: dict[str, Any] = {name: {"rows": []} for name in EXPERIMENTS}
    for (name, case), runs in zip(cases, results, strict=True):
        if not any("failed" in one for one in runs):
            facts[name]["rows"] += EXPERIMENTS[name].table([case], settings, robot, [list(runs)])
    return facts


def claims_of(facts: dict[str, Any]) -> list[Row]:
    """The claims of N's twin and robot that the tables answer."""
    return [row for row in summary(facts) if row["kind"] in ("twin", "robot")]


def miss(row: Row) -> float:
    """By how much a claim is missed: 0 is N's own value, 1 the edge of the band; signed, at most WORST."""
    if row["ratio"] is None:
        return 0.0 if row["within"] else WORDS_MISSED
    low, high = row["band"] if row["thesis"] > 0.0 else row["band"][::-1]
    ratio = row["ratio"]
    signed = (ratio - 1.0) / (high - 1.0) if ratio > 1.0 else (ratio - 1.0) / (1.0 - low)
    return float(min(max(signed, -WORST), WORST))


def misses(rows: Iterable[Row]) -> dict[str, float]:
    """`miss` of each claim, by its name."""
    return {row["claim"]: miss(row) for row in rows}


def cost(found: Mapping[str, float], wanted: Sequence[str]) -> float:
    """Mean square of the misses of the wanted claims; one that cannot be answered any more counts as worst."""
    return sum(found.get(claim, WORST) ** 2 for claim in wanted) / len(wanted)
