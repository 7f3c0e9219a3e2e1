"""The search: a space-filling design of the numbers' bounds, then CMA-ES from its best point.

Both see the fitted half of the claims and nothing else. They are deterministic for a seed, and every trial is kept: a
calibration that was stopped is begun anew, finds its trials done, and goes on from there to the very same end.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from pydantic import ValidationError
from scipy.stats import qmc

from nermo_description.parameters import RobotParameters
from nermo_sim.calibrate.numbers import NUMBERS, Array, point_of, variant
from nermo_sim.calibrate.trials import Trial, all_cases, cheap_cases, claims_of, cost, misses, tables
from nermo_sim.experiments.lookup import Row
from nermo_sim.experiments.runs import Settings
from nermo_sim.optimize.rollouts import Rollouts
from nermo_sim.optimize.search import minimise

FIRST_STEP = 0.12
"""Standard deviation of the first generation, as a share of each range."""


@dataclass(frozen=True, slots=True)
class Budget:
    """How much is tried."""

    design: int = 40
    """Points spread over the bounds."""
    population: int = 8
    generations: int = 8
    distance: float = 0.4
    """Of the straight walks of the search [m]."""
    judged: bool = True
    """Whether all cases are run in the end, before and after; the held-back half needs it."""


QUICK = Budget(design=3, population=3, generations=1, distance=0.3, judged=False)


@dataclass(slots=True)
class Candidate:
    """A point that was tried."""

    point: Array
    misses: dict[str, float]
    cost: float


@dataclass(slots=True)
class Found:
    """What a calibration found."""

    values: dict[str, float]
    wanted: list[str]
    """Claims of the fitted half that the search saw."""
    best: Candidate
    baseline: Candidate
    tried: list[Candidate]
    before: list[Row]
    after: list[Row]
    history: list[float] = field(default_factory=list)


class Calibration:
    """One calibration of a robot.

    settings: of the trials; their robot is the starting point.
    """

    def __init__(self, settings: Settings, rollouts: Rollouts[Trial], plan: Callable[[int], None] = lambda _: None):
        self._settings, self._rollouts, self._plan = settings, rollouts, plan
        self._robot: RobotParameters = settings.mouse
        self._cases: list[tuple[str, Any]] = []
        self._wanted: list[str] = []
        self._tried: list[Candidate] = []
        self._history: list[float] = []

    def run(self, budget: Budget) -> Found:
        """The whole of it. Raises ValueError where the robot as it is answers no claim of the fitted half."""
        cheap = replace(self._settings, distance=budget.distance, repeats=1, quick=True)  # half a maze
        start = point_of(self._robot)
        baseline = self._baseline(cheap, start)
        per_point = len(self._cases)
        points = budget.design + budget.population * budget.generations + 1
        self._plan(points * per_point + (2 * len(all_cases()) * self._settings.repeats if budget.judged else 0))
        design = qmc.LatinHypercube(len(NUMBERS), rng=np.random.default_rng(self._settings.seed)).random(budget.design)
        self._evaluate(design, cheap)
        self._minimise(budget, cheap)
        best = min(self._tried, key=lambda one: one.cost)
        values = _values(best.point)
        cases, settings = (all_cases(), self._settings) if budget.judged else (self._cases, cheap)
        before = self._rows(cases, settings)
        after = self._rows(cases, replace(settings, variant=variant(self._robot, values)))
        return Found(values, self._wanted, best, baseline, self._tried, before, after, self._history)

    def _baseline(self, settings: Settings, start: Array) -> Candidate:
        """Runs the cheap cases with the robot as it is, which says what it can be asked."""
        self._cases = cheap_cases()
        self._plan(len(self._cases))
        facts = self._facts(self._cases, [settings])[0]
        self._wanted = [row["claim"] for row in claims_of(facts) if row["half"] == "fitted"]
        if not self._wanted:
            raise ValueError("the robot as it is answers no claim of the fitted half")
        found = misses(claims_of(facts))
        candidate = Candidate(start, found, cost(found, self._wanted))
        self._tried.append(candidate)
        return candidate

    def _facts(self, cases: Sequence[tuple[str, Any]], variants: Sequence[Settings]) -> list[dict[str, Any]]:
        jobs = [
            [Trial(name, case, settings, repeat) for name, case in cases for repeat in range(settings.repeats)]
            for settings in variants
        ]
        results = self._rollouts.results(jobs)
        facts = []
        for settings, each in zip(variants, results, strict=True):
            runs = [each[i : i + settings.repeats] for i in range(0, len(each), settings.repeats)]
            facts.append(tables(cases, settings, runs))
        return facts

    def _variants(self, points: Array, settings: Settings) -> list[Settings | None]:
        """None where the numbers do not fit together."""
        found: list[Settings | None] = []
        for point in points:
            try:
                found.append(replace(settings, variant=variant(self._robot, _values(point))))
            except ValidationError:
                found.append(None)
        return found

    def _evaluate(self, points: Array, settings: Settings) -> list[float]:
        variants = self._variants(points, settings)
        facts = iter(self._facts(self._cases, [one for one in variants if one is not None]))
        costs = []
        for point, one in zip(points, variants, strict=True):
            found = {} if one is None else misses(claims_of(next(facts)))
            self._tried.append(Candidate(np.array(point), found, cost(found, self._wanted)))
            costs.append(self._tried[-1].cost)
        self._history.append(min(one.cost for one in self._tried))
        return costs

    def _minimise(self, budget: Budget, settings: Settings) -> None:
        from pymoo.algorithms.soo.nonconvex.cmaes import CMAES

        start = min(self._tried, key=lambda one: one.cost).point
        algorithm = CMAES(x0=start, sigma=FIRST_STEP, popsize=budget.population, normalize=False, bipop=False)

        def costs(points: Array) -> Array:
            return np.array(self._evaluate(points, settings))[:, None]

        # What pymoo counts as the first generation is the start alone.
        minimise(algorithm, costs, len(NUMBERS), 1, budget.generations + 1, self._settings.seed)

    def _rows(self, cases: Sequence[tuple[str, Any]], settings: Settings) -> list[Row]:
        return claims_of(self._facts(cases, [settings])[0])


def _values(point: Array) -> dict[str, float]:
    return {number.name: number.value(float(share)) for number, share in zip(NUMBERS, point, strict=True)}
