"""How soft the knees may be: their springs' rest angles moved from the robot's own to the neutral stance.

N calls its legs compliant (N 4.2) and has knees store energy in stance (N 7.2.1). It prints their stiffness (table
A.1) and no rest angle. A knee gives way where the load of its foot exceeds its pretension: the nearer its spring rests
to the neutral stance, the sooner. This experiment says what that costs, claim by claim.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, get_args

from nermo_description.blocks.leg import knee_angle
from nermo_description.parameters import RobotParameters
from nermo_sim.console import print_rows
from nermo_sim.experiments import balance, maze, straight_line, turning
from nermo_sim.experiments.claims import summary
from nermo_sim.experiments.claims.halves import Half
from nermo_sim.experiments.experiment import Experiment, Facts, Finished, Row
from nermo_sim.experiments.lookup import pick
from nermo_sim.experiments.runs import Job, Result, Settings
from nermo_sim.experiments.straight_line import FREQUENCIES, STRIDE

SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Of the way from the robot's own rest angles to the neutral stance."""
PARTS: dict[str, Experiment[Any]] = {
    module.EXPERIMENT.name: module.EXPERIMENT for module in (straight_line, turning, balance, maze)
}
PAIRS = ("front", "rear")


@dataclass(frozen=True, slots=True)
class Case:
    """One case of another experiment, with softer knees."""

    share: float
    experiment: str
    part: Any

    @property
    def key(self) -> str:
        """Name of the run."""
        return f"share {self.share}: {self.part.key}"


def cases(quick: bool = False) -> list[Case]:
    """For each share the walks, lifts, arcs and mazes whose claims say most; quick leaves most out."""
    return [
        Case(share, name, part)
        for share in (SHARES[:: len(SHARES) - 1] if quick else SHARES)
        for name, part in _parts(quick)
    ]


def _parts(quick: bool) -> list[tuple[str, Any]]:
    walks = [
        straight_line.Case("trot", frequency, STRIDE, spine, spine)
        for frequency in (FREQUENCIES[-1:] if quick else FREQUENCIES)
        for spine in (False, True)
    ]
    if quick:
        return [("straight-line", walk) for walk in walks] + [("balance", lift) for lift in balance.cases()]
    walks += [
        straight_line.Case("trot", 0.67, STRIDE, True, False),
        straight_line.Case("trot", 0.8, 0.0, True, True),
        straight_line.Case("lateral_walk", 0.8, STRIDE),
    ]
    arcs = [turning.Case("trot", 0.67, strategy, 0.5) for strategy in turning.STRATEGIES]
    return [
        *(("straight-line", walk) for walk in walks),
        *(("turning", arc) for arc in arcs),
        *(("balance", lift) for lift in balance.cases()),
        *(("maze", way) for way in maze.cases()),
    ]


def softer(robot: RobotParameters, share: float) -> RobotParameters:
    """The robot with its knees' rest angles moved by a share of the way to the neutral stance."""
    changed = {}
    for pair in PAIRS:
        dynamics = getattr(robot, f"{pair}_leg_dynamics")
        neutral = knee_angle(getattr(robot, f"{pair}_leg"), robot.servos[f"{pair}_left_knee"].neutral)
        rest = dynamics.knee.rest + share * (neutral - dynamics.knee.rest)
        changed[f"{pair}_leg_dynamics"] = dynamics.model_copy(
            update={"knee": dynamics.knee.model_copy(update={"rest": rest})}
        )
    return robot.model_copy(update=changed)


def _softened(settings: Settings, share: float) -> Settings:
    return replace(settings, variant=softer(settings.mouse, share))


def run(job: Job[Case]) -> Result:
    """One run of the other experiment's case."""
    case = job.case
    return PARTS[case.experiment].run(Job(case.part, job.repeat, _softened(job.settings, case.share)))


def facts_of(cases: Sequence[Case], settings: Settings, results: list[list[Result]], share: float) -> Facts:
    """The tables of the other experiments with the knees of one share."""
    softened = _softened(settings, share)
    facts: Facts = {name: {"rows": []} for name in PARTS}
    for case, runs in zip(cases, results, strict=True):
        if case.share == share:
            part = PARTS[case.experiment]
            facts[case.experiment]["rows"] += part.table([case.part], softened, softened.mouse, [runs])
    return facts


