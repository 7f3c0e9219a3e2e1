"""`nermo optimize --cost limit-cycle`: what the command does beside the search itself."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from nermo_description.parameter_files import write_yaml
from nermo_description.results import CommandError, write_results
from nermo_sim.console import console, counting, print_facts, print_rows
from nermo_sim.options import check_robot
from nermo_sim.render import film

LIMIT_CYCLE = "limit-cycle"
PARTICLES, ITERATIONS = 24, 100
"""About half an hour on two processors; C has 120 to 160 and 400 to 800 on 157 nodes."""
QUICK = (4, 2)
UNSEEN_TRIALS = 4


def search_limit_cycle(
    robot: str,
    seed: int,
    quick: bool,
    iterations: int | None,
    executor: str,
    workers: int | None,
    out: Path,
    json: Path | None,
    video: bool = True,
) -> None:
    """Searches, keeps every rollout, saves the best gait as YAML, draws the history and a video of the best.

    Raises CommandError, with status 2 for a robot without pantograph legs.
    """
    from nermo_sim.batch import processors
    from nermo_sim.experiments.result_log import ResultLog, seed_for
    from nermo_sim.optimize.evaluator import open_executor
    from nermo_sim.optimize.limit_cycle import BOUNDS, Rollout, Swarm, Trot, default_values, gait_of, walk

    check_robot(robot, ("pantograph",))
    particles, rounds = QUICK if quick else (PARTICLES, ITERATIONS)
    rounds = rounds if iterations is None else iterations
    trot, folder, count = Trot(robot), out / "optimize", workers or processors()
    log = ResultLog(folder / "limit_cycle.jsonl", trot.digest())
    expected = particles * rounds + 1 + 2 * UNSEEN_TRIALS
    console.print(
        f"{len(BOUNDS)} parameters, {particles} particles, {rounds} iterations, "
        f"{count} workers, seed {seed}; in {folder}"
    )
    with counting("rollouts", expected) as counter, open_executor(executor, count) as pool:
        found = Swarm(pool, log, trot, seed, counter.advance).search(particles, rounds, UNSEEN_TRIALS)
    gait, frequency, length = gait_of(found.best)
    saved = folder / "limit_cycle.yaml"
    write_yaml({"gait": gait.model_dump(mode="json"), "frequency_hz": frequency, "step_length_m": length}, saved)
    rows = [
        _row("baseline", default_values(), found.baseline_metrics),
        _row("best", found.best, found.best_metrics),
        _row("baseline, unseen", default_values(), found.unseen["baseline"]),
        _row("best, unseen", found.best, found.unseen["best"]),
    ]
    columns = ("set", "stage", "value", "speed_m_s", "survived", "mismatch", "slip", "pitch_rad", "roll_rad")
    print_rows(f"{robot}, staged fitness (C table 3.4)", rows, columns)
    print_facts("parameters", dict(zip(BOUNDS, found.best, strict=True)))
    pictures = [_draw(folder / "limit_cycle.png", found.history)]
    if video:
        recording, twin = walk(Rollout(trot, found.best, seed_for(seed, "unseen", 0)))
        pictures += film(folder / "limit_cycle.mp4", twin.model, recording)
    per_second = found.rollouts_now / found.seconds if found.rollouts_now else None
    console.print(
        f"{found.rollouts} rollouts, {found.rollouts_now} of them now; saved: {saved}; "
        f"pictures: {', '.join(map(str, pictures))}"
    )
    if json is not None:
        facts = {
            "cost": LIMIT_CYCLE,
            "baseline": rows[0],
            "best": {**rows[1], "file": saved},
            "front": [],
            "unseen": {"rows": rows[2:]},
            "rollouts": found.rollouts,
            "rollouts_now": found.rollouts_now,
            "rollouts_per_s": per_second,
            "history": found.history,
            "particles": particles,
            "iterations": rounds,
            "executor": executor,
            "workers": count,
            "pictures": pictures,
        }
        write_results(json, "optimize", facts, robot=robot, seed=seed)


def _row(name: str, values: tuple[float, ...], metrics: dict[str, float]) -> dict[str, Any]:
    from nermo_sim.optimize.limit_cycle import BOUNDS, stage_and_value

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
