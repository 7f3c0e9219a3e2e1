"""Footstep modulation (C 3.2.5, 3.3.3): how far the footsteps move once the step length has been changed.

A walk in its limit cycle is run twice, once as it is and once with a shorter step from a random moment on, without
disturbances: what differs is the change alone. C shortens 12.6 cm by 2.5 mm to 4 cm, and so does Cheetah-Cub here; for
a mouse all is scaled to its step.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nermo_control.types import ControlCommand, Posture
from nermo_description.parameters import LEGS, RobotParameters
from nermo_sim.console import cell, console
from nermo_sim.experiments import coordination, pantograph
from nermo_sim.experiments.experiment import Experiment, Facts, Figures, Finished, Tables
from nermo_sim.experiments.losses import foot_motion
from nermo_sim.experiments.runs import SETTLE, Job, Result, Settings, standing_loop
from nermo_sim.loop import Loop, constant, schedule
from nermo_sim.run_table import Recording
from nermo_sim.twin import Twin

Array = NDArray[np.float64]

FREQUENCY = 0.8
"""[Hz]"""
STEP_LENGTH = 0.05
"""L before the change [m]."""
THESIS_LENGTH = 0.126
THESIS_CHANGES = (0.0025, 0.005, 0.01, 0.02, 0.03, 0.04)
"""C's L and its changes [m]."""
CHANGES = tuple(round(change / THESIS_LENGTH * STEP_LENGTH, 5) for change in THESIS_CHANGES)
"""By how much L is shortened [m]."""
LIMIT_CYCLE = 4.0
"""Walking before the change [s]."""
STEPS = 5
"""Footsteps of each foot that are looked at."""
REPEATS = 10
"""Moments of the change in the gait cycle; as many in C."""


@dataclass(frozen=True, slots=True)
class Steps:
    """The steps of a robot, and by how much they are shortened."""

    frequency: float
    """[Hz]"""
    length: float
    """L before the change [m]."""
    changes: tuple[float, ...]
    """[m]"""


MOUSE = Steps(FREQUENCY, STEP_LENGTH, CHANGES)
CHEETAH_CUB = Steps(pantograph.STEADY_FREQUENCY, pantograph.STEP_LENGTH, THESIS_CHANGES)


@dataclass(frozen=True, slots=True)
class Case:
    """One controller, and one moment of the change."""

    controller: str
    moment: int

    @property
    def key(self) -> str:
        """Name of the row."""
        return f"{self.controller}, moment {self.moment}"


def cases(quick: bool) -> list[Case]:
    """Open-loop CPG and Tegotae, each at random moments of the gait cycle."""
    return [Case(name, moment) for name in ("cpg", "tegotae") for moment in range(2 if quick else REPEATS)]


def run(job: Job[Case]) -> Result:
    """All changes at one moment: displacement [m] of each footstep, the mean of the four feet."""
    steps = CHEETAH_CUB if job.settings.family == "pantograph" else MOUSE
    share = float(np.random.default_rng([job.settings.seed, job.case.moment]).random())
    moment = LIMIT_CYCLE + share / steps.frequency
    base = footsteps(job, moment, 0.0)
    rows = []
    for change in steps.changes[1::3] if job.settings.quick else steps.changes:
        moved = footsteps(job, moment, change)
        for step in range(min(base.shape[1], moved.shape[1], STEPS)):
            rows.append(
                {"delta_m": change, "step": step + 1, "displacement_m": float(np.mean(moved[:, step] - base[:, step]))}
            )
    return {"rows": rows}


def footsteps(job: Job[Case], moment: float, change: float) -> Array:
    """Places of the footsteps after the moment along the way [m], (4, steps): where each foot stands at mid-stance."""
    if job.settings.family == "pantograph":
        gait = pantograph.steady_gait(job.case.controller)
        walking: Loop[Any] = pantograph.standing_pantograph(job, gait)
        steps = CHEETAH_CUB
        commands = [pantograph.trot(gait, length, steps.frequency) for length in (steps.length, steps.length - change)]
    else:
        walking, steps = _standing_mouse(job), MOUSE
        commands = [
            ControlCommand(
                0,
                forward_velocity=length * steps.frequency / 0.5,
                gait=coordination.GAIT,
                gait_frequency=steps.frequency,
            )
            for length in (steps.length, steps.length - change)
        ]
    begin = walking.twin.time_ns * 1e-9
    script = schedule([(begin, commands[0]), (begin + moment, commands[1])])
    recording = walking.run(script, moment + (STEPS + 2) / steps.frequency)
    return _places(recording, walking.twin, moment)