def claims_of(facts: Facts) -> dict[str, Row]:
    """The claims of N's twin, by name."""
    return {row["claim"]: row for row in summary(facts) if row["kind"] == "twin"}


def table(cases: Sequence[Case], settings: Settings, robot: RobotParameters, results: list[list[Result]]) -> list[Any]:
    """One row a share: how far the knees give way, how the mouse walks, and how many claims hold, by half."""
    rows = []
    for share in dict.fromkeys(case.share for case in cases):
        facts, knees = facts_of(cases, settings, results, share), softer(robot, share)
        walks = facts["straight-line"]["rows"]
        plain, spine = (pick(walks, gait="trot", frequency_hz=0.8, stride_m=STRIDE, spine=on) for on in (False, True))
        assert plain is not None and spine is not None, "every share has both walks"
        claims = claims_of(facts)
        rows.append(
            {
                "share": share,
                "repeats": plain["repeats"],
                **{f"{pair}_knee_rest_rad": getattr(knees, f"{pair}_leg_dynamics").knee.rest for pair in PAIRS},
                **{name: plain[name] for name in plain if "_knee_yield_" in name},
                "speed_m_s": plain["speed_m_s"],
                "spine_speed_m_s": spine["speed_m_s"],
                **{name: plain[name] for name in ("roll_sd_deg", "pitch_sd_deg", "pitch_mean_deg")},
                "lifts_as_thesis": sum(row["passed"] == row["thesis_passed"] for row in facts["balance"]["rows"]),
                **_counts(claims.values()),
            }
        )
    return rows


def _counts(claims: Iterable[Row]) -> dict[str, int]:
    """How many claims hold, of how many, by half."""
    groups = {half: [bool(row["within"]) for row in claims if row["half"] == half] for half in get_args(Half)}
    return {
        name: count
        for half, within in groups.items()
        for name, count in ((f"{half}_within", sum(within)), (half, len(within)))
    }


def changed_claims(cases: Sequence[Case], settings: Settings, results: list[list[Result]]) -> list[Row]:
    """The claims that hold with some knees and not with others: our side of each, by share; None where it is lost."""
    shares = list(dict.fromkeys(case.share for case in cases))
    found = {share: claims_of(facts_of(cases, settings, results, share)) for share in shares}
    rows = []
    for name in dict.fromkeys(name for claims in found.values() for name in claims):
        each = [found[share].get(name) for share in shares]
        holds = [row is not None and bool(row["within"]) for row in each]
        if len(set(holds)) > 1:
            any_row = next(row for row in each if row is not None)
            about = {key: any_row[key] for key in ("claim", "half", "thesis")}
            rows.append({**about, "ours": [None if row is None else row["ours"] for row in each], "within": holds})
    return rows


def _further(done: Finished[Case]) -> Facts:
    return {"changed_claims": changed_claims(done.cases, done.settings, done.results)}


def _notes(facts: Facts) -> None:
    shares = [row["share"] for row in facts["rows"]]
    shown = [
        {
            "claim": row["claim"],
            "half": row["half"],
            **{f"at {share}": "yes" if holds else "no" for share, holds in zip(shares, row["within"], strict=True)},
        }
        for row in facts["changed_claims"]
    ]
    print_rows("claims that hold with some knees only", shown, ("claim", "half", *(f"at {share}" for share in shares)))


EXPERIMENT = Experiment(
    name="compliance",
    title="How soft the knees may be (N 4.2, 7.2.1)",
    help="""The knees' springs ever less pretensioned, and which claims of the thesis that wins and loses.

    The rest angles, which the thesis does not print, go from the robot's own to the neutral stance.

    \b
    nermo experiment compliance
    nermo experiment compliance --quick --json compliance.json
    """,
    columns=(
        *("share", "front_knee_rest_rad", "rear_knee_rest_rad", "front_knee_yield_p95_deg", "rear_knee_yield_p95_deg"),
        *("front_knee_yield_touch_down_deg", "rear_knee_yield_lift_off_deg"),
        *("speed_m_s", "spine_speed_m_s", "roll_sd_deg", "pitch_sd_deg", "pitch_mean_deg", "lifts_as_thesis"),
        *("fitted_within", "fitted", "checked_within", "checked"),
    ),
    cases=cases,
    run=run,
    table=table,
    tail="rigid",
    further=_further,
    notes=_notes,
)
