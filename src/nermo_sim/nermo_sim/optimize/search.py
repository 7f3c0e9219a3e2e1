"""The search: CMA-ES for the stated cost, then NSGA-II for the front of speed against roll, both of pymoo.

Both are deterministic for a seed and see nothing but rollouts, and rollouts are kept. A search that was stopped is
begun anew, finds its rollouts done, and goes on from there to the very same end.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nermo_control.gait.knowledge_base import GaitParameters
from nermo_description.results import CommandError
from nermo_sim.experiments.result_log import seed_for
from nermo_sim.optimize.costs import Objective, parts
from nermo_sim.optimize.evaluator import Evaluator, open_executor
from nermo_sim.optimize.rollout import Metrics, Trial, Walk
from nermo_sim.optimize.space import Space

Array = NDArray[np.float64]
Progress = Callable[[int, int], None]

FIRST_STEP = 0.15
"""Standard deviation of the first generation, as a share of each range."""
UNSEEN_GROUNDS = (1.0, 0.5)
"""Friction over the robot file's: as in the search, but other disturbances; and one that it did not see."""


@dataclass(frozen=True, slots=True)
class Budget:
    """How much is tried."""

    population: int = 12
    generations: int = 14
    front_population: int = 16
    front_generations: int = 6
    trials: int = 2
    """Disturbed rollouts of each candidate."""
    finalists: int = 4
    """The best of all are tried again, with other disturbances, before one of them is chosen: the least of many noisy
    costs is too good to be true."""
    final_trials: int = 4
    unseen_trials: int = 8

    @property
    def rollouts(self) -> int:
        """At most."""
        searched = self.population * self.generations + self.front_population * self.front_generations
        judged = self.finalists * self.final_trials + 2 * len(UNSEEN_GROUNDS) * self.unseen_trials
        return (searched + 1) * self.trials + judged


QUICK = Budget(4, 2, 4, 2, trials=1, finalists=1, final_trials=1, unseen_trials=1)


@dataclass(frozen=True, slots=True)
class Candidate:
    """A set that was tried."""

    parameters: GaitParameters
    metrics: Metrics


@dataclass(slots=True)
class Found:
    """What a search found."""

    baseline: Candidate
    best: Candidate
    front: list[Candidate]
    unseen: list[dict[str, Any]]
    tried: int
    """Candidates."""
    history: list[float] = field(default_factory=list)
    """Least cost after each generation of the first search."""


class Search:
    """One search over a space with an evaluator."""

    def __init__(
        self, space: Space, base: GaitParameters, evaluator: Evaluator, objective: Objective, seed: int
    ) -> None:
        self._space, self._base, self._evaluator, self._objective = space, base, evaluator, objective
        self._seed = seed
        self._tried: dict[str, Candidate] = {}

    def run(self, budget: Budget) -> Found:
        """The whole search: the cost, the front, the choice, and the judgement on what was not seen.

        Raises CommandError where the base set cannot walk.
        """
        trials = self._trials("search", budget.trials)
        self._baseline = self._evaluator.evaluate([self._base], trials)[0]
        if self._baseline["fell"] or self._baseline["speed_m_s"] <= 0.0:
            raise CommandError("the mouse does not walk with the thesis's parameters: nothing to compare with")
        start = self._space.point(self._base)
        history = self._minimise(start, budget, trials)
        self._spread(start, budget, trials)
        best = self._choose(budget)
        return Found(
            Candidate(self._base, self._baseline),
            best,
            front(list(self._tried.values())),
            self._judge(best, budget),
            len(self._tried),
            history,
        )

    def _trials(self, purpose: str, count: int, ground: float = 1.0) -> list[Trial]:
        return [Trial(seed_for(self._seed, purpose, number), ground) for number in range(count)]

    def _cost(self, candidate: Candidate) -> float:
        return self._objective(candidate.metrics, self._baseline)

    def _evaluate(self, points: Array, trials: Sequence[Trial]) -> list[Candidate]:
        sets = [self._space.parameters(point) for point in points]
        found = [Candidate(*pair) for pair in zip(sets, self._evaluator.evaluate(sets, trials), strict=True)]
        self._tried.update({one.parameters.model_dump_json(): one for one in found})
        return found

    def _minimise(self, start: Array, budget: Budget, trials: Sequence[Trial]) -> list[float]:
        from pymoo.algorithms.soo.nonconvex.cmaes import CMAES

        history: list[float] = []

        def costs(points: Array) -> Array:
            values = [self._cost(one) for one in self._evaluate(points, trials)]
            history.append(min([*values, *history[-1:]]))
            return np.array(values)[:, None]

        algorithm = CMAES(x0=start, sigma=FIRST_STEP, popsize=budget.population, normalize=False, bipop=False)
        # What pymoo counts as the first generation is the start alone.
        minimise(algorithm, costs, len(self._space), 1, budget.generations + 1, self._seed)
        return history

    def _spread(self, start: Array, budget: Budget, trials: Sequence[Trial]) -> None:
        """From the best compromises so far; the rest of the first generation is drawn around the base set."""
        from pymoo.algorithms.moo.nsga2 import NSGA2

        def ratios(points: Array) -> Array:
            found = (parts(one.metrics, self._baseline) for one in self._evaluate(points, trials))
            return np.array([[each["speed"], each["roll"]] for each in found])

        known = [self._space.point(one.parameters) for one in front(list(self._tried.values()))]
        random = np.random.default_rng(self._seed)
        count = max(0, budget.front_population - len(known))
        drawn = start + 2.0 * FIRST_STEP * random.standard_normal((count, len(self._space)))
        first = np.clip(np.array([*known[: budget.front_population], *drawn]), 0.0, 1.0)
        algorithm = NSGA2(pop_size=budget.front_population, sampling=first)
        minimise(algorithm, ratios, len(self._space), 2, budget.front_generations, self._seed)

    def _choose(self, budget: Budget) -> Candidate:
        ranked = sorted(self._tried.values(), key=self._cost)[: budget.finalists]
        sets = [one.parameters for one in ranked]
        again = self._evaluator.evaluate(sets, self._trials("final", budget.final_trials))
        costs = [self._objective(metrics, self._baseline) for metrics in again]
        return ranked[int(np.argmin(costs))]

    def _judge(self, best: Candidate, budget: Budget) -> list[dict[str, Any]]:
        rows = []
        for ground in UNSEEN_GROUNDS:
            trials = self._trials("unseen", budget.unseen_trials, ground)
            before, after = self._evaluator.evaluate([self._base, best.parameters], trials)
            rows.append(
                {
                    "ground": ground,
                    "trials": len(trials),
                    "baseline": before,
                    "best": after,
                    "gain": gain(after, before),
                    "cost": self._objective(after, before) if before["speed_m_s"] > 0.0 else math.nan,
                }
            )
        return rows


