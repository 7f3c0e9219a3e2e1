"""What one set of numbers is tried with: cases of the experiments, and the claims that their tables answer."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from nermo_sim.divergence import SimulationDivergedError
from nermo_sim.experiments import balance, straight_line, turning
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
    """A simulation that runs away, or a mouse that takes no whole step, is a result."""
    try:
        return dict(EXPERIMENTS[trial.experiment].run(Job(trial.case, trial.repeat, trial.settings)))
    except (SimulationDivergedError, ValueError) as error:
        return {"failed": str(error)}


def all_cases() -> list[tuple[str, Any]]:
    """Every case of every experiment of N."""
    return [(name, case) for name, experiment in EXPERIMENTS.items() for case in experiment.cases(False)]


def cheap_cases() -> list[tuple[str, Any]]:
    """Those of the search: walks, lifts and full locks that the numbers of N ask for; no arcs and no maze."""
    locks = (
        ("trot", 0.67, "leg"),
        ("trot", 0.67, "mix"),
        ("trot", 0.5, "mix"),
        ("trot", 0.5, "spine"),
        ("lateral_walk", 0.5, "spine"),
        ("lateral_walk", 0.8, "mix"),
        ("lateral_walk", 0.8, "spine"),
    )
    walks = [("straight-line", case) for case in straight_line.cases()]
    lifts = [("balance", case) for case in balance.cases()]
    return [*walks, *lifts, *(("turning", turning.Case(*lock, turning.FULL_LOCK)) for lock in locks)]  # type: ignore[arg-type]


def tables(
    cases: Sequence[tuple[str, Any]], settings: Settings, results: Sequence[Sequence[dict[str, Any]]]
) -> dict[str, Any]:
    """The tables of the experiments, by name; a case of which a run failed is left out."""
    robot = settings.mouse
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


def relevant(cases: Sequence[tuple[str, Any]], facts: dict[str, Any], wanted: Sequence[str]) -> list[tuple[str, Any]]:
    """The cases without which one of the wanted claims would be missed by more or less, or could not be answered."""
    whole = misses(claims_of(facts))
    kept = []
    for name, case in cases:
        own = asdict(case)
        left = [row for row in facts[name]["rows"] if any(row[field] != value for field, value in own.items())]
        without = misses(claims_of({**facts, name: {"rows": left}}))
        if any(without.get(claim) != whole[claim] for claim in wanted):
            kept.append((name, case))
    return kept
