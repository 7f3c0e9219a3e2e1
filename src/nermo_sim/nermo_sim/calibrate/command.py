"""`nermo calibrate`: what the command does beside the search itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import yaml

from nermo_description.parameters import RobotParameters
from nermo_description.results import CommandError, write_results
from nermo_description.robots import load_robot
from nermo_sim.calibrate import figures
from nermo_sim.calibrate.determined import determined
from nermo_sim.calibrate.numbers import differences, point_of
from nermo_sim.calibrate.search import QUICK, Budget, Calibration, Found
from nermo_sim.calibrate.trials import Trial, run
from nermo_sim.console import console, counting, print_rows
from nermo_sim.disturbance import NO_DISTURBANCE
from nermo_sim.experiments.claims import score
from nermo_sim.experiments.lookup import Row
from nermo_sim.experiments.result_log import ResultLog
from nermo_sim.experiments.runs import Settings
from nermo_sim.optimize.evaluator import open_executor
from nermo_sim.optimize.rollouts import Rollouts
from nermo_sim.options import SearchRequest
from nermo_sim.report.page import write_page


def calibrate_robot(wanted: SearchRequest, design: int | None, json: Path | None) -> None:
    """Searches, keeps every trial, writes the robot found, prints and draws it beside the first one.

    design: points spread over the bounds. Raises CommandError.
    """
    robot, folder, seed = wanted.robot, wanted.folder, wanted.seed
    budget = QUICK if wanted.quick else Budget()
    budget = replace(budget, design=design or budget.design, generations=wanted.generations or budget.generations)
    settings = Settings(robot, repeats=1, seed=seed, disturbance=NO_DISTURBANCE, tail="rigid")
    console.print(
        f"{budget.design} points and {budget.generations} generations, {wanted.processes} workers, seed {seed}; "
        f"in {folder}"
    )
    with counting("trials") as counter, open_executor(wanted.executor, wanted.processes) as pool:
        log = ResultLog(folder / "trials.jsonl", "trials")
        rollouts: Rollouts[Trial] = Rollouts(run, pool, log, counter.advance)
        try:
            found = Calibration(settings, rollouts, counter.plan).run(budget)
        except ValueError as error:
            raise CommandError(str(error)) from error

    own = load_robot(robot)
    file = _write_robot(folder / "calibrated.yaml", robot, found, own)
    facts = _facts(found)
    about = f"Robot {robot}, seed {seed}{', quick: only the cheap cases were judged' if wanted.quick else ''}."
    pages = _write_page(folder, about, found, own, facts)
    print_rows("numbers", facts["numbers"], ("name", "value", "unit", "ci90", "share_of_bounds", "confounded_with"))
    print_rows("claims within their bands", _counts(facts), ("claims", "before", "after", "of"))
    console.print(f"{rollouts.count} trials, {rollouts.run_now} of them now; robot: {file}; report: {pages[0]}")
    if json is not None:
        facts |= {
            "trials": rollouts.count,
            "trials_now": rollouts.run_now,
            "executor": wanted.executor,
            "workers": wanted.processes,
            "judged": budget.judged,
            "robot_file": file,
            "pictures": pages,
        }
        write_results(json, "calibrate", facts, robot=robot, seed=seed)


def _write_robot(file: Path, base: str, found: Found, own: RobotParameters) -> Path:
    text = yaml.safe_dump({"name": "calibrated", "base": base, **differences(found.values, own)}, sort_keys=False)
    file.write_text("# Found by `nermo calibrate`; all else is the base's.\n" + text, encoding="utf-8")
    return file


def _facts(found: Found) -> dict[str, Any]:
    claims = before_and_after(found.before, found.after)
    earlier = [{**row, "within": row["within_before"]} for row in claims]
    return {
        "claims": claims,
        "numbers": determined(found),
        "score": {"before": score(earlier), "after": score(claims)},
        "cost": {"before": found.baseline.cost, "after": found.best.cost},
        "history": found.history,
    }


def _counts(facts: dict[str, Any]) -> list[Row]:
    """How many claims hold before and after, a row a group."""
    scores = facts["score"]
    return [
        {
            "claims": group,
            "of": scores["after"][group]["of"],
            **{when: scores[when][group]["within"] for when in scores},
        }
        for group in ("twin, fitted", "twin, checked", "robot")
    ]


def _write_page(folder: Path, about: str, found: Found, own: RobotParameters, facts: dict[str, Any]) -> list[Path]:
    return write_page(
        folder,
        "Calibration of the twin",
        about,
        [
            ("cost", "Cost of the fitted claims", figures.history(found)),
            ("numbers", "How well each number is determined", figures.intervals(facts["numbers"], point_of(own))),
            ("sensitivities", "Which claims each number moves", figures.sensitivities(found)),
        ],
        [("Claims within their bands", _counts(facts)), ("Numbers", facts["numbers"]), ("Claims", facts["claims"])],
    )


def before_and_after(before: Sequence[Row], after: Sequence[Row]) -> list[Row]:
    """One row a claim that either robot answers; one that a robot cannot answer (a fall, a lost path) does not hold."""
    earlier, later = ({row["claim"]: row for row in rows} for rows in (before, after))
    claims = []
    for name, row in {**earlier, **later}.items():
        was, now = ((each.get(name) or {}) for each in (earlier, later))
        kept = {key: row[key] for key in ("claim", "kind", "half", "thesis")}
        found = {"ours": now.get("ours"), "within": bool(now.get("within"))}
        claims.append({**kept, **found, "ours_before": was.get("ours"), "within_before": bool(was.get("within"))})
    return claims
