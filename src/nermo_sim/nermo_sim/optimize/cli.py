"""The word `optimize` of the `nermo` command."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from nermo_description.results import CommandError, write_results
from nermo_sim.console import console, print_facts, print_rows, progress
from nermo_sim.optimize.limit_cycle_command import LIMIT_CYCLE, search_limit_cycle
from nermo_sim.options import RESULTS, Json, Quick, Seed, check_robot

optimize_app = typer.Typer(
    rich_markup_mode=None, add_completion=False, help="Search gait and leg parameters on the twin for a stated cost."
)
_COLUMNS = ("set", "speed_m_s", "roll_sd_deg", "pitch_sd_deg", "cost_of_transport", "fell")
_METRICS = _COLUMNS[1:]


@optimize_app.command()
def optimize(
    cost: Annotated[
        str,
        typer.Option(help="speed, roll, cot (cost of transport), or mix: a weighted mean; limit-cycle: cheetah_cub's."),
    ] = "speed",
    weights: Annotated[str, typer.Option(help="Of a mix, as in speed=1,roll=2,cot=0.5; all 1 by default.")] = "",
    least_speed: Annotated[
        float, typer.Option(min=0.0, max=1.0, help="Share of the thesis's speed below which a set is punished.")
    ] = 0.9,
    robot: Annotated[
        str | None,
        typer.Option(help="Name or parameter file; nermo_lite, and for limit-cycle cheetah_cub, by default."),
    ] = None,
    gait: Annotated[str, typer.Option(help="Gait of the knowledge-base that is tuned.")] = "trot",
    frequency: Annotated[float, typer.Option(help="Gait frequency [Hz]; it stays.")] = 0.8,
    spine: Annotated[bool, typer.Option(help="With stride extension and offset compensation.")] = True,
    name: Annotated[
        str, typer.Option(help="Name of the saved set; default: optimized_COST, which the next search replaces.")
    ] = "",
    sets_folder: Annotated[
        Path | None, typer.Option(help="Folder of the named sets; default: where the knowledge-base looks.")
    ] = None,
    generations: Annotated[int | None, typer.Option(min=1, max=1000, help="Of the search for the cost.")] = None,
    seed: Seed = 0,
    quick: Quick = False,
    executor: Annotated[
        str, typer.Option(help="processes, dask://local, or dask://HOST:PORT of a scheduler (pip install distributed).")
    ] = "processes",
    workers: Annotated[int | None, typer.Option(min=1, help="Processes; one a processor by default.")] = None,
    out: Annotated[Path, typer.Option(help="Folder for the rollouts and pictures, in `optimize/`.")] = RESULTS,
    json: Json = None,
    video: Annotated[bool, typer.Option(help="Of limit-cycle: also draw a video of the best gait.")] = True,
) -> None:
    """Search gait and leg parameters on the twin for a stated cost, and the front of speed against roll noise.

    What is best is judged on disturbances and a friction that the search did not see, and saved as a named set: load it
    with the service load_parameter_set, or start with it: nermo up gait_set:=optimized_speed. Rollouts are kept as they
    come; a search that was stopped goes on where it was.

    \b
    nermo optimize
    nermo optimize --cost roll --json roll.json
    nermo optimize --cost mix --weights speed=1,roll=2 --name calm
    nermo optimize --quick --executor dask://local
    nermo optimize --cost limit-cycle --generations 40      (C 3.2.4: staged fitness, particle swarm)
    """
    from nermo_control.gait.knowledge_base import (
        GaitKnowledgeBase,
        GaitParameters,
        default_sets_folder,
        frequency_error,
    )
    from nermo_sim.batch import processors
    from nermo_sim.experiments.result_log import ResultLog
    from nermo_sim.optimize.costs import Objective, weights_of
    from nermo_sim.optimize.evaluator import Evaluator, open_executor
    from nermo_sim.optimize.figure import draw_front
    from nermo_sim.optimize.rollout import Walk
    from nermo_sim.optimize.search import QUICK, Budget, Search, gain, scaling
    from nermo_sim.optimize.space import Space

    if cost == LIMIT_CYCLE:
        search_limit_cycle(robot or "cheetah_cub", seed, quick, generations, executor, workers, out, json, video)
        return
    robot = robot or "nermo_lite"
    check_robot(robot)
    base, objective = GaitParameters(), Objective(weights_of(cost, weights), least_speed)  # type: ignore[arg-type]
    if gait not in base.gaits:
        raise CommandError(f"--gait {gait!r} is unknown: choose among {', '.join(base.gaits)}", status=2)
    if (error := frequency_error(frequency)) is not None:
        raise CommandError(f"--frequency: {error}", status=2)
    sets = GaitKnowledgeBase(sets_folder or default_sets_folder())
    own_name = name or f"optimized_{cost}"
    _check_name(sets, own_name, new=bool(name))

    walk = Walk(robot, gait, frequency, spine)
    budget = QUICK if quick else Budget()
    budget = budget if generations is None else replace(budget, generations=generations)
    folder = out / "optimize"
    log = ResultLog(folder / "rollouts.jsonl", walk.digest())
    count = workers or processors()
    space = Space(base, gait, spine)
    console.print(
        f"{len(space)} parameters, up to {budget.rollouts} rollouts, {count} workers, seed {seed}; in {folder}"
    )
    with progress("rollouts") as report, open_executor(executor, count) as pool:
        done = 0

        def advance() -> None:
            nonlocal done
            done += 1
            report(done, max(done, budget.rollouts))

        evaluator = Evaluator(pool, log, walk, advance)
        found = Search(space, base, evaluator, objective, seed).run(budget)

    saved = GaitKnowledgeBase(sets_folder or default_sets_folder(), found.best.parameters).save(
        own_name, overwrite=True
    )

    def row(title: str, candidate: Any) -> dict[str, Any]:
        return {
            "set": title,
            **{metric: candidate.metrics[metric] for metric in _METRICS},
            "cost": objective(candidate.metrics, found.baseline.metrics),
            "parameters": space.values(candidate.parameters),
        }

    baseline, best = row("thesis", found.baseline), row(own_name, found.best)
    front = [row(f"front {number + 1}", one) for number, one in enumerate(found.front)]
    picture = draw_front(folder / f"front_{cost}.png", front, baseline, best)
    speeds = [] if quick else scaling(walk, base)
    print_rows(f"{gait} at {frequency} Hz, searched for {cost}", [baseline, best, *front], _COLUMNS)
    unseen = [{**facts, "set": f"unseen, friction x {facts['ground']:g}"} for facts in found.unseen]
    for facts in unseen:
        print_facts(facts["set"], {"baseline": facts["baseline"], "best": facts["best"], "gain": facts["gain"]})
    print_facts("parameters", {"thesis": baseline["parameters"], own_name: best["parameters"]})
    rollouts = evaluator.rollouts
    per_second = rollouts.run_now / rollouts.seconds if rollouts.run_now else None
    console.print(f"{rollouts.count} rollouts, {rollouts.run_now} of them now; saved as {own_name}: {saved}")
    if json is not None:
        facts = {
            "cost": cost,
            "weights": objective.weights,
            "least_speed": least_speed,
            "gait": gait,
            "frequency_hz": frequency,
            "spine": spine,
            "best": {**best, "gain": gain(found.best.metrics, found.baseline.metrics), "name": own_name, "file": saved},
            "front": front,
            "baseline": baseline,
            "unseen": {"rows": unseen, "gain": unseen[-1]["gain"], "cost": unseen[-1]["cost"]},
            "rollouts": rollouts.count,
            "rollouts_now": rollouts.run_now,
            "rollouts_per_s": per_second,
            "executor": executor,
            "workers": count,
            "scaling": speeds,
            "candidates": found.tried,
            "history": found.history,
            "pictures": [picture],
        }
        write_results(json, "optimize", facts, robot=robot, seed=seed)


def _check_name(sets: Any, name: str, *, new: bool) -> None:
    """Refuses a bad name, and one that somebody chose and that is taken, before any work is done."""
    from nermo_description.parameter_files import ParameterError

    try:
        sets.check_name(name)
    except ParameterError as error:
        raise CommandError(str(error), status=2) from error
    if new and name in sets.names():
        raise CommandError(f"--name: the set {name!r} exists already; take another name", status=2)