def minimise(
    algorithm: Any, objectives: Callable[[Array], Array], variables: int, count: int, generations: int, seed: int
) -> None:
    """Lets an algorithm of pymoo minimise objectives (n, count) of points (n, variables) in [0, 1]."""
    from pymoo.core.problem import Problem
    from pymoo.optimize import minimize

    class Rollouts(Problem):
        def _evaluate(self, x: Array, out: dict[str, Any], *_: Any, **__: Any) -> None:
            out["F"] = objectives(np.atleast_2d(x))

    problem = Rollouts(n_var=variables, n_obj=count, xl=np.zeros(variables), xu=np.ones(variables))
    # CMA-ES takes a seed of 0 for "by the clock".
    minimize(problem, algorithm, ("n_gen", generations), seed=seed + 1, copy_algorithm=False)


def front(candidates: Sequence[Candidate]) -> list[Candidate]:
    """Who is beaten by nobody in both speed and deviation of roll, slowest first; the fallen are left out."""
    found: list[Candidate] = []
    for one in sorted(candidates, key=lambda one: (one.metrics["roll_sd_deg"], -one.metrics["speed_m_s"])):
        fast_enough = not found or one.metrics["speed_m_s"] > found[-1].metrics["speed_m_s"]
        if fast_enough and not one.metrics["fell"]:
            found.append(one)
    return found


def gain(after: Metrics, before: Metrics) -> dict[str, float]:
    """By how much each quantity changed, as a share of what it was; more speed and less of the others is better."""
    names = [name for name in before if name != "fell"]
    return {name: after[name] / before[name] - 1.0 if before[name] else math.nan for name in names}


def scaling(
    walk: Walk, base: GaitParameters, counts: Sequence[int] = (1, 2), rollouts: int = 12
) -> list[dict[str, Any]]:
    """Rollouts per second with so many processes each, warmed up; nothing of it is kept."""
    rows = []
    for count in counts:
        with open_executor("processes", count) as executor:
            list(executor.map(_warm_up, [walk] * 2 * count))
            begin = time.monotonic()
            evaluator = Evaluator(executor, _Nothing(), walk)  # type: ignore[arg-type]
            evaluator.evaluate([base], [Trial(number) for number in range(rollouts)])
            seconds = time.monotonic() - begin
        rows.append({"processes": count, "rollouts": rollouts, "rollouts_per_s": rollouts / seconds})
    return rows


def _warm_up(walk: Walk) -> None:
    from nermo_sim.optimize.rollout import Rollout, run

    run(Rollout(Walk(walk.robot, walk.gait, walk.frequency_hz, walk.spine, cycles=2), GaitParameters(), Trial(0)))


class _Nothing(dict[str, Metrics]):
    """A log that forgets."""

    def add(self, key: str, result: Metrics) -> None:
        self[key] = result
