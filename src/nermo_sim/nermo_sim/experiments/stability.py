"""The dynamics of the pantograph leg three ways (C chapter 2): the longest step, what it costs, what a trot costs.

The largest step with which four legs on a fixed base, let go, come to rest (C 2.5.1), by binary search; the time of one
step; coordinates; the force of a leg over its length and the foot's angle (C figure 2.9); and the cost of transport.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from nermo_description.pantograph import PantographParameters
from nermo_description.robots import load_of_family
from nermo_sim.console import print_facts
from nermo_sim.experiments.experiment import Experiment, Facts, Figures, Finished
from nermo_sim.experiments.runs import Job, Result, Settings
from nermo_sim.leg_dynamics.fixed_base import (
    Integrator,
    Kind,
    build_fixed_base,
    largest_stable_step,
    step_cost,
    stiffened,
)
from nermo_sim.leg_dynamics.massless import look_up_table
from nermo_sim.leg_dynamics.transport import cost_of_transport

RATIOS = (1.0, 0.75, 0.5, 0.25)
"""Stiffness of the springs over the robot's, as in C 2.5.2."""
SMALLEST = 1e-5
"""Steps shorter than this are not tried [s]."""
LITTLE_FRICTION = 0.02
"""Of a toe that rings: where the explicit Euler method depends on the springs, as C's did [1]."""
THESIS_STEPS: dict[tuple[str, float], float] = {
    **{("constraints", ratio): 9e-3 for ratio in RATIOS},
    ("minimal", 1.0): 15e-6,
    ("minimal", 0.25): 166e-6,
    ("massless", 1.0): 1.69e-3,
}
"""C 2.5.2 and 2.7.2 [s]; what is between is only drawn there."""
THESIS_COSTS = {"constraints": 9e-3 / 2.7, "minimal": 380e-6, "massless": 350e-6}
"""Time of a step [s]: C 2.5.2 has 9 ms at 2.7 times real time, 2.6.2 and 2.7.3 the others."""
THESIS_COORDINATES = {"constraints": 198, "minimal": 19}
"""C 2.6.2."""
THESIS_STIFFNESS = 253.27
"""Largest stiffness of a leg along its length [N/m], C 2.7.1."""
INTEGRATORS: tuple[tuple[Kind, Integrator], ...] = (
    ("constraints", "semi_implicit"),
    ("minimal", "euler"),
    ("minimal", "semi_implicit"),
    ("massless", "euler"),
    ("massless", "semi_implicit"),
    ("massless_friction", "semi_implicit"),
)
"""C integrates the last two with the explicit Euler method; its first, ODE, is semi-implicit."""


@dataclass(frozen=True, slots=True)
class Case:
    """The largest step of one model, or its cost of transport."""

    what: Literal["step", "transport"]
    model: Kind
    integrator: Integrator = "semi_implicit"
    ratio: float = 1.0
    toe_friction: float = 1.0
    """Of the toe's joint over the robot's."""

    @property
    def key(self) -> str:
        """Name of the row."""
        return f"{self.what}, {self.model}, {self.integrator}, {self.ratio}, toe friction {self.toe_friction}"


def cases(quick: bool) -> list[Case]:
    """Every model at every stiffness; every model's trot."""
    ratios = (RATIOS[0], RATIOS[-1]) if quick else RATIOS
    steps = [Case("step", model, integrator, ratio) for model, integrator in INTEGRATORS for ratio in ratios]
    steps += [Case("step", "minimal", "euler", ratio, LITTLE_FRICTION) for ratio in ratios]
    models: tuple[Kind, ...] = ("constraints", "minimal", "massless_friction")
    return steps if quick else [*steps, *(Case("transport", model) for model in models)]


def run(job: Job[Case]) -> Result:
    """One search, or one trot."""
    case, robot = job.case, load_of_family(PantographParameters, job.settings.robot)
    if case.what == "transport":
        return cost_of_transport(robot, case.model)
    changed = stiffened(robot, case.ratio)
    less = changed.leg.model_copy(update={"toe_damping": case.toe_friction * changed.leg.toe_damping})
    changed = changed.model_copy(update={"leg": less})
    step = largest_stable_step(
        changed, case.model, case.integrator, smallest=SMALLEST, precision=1.2 if job.settings.quick else 1.05
    )
    cost = None if step is None else step_cost(changed, case.model, case.integrator, 0.5 * step)
    return {"largest_step_s": step, "step_cost_s": cost}


