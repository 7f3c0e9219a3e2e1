"""The word `calibrate` of the `nermo` command."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer
import yaml

from nermo_description.results import CommandError, write_results
from nermo_sim.console import console, print_rows, progress
from nermo_sim.experiments.lookup import Row
from nermo_sim.options import RESULTS, Json, Quick, Seed, check_robot

calibrate_app = typer.Typer(
    rich_markup_mode=None, add_completion=False, help="Fit the physical numbers that the thesis does not print."
)


@calibrate_app.command()
def calibrate(
    robot: Annotated[str, typer.Option(help="Name of a robot, or path of its parameter file: where it begins.")] = (
        "nermo_lite"
    ),
    seed: Seed = 0,
    quick: Quick = False,
    design: Annotated[int | None, typer.Option(min=2, help="Points spread over the bounds.")] = None,
    generations: Annotated[
        int | None, typer.Option(min=1, max=1000, help="Of the search from the best of them.")
    ] = None,
    executor: Annotated[
        str, typer.Option(help="processes, dask://local, or dask://HOST:PORT of a scheduler (pip install distributed).")
    ] = "processes",
    workers: Annotated[int | None, typer.Option(min=1, help="Processes; one a processor by default.")] = None,
    out: Annotated[Path, typer.Option(help="Folder for trials, robot file and report, in `calibrate/`.")] = RESULTS,
    json: Json = None,
) -> None:
    """Fit what the thesis does not print to one half of its claims, and judge by the other half.

    The robot found is written to a file, for --robot of any command; nothing takes it over by itself. Trials are kept
    as they come: a calibration that was stopped goes on where it was, to the same end.

    \b
    nermo calibrate --json calibration.json
    nermo calibrate --quick --executor dask://local
    """
    from nermo_description.robots import load_robot
    from nermo_sim.batch import processors
    from nermo_sim.calibrate import figures
    from nermo_sim.calibrate.determined import determined
    from nermo_sim.calibrate.numbers import differences, point_of
    from nermo_sim.calibrate.search import QUICK, Budget, Calibration
    from nermo_sim.calibrate.trials import Trial, run
    from nermo_sim.disturbance import NO_DISTURBANCE
    from nermo_sim.experiments.claims import score
    from nermo_sim.experiments.result_log import ResultLog
    from nermo_sim.experiments.runs import Settings
    from nermo_sim.optimize.evaluator import open_executor
    from nermo_sim.optimize.rollouts import Rollouts
    from nermo_sim.report.page import write_page

    check_robot(robot)
    budget = QUICK if quick else Budget()
    budget = replace(budget, design=design or budget.design, generations=generations or budget.generations)
    folder = out / "calibrate"
    settings = Settings(robot, repeats=1, seed=seed, disturbance=NO_DISTURBANCE, tail="rigid")
    count = workers or processors()
    console.print(
        f"{budget.design} points and {budget.generations} generations, {count} workers, seed {seed}; in {folder}"
    )
    with progress("trials") as report, open_executor(executor, count) as pool:
        done, planned = 0, 0

        def plan(trials: int) -> None:
            nonlocal planned
            planned = done + trials

        def advance() -> None:
            nonlocal done
            done += 1
            report(done, max(done, planned))

        rollouts: Rollouts[Trial] = Rollouts(run, pool, ResultLog(folder / "trials.jsonl", "trials"), advance)
        try:
            found = Calibration(settings, rollouts, plan).run(budget)
        except ValueError as error:
            raise CommandError(str(error)) from error

    numbers = determined(found)
    own = load_robot(robot)
    file = folder / "calibrated.yaml"
    file.write_text(
        "# Found by `nermo calibrate`; all else is the base's.\n"
        + yaml.safe_dump({"name": "calibrated", "base": robot, **differences(found.values, own)}, sort_keys=False),
        encoding="utf-8",
    )
    claims = before_and_after(found.before, found.after)
    earlier = [{**row, "within": row["within_before"]} for row in claims]
    scores = {"before": score(earlier), "after": score(claims)}
    counts = [
        {
            "claims": group,
            "of": scores["after"][group]["of"],
            **{when: scores[when][group]["within"] for when in scores},
        }
        for group in ("twin, fitted", "twin, checked", "robot")
    ]
    pages = write_page(
        folder,
        "Calibration of the twin",
        f"Robot {robot}, seed {seed}{', quick: only the cheap cases were judged' if quick else ''}.",
        [
            ("cost", "Cost of the fitted claims", figures.history(found)),
            ("numbers", "How well each number is determined", figures.intervals(numbers, point_of(own))),
            ("sensitivities", "Which claims each number moves", figures.sensitivities(found)),
        ],
        [("Claims within their bands", counts), ("Numbers", numbers), ("Claims", claims)],
    )
    print_rows("numbers", numbers, ("name", "value", "unit", "ci90", "share_of_bounds", "confounded_with"))
    print_rows("claims within their bands", counts, ("claims", "before", "after", "of"))
    console.print(f"{rollouts.count} trials, {rollouts.run_now} of them now; robot: {file}; report: {pages[0]}")
    if json is not None:
        facts: dict[str, Any] = {
            "claims": claims,
            "numbers": numbers,
            "score": scores,
            "cost": {"before": found.baseline.cost, "after": found.best.cost},
            "history": found.history,
            "trials": rollouts.count,
            "trials_now": rollouts.run_now,
            "executor": executor,
            "workers": count,
            "judged": budget.judged,
            "robot_file": file,
            "pictures": pages,
        }
        write_results(json, "calibrate", facts, robot=robot, seed=seed)


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