def _standing_mouse(job: Job[Case]) -> Loop[Any]:
    loop, _ = standing_loop(Job(job.case, 0, job.settings))
    kind = job.case.controller
    case = coordination.Case("tegotae", "true") if kind == "tegotae" else coordination.Case("cpg")
    walking = coordination.walking_loop(loop.twin, case, job.settings, seed=0)
    walking.run(constant(ControlCommand(0, posture=Posture.STAND)), 0.5 * SETTLE, record=False)
    return walking


def _places(recording: Recording, twin: Twin[Any], moment: float) -> Array:
    feet, base, _ = foot_motion(recording, twin.model)
    before = recording.time < moment
    way = base[before][-1, :2] - base[0, :2]
    along = feet[:, :, :2] @ (way / np.linalg.norm(way))
    places = []
    for leg in range(len(LEGS)):
        edges = np.flatnonzero(np.diff(recording.phases[:, leg]))
        # Stances that begin after the change: the swing before them could already know of it.
        stances = [
            (a + b) // 2
            for a, b in itertools.pairwise(edges)
            if recording.phases[a + 1, leg] == 0 and recording.time[a] > moment
        ]
        places.append(along[stances[:STEPS], leg])
    shortest = min(map(len, places))
    return np.array([place[:shortest] for place in places])


def table(cases: Sequence[Case], settings: Settings, robot: RobotParameters, results: list[list[Result]]) -> list[Any]:
    """One row a footstep: the keys of the JSON contract."""
    return [
        {"controller": case.controller, "repeat": case.moment, **row}
        for case, runs in zip(cases, results, strict=True)
        for row in runs[0]["rows"]
    ]


def fit(rows: Sequence[dict[str, Any]]) -> dict[str, dict[str, float]]:
    """By controller: displacement as slope x (change x step number), its R2, how often the first step is right.

    C finds it linear in both for Tegotae; a slope of -1 is a step that is shorter by all that was asked.
    """
    found = {}
    for name in dict.fromkeys(row["controller"] for row in rows):
        own = [row for row in rows if row["controller"] == name]
        x = np.array([row["delta_m"] * row["step"] for row in own])
        y = np.array([row["displacement_m"] for row in own])
        slope = float(x @ y / (x @ x))
        first = [row["displacement_m"] < 0.0 for row in own if row["step"] == 1]
        found[name] = {
            "slope": slope,
            "r2": float(1.0 - np.sum((y - slope * x) ** 2) / np.sum((y - y.mean()) ** 2)),
            "first_step_right": float(np.mean(first)),
        }
    return found


def _further(done: Finished[Case]) -> Facts:
    return {"fit": fit(done.rows)}


def _notes(facts: Facts) -> None:
    for name, values in facts["fit"].items():
        console.print(f"{name}: {cell(values)}")


def _figures(facts: Facts) -> Figures:
    from nermo_sim.report import modulation

    return [("footsteps", "Displacement (C figures 3.5, 3.8)", modulation.footsteps(facts))]


def _tables(facts: Facts) -> Tables:
    fits = [{"controller": name, **values} for name, values in facts["fit"].items()]
    return [("Linear fit", fits), ("Footsteps", facts["rows"])]


EXPERIMENT = Experiment(
    name="footstep",
    title="Footsteps after a change of the step length",
    help="""How far footsteps move once the step length has changed: open-loop CPG and Tegotae (C 3.2.5, 3.3.3).

    \b
    nermo experiment footstep
    nermo experiment footstep --robot cheetah_cub
    nermo experiment footstep --quick --json footstep.json
    """,
    columns=("controller", "delta_m", "step", "repeat", "displacement_m"),
    cases=cases,
    run=run,
    table=table,
    families=("mouse", "pantograph"),
    repeats=None,
    further=_further,
    notes=_notes,
    source="C 3.2.5 and 3.3.3",
    figures=_figures,
    tables=_tables,
)