def table(cases: Sequence[Case], settings: Settings, robot: PantographParameters, results: list[list[Result]]) -> Any:
    """One row a model, integrator and stiffness."""
    rows = []
    for case, (result, *_) in zip(cases, results, strict=True):
        if case.what != "step":
            continue
        friction = case.model == "massless_friction"
        counts = coordinates(robot, case.model)
        rows.append(
            {
                "model": case.model,
                "integrator": case.integrator,
                "stiffness_ratio": case.ratio,
                "toe_friction_ratio": case.toe_friction,
                **result,
                "thesis_step_s": THESIS_STEPS.get((case.model, case.ratio)),
                "thesis_cost_s": THESIS_COSTS.get(case.model),
                **counts,
                "thesis_coordinates": None if friction else THESIS_COORDINATES.get(case.model),
            }
        )
    return rows


def coordinates(robot: PantographParameters, model: Kind) -> dict[str, int | None]:
    """Of the whole robot without its servos: in our model, and in free bodies held together by constraints alone."""
    base = build_fixed_base(robot, model, legs=4)
    bodies = base.model.nbody  # the world is counted in the place of the trunk
    inner = 4 if model == "massless_friction" else 0  # the folds of the knees, which are states of first order
    return {
        "coordinates": 6 + base.model.nv + inner,
        "maximal_coordinates": 6 * bodies if model == "constraints" else None,
    }


def further(done: Finished[Case]) -> Facts:
    """`leg_force`: the look-up table and its largest stiffness; `transport`: one row a model."""
    robot = load_of_family(PantographParameters, done.settings.robot)
    found = look_up_table(robot.leg, 25 if done.settings.quick else 61)
    pressed = np.minimum(found.force[1:], found.force[:-1]) > 0.0
    stiffness = np.where(pressed, found.stiffness, -np.inf)
    row, column = np.unravel_index(int(stiffness.argmax()), stiffness.shape)
    free = found.free_toe
    along = -np.diff(free) / np.diff(found.lengths)
    return {
        "leg_force": {
            "lengths_m": found.lengths,
            "angles_rad": found.angles,
            "force_n": found.force,
            "torque_n_m": found.torque,
            "largest_stiffness_n_m": float(stiffness.max()),
            "at_length_m": float(found.lengths[row]),
            "at_angle_rad": float(found.angles[column]),
            "free_toe_force_n": free,
            "largest_stiffness_free_toe_n_m": float(along.max()),
            "thesis_stiffness_n_m": THESIS_STIFFNESS,
        },
        "transport": [
            {"model": case.model, **result}
            for case, (result, *_) in zip(done.cases, done.results, strict=True)
            if case.what == "transport"
        ],
    }


def _notes(facts: Facts) -> None:
    print_facts("leg force", {name: value for name, value in facts["leg_force"].items() if isinstance(value, float)})
    if facts["transport"]:
        print_facts("cost of transport", {row["model"]: row for row in facts["transport"]})


def _figures(facts: Facts) -> Figures:
    from nermo_sim.report import legs

    return [
        ("steps", "Largest stable step and its cost (C figures 2.5, 2.6, 2.10)", legs.largest_steps(facts)),
        ("leg_force", "Force of the leg (C figure 2.9)", legs.leg_force(facts)),
        ("energy", "Cost of transport", legs.energy(facts)),
    ]


EXPERIMENT = Experiment(
    name="stability",
    title="The dynamics of the pantograph leg three ways",
    help="""The pantograph leg's dynamics three ways: largest stable step, its cost, cost of transport (C chapter 2).

    The times are measured: run it with one worker on a quiet machine for figures to compare.

    \b
    nermo experiment stability --workers 1
    nermo experiment stability --quick --json stability.json
    """,
    columns=(
        *("model", "integrator", "stiffness_ratio", "toe_friction_ratio", "largest_step_s", "thesis_step_s"),
        *("step_cost_s", "thesis_cost_s", "coordinates", "maximal_coordinates", "thesis_coordinates"),
    ),
    cases=cases,
    run=run,
    table=table,
    families=("pantograph",),
    robot="cheetah_cub",
    repeats=None,
    further=further,
    notes=_notes,
    source="C chapter 2",
    figures=_figures,
    tables=lambda facts: [("Steps", facts["rows"]), ("Cost of transport", facts["transport"])],
)
