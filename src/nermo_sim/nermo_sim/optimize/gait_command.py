"""`nermo optimize` for the costs of a mouse's gait: what the command does beside the search itself."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from nermo_control.gait.knowledge_base import GaitKnowledgeBase, GaitParameters, default_sets_folder, frequency_error
from nermo_description.parameter_files import ParameterError
from nermo_description.results import CommandError, write_results
from nermo_sim.console import console, counting, print_facts, print_rows
from nermo_sim.experiments.result_log import ResultLog
from nermo_sim.optimize.costs import Objective, weights_of
from nermo_sim.optimize.evaluator import Evaluator, open_executor
from nermo_sim.optimize.figure import draw_front
from nermo_sim.optimize.rollout import Walk
from nermo_sim.optimize.search import QUICK, Budget, Candidate, Found, Search, gain, scaling
from nermo_sim.optimize.space import Space
from nermo_sim.options import SearchRequest

COLUMNS = ("set", "speed_m_s", "roll_sd_deg", "pitch_sd_deg", "cost_of_transport", "fell")
METRICS = COLUMNS[1:]


@dataclass(frozen=True, slots=True, kw_only=True)
class GaitSearch(SearchRequest):
    """What the user asks for. Raises CommandError (status 2) for what cannot be."""

    cost: str
    weights: str
    least_speed: float
    gait: str
    frequency: float
    spine: bool
    name: str
    sets_folder: Path | None

    def __post_init__(self) -> None:
        gaits = GaitParameters().gaits
        if self.gait not in gaits:
            raise CommandError(f"--gait {self.gait!r} is unknown: choose among {', '.join(gaits)}", status=2)
        if (error := frequency_error(self.frequency)) is not None:
            raise CommandError(f"--frequency: {error}", status=2)
        try:
            self.sets().check_name(self.set_name)
        except ParameterError as error:
            raise CommandError(str(error), status=2) from error
        if self.name and self.name in self.sets().names():
            raise CommandError(f"--name: the set {self.name!r} exists already; take another name", status=2)

    @property
    def set_name(self) -> str:
        """Name under which the best is saved."""
        return self.name or f"optimized_{self.cost}"

    @property
    def walk(self) -> Walk:
        """What every rollout does."""
        return Walk(self.robot, self.gait, self.frequency, self.spine)

    @property
    def budget(self) -> Budget:
        """How much is tried."""
        budget = QUICK if self.quick else Budget()
        return budget if self.generations is None else replace(budget, generations=self.generations)

    def sets(self, parameters: GaitParameters | None = None) -> GaitKnowledgeBase:
        """The named sets, with these parameters as the present ones."""
        return GaitKnowledgeBase(self.sets_folder or default_sets_folder(), parameters)


def search_gait(wanted: GaitSearch, json: Path | None) -> None:
    """Searches, keeps every rollout, saves the best set, prints and draws what was found.

    Raises CommandError.
    """
    base, objective = GaitParameters(), Objective(weights_of(wanted.cost, wanted.weights), wanted.least_speed)
    space, budget = Space(base, wanted.gait, wanted.spine), wanted.budget
    console.print(
        f"{len(space)} parameters, up to {budget.rollouts} rollouts, {wanted.processes} workers, seed {wanted.seed}; "
        f"in {wanted.folder}"
    )
    log = ResultLog(wanted.folder / "rollouts.jsonl", wanted.walk.digest())
    with (
        counting("rollouts", budget.rollouts) as counter,
        open_executor(wanted.executor, wanted.processes) as pool,
    ):
        evaluator = Evaluator(pool, log, wanted.walk, counter.advance)
        found = Search(space, base, evaluator, objective, wanted.seed).run(budget)
    saved = wanted.sets(found.best.parameters).save(wanted.set_name, overwrite=True)

    facts = _facts(wanted, found, objective, space)
    facts["best"] |= {
        "gain": gain(found.best.metrics, found.baseline.metrics),
        "name": wanted.set_name,
        "file": saved,
    }
    facts["pictures"] = [
        draw_front(wanted.folder / f"front_{wanted.cost}.png", facts["front"], facts["baseline"], facts["best"])
    ]
    facts["scaling"] = [] if wanted.quick else scaling(wanted.walk, base)
    rollouts = evaluator.rollouts
    facts |= {
        "rollouts": rollouts.count,
        "rollouts_now": rollouts.run_now,
        "rollouts_per_s": rollouts.run_now / rollouts.seconds if rollouts.run_now else None,
    }
    _print(wanted, facts)
    console.print(f"{rollouts.count} rollouts, {rollouts.run_now} of them now; saved as {wanted.set_name}: {saved}")
    if json is not None:
        write_results(json, "optimize", facts, robot=wanted.robot, seed=wanted.seed)


def _facts(wanted: GaitSearch, found: Found, objective: Objective, space: Space) -> dict[str, Any]:
    def row(title: str, candidate: Candidate) -> dict[str, Any]:
        return {
            "set": title,
            **{metric: candidate.metrics[metric] for metric in METRICS},
            "cost": objective(candidate.metrics, found.baseline.metrics),
            "parameters": space.values(candidate.parameters),
        }

    unseen = [{**facts, "set": f"unseen, friction x {facts['ground']:g}"} for facts in found.unseen]
    return {
        "cost": wanted.cost,
        "weights": objective.weights,
        "least_speed": wanted.least_speed,
        "gait": wanted.gait,
        "frequency_hz": wanted.frequency,
        "spine": wanted.spine,
        "best": row(wanted.set_name, found.best),
        "front": [row(f"front {number + 1}", one) for number, one in enumerate(found.front)],
        "baseline": row("thesis", found.baseline),
        "unseen": {"rows": unseen, "gain": unseen[-1]["gain"], "cost": unseen[-1]["cost"]},
        "executor": wanted.executor,
        "workers": wanted.processes,
        "candidates": found.tried,
        "history": found.history,
    }


def _print(wanted: GaitSearch, facts: dict[str, Any]) -> None:
    title = f"{wanted.gait} at {wanted.frequency} Hz, searched for {wanted.cost}"
    print_rows(title, [facts["baseline"], facts["best"], *facts["front"]], COLUMNS)
    for row in facts["unseen"]["rows"]:
        print_facts(row["set"], {name: row[name] for name in ("baseline", "best", "gain")})
    parameters = {"thesis": facts["baseline"]["parameters"], wanted.set_name: facts["best"]["parameters"]}
    print_facts("parameters", parameters)
