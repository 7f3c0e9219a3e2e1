"""`nermo optimize --cost limit-cycle`: what the command does beside the search itself."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from nermo_description.parameter_files import write_yaml
from nermo_description.results import CommandError, write_results
from nermo_sim.console import console, counting, print_facts, print_rows
from nermo_sim.experiments.result_log import ResultLog, seed_for
from nermo_sim.optimize.costs import LIMIT_CYCLE
from nermo_sim.optimize.evaluator import open_executor
from nermo_sim.optimize.limit_cycle import (
    BOUNDS,
    Found,
    Rollout,
    Swarm,
    Trot,
    default_values,
    gait_of,
    stage_and_value,
    walk,
)
from nermo_sim.options import SearchRequest, check_robot
from nermo_sim.render import film

PARTICLES, ITERATIONS = 24, 100
"""About half an hour on two processors; C has 120 to 160 and 400 to 800 on 157 nodes."""
QUICK = (4, 2)
UNSEEN_TRIALS = 4


def search_limit_cycle(wanted: SearchRequest, json: Path | None, video: bool = True) -> None:
    """Searches, keeps every rollout, saves the best gait as YAML, draws the history and a video of the best.

    Raises CommandError, with status 2 for a robot without pantograph legs.
    """
    check_robot(wanted.robot, ("pantograph",))
    particles, iterations = QUICK if wanted.quick else (PARTICLES, ITERATIONS)
    iterations = wanted.generations or iterations
    trot, folder = Trot(wanted.robot), wanted.folder
    log = ResultLog(folder / "limit_cycle.jsonl", trot.digest())
    console.print(
        f"{len(BOUNDS)} parameters, {particles} particles, {iterations} iterations, "
        f"{wanted.processes} workers, seed {wanted.seed}; in {folder}"
    )
    with (
        counting("rollouts", particles * iterations + 1 + 2 * UNSEEN_TRIALS) as counter,
        open_executor(wanted.executor, wanted.processes) as pool,
    ):
        found = Swarm(pool, log, trot, wanted.seed, counter.advance).search(particles, iterations, UNSEEN_TRIALS)
    gait, frequency, length = gait_of(found.best)
    saved = folder / "limit_cycle.yaml"
    write_yaml({"gait": gait.model_dump(mode="json"), "frequency_hz": frequency, "step_length_m": length}, saved)
    facts = _facts(found)
    columns = ("set", "stage", "value", "speed_m_s", "survived", "mismatch", "slip", "pitch_rad", "roll_rad")
    rows = [facts["baseline"], facts["best"], *facts["unseen"]["rows"]]
    print_rows(f"{wanted.robot}, staged fitness (C table 3.4)", rows, columns)
    print_facts("parameters", dict(zip(BOUNDS, found.best, strict=True)))
    pictures = [_draw(folder / "limit_cycle.png", found.history)]
    if video:
        recording, twin = walk(Rollout(trot, found.best, seed_for(wanted.seed, "unseen", 0)))
        pictures += film(folder / "limit_cycle.mp4", twin.model, recording)
    console.print(
        f"{found.rollouts} rollouts, {found.rollouts_now} of them now; saved: {saved}; "
        f"pictures: {', '.join(map(str, pictures))}"
    )
    if json is not None:
        facts["best"] |= {"file": saved}
        facts |= {"particles": particles, "iterations": iterations, "pictures": pictures}
        facts |= {"executor": wanted.executor, "workers": wanted.processes}
        write_results(json, "optimize", facts, robot=wanted.robot, seed=wanted.seed)


def _facts(found: Found) -> dict[str, Any]:
    return {
        "cost": LIMIT_CYCLE,
        "baseline": _row("baseline", default_values(), found.baseline_metrics),
        "best": _row("best", found.best, found.best_metrics),
        "front": [],
        "unseen": {
            "rows": [
                _row("baseline, unseen", default_values(), found.unseen["baseline"]),
                _row("best, unseen", found.best, found.unseen["best"]),
            ]
        },
        "rollouts": found.rollouts,
        "rollouts_now": found.rollouts_now,
        "rollouts_per_s": found.rollouts_now / found.seconds if found.rollouts_now else None,
        "history": found.history,
    }


def _row(name: str, values: tuple[float, ...], metrics: dict[str, float]) -> dict[str, Any]:
    stage, value = stage_and_value(metrics)
    return {
        "set": name,
        "stage": stage,
        "value": value,
        **metrics,
        "parameters": dict(zip(BOUNDS, values, strict=True)),
    }


def _draw(path: Path, history: list[float]) -> Path:
    figure = Figure(figsize=(6.0, 3.4), layout="constrained")
    axes = figure.subplots()
    axes.step(range(1, len(history) + 1), [-value for value in history], where="post")
    axes.set(xlabel="iteration", ylabel="stage + value / (1 + value)", title="Best of the swarm")
    axes.grid(alpha=0.3)
    try:
        figure.savefig(path, dpi=120)
    except OSError as error:
        raise CommandError(f"{path} cannot be written: {error.strerror}.") from error
    return path
