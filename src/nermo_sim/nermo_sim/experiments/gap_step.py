"""Steps over a gap in the ground that is seen ahead (C 3.2.5, figure 3.1): all legs alike, or each leg for itself.

Cheetah-Cub trots towards a trench across its way, at a random distance, so that its feet come to the edge at random
phases. Three ways to take it: as if there were none; with the same change of the step length for all legs from where
the gap is seen, by the linear law of the footstep experiment, as C changes it; and leg by leg, each foot landing
farther ahead or back in the one step that would end in the gap. Crossed means that no foot was ever in the trench and
that the robot trots on behind it.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from nermo_control.footholds import Footfalls, Gap, landing_change, length_change
from nermo_control.pantograph_controller import PantographController
from nermo_control.types import ControlCommand, LegLoads, MotionOutput
from nermo_description.model import build_spec
from nermo_description.pantograph import PantographParameters
from nermo_description.parameters import LEGS, RobotParameters
from nermo_sim.disturbance import DisturbedRun
from nermo_sim.experiments import pantograph
from nermo_sim.experiments.experiment import Experiment, Facts, Figures, Finished, Outcome, Repeats
from nermo_sim.experiments.runs import FALLEN, Job, Result, Settings
from nermo_sim.loads import TrueLoads
from nermo_sim.loop import Loop, constant
from nermo_sim.run_table import Recording
from nermo_sim.sensor_data import SensorData
from nermo_sim.twin import Twin

SCENE = "trench"
CHANGES = ("none", "all", "each")
WIDTHS = (0.03, 0.05, 0.07)
"""Of the gap [m]; a foot touches 1 to 2 cm of the ground in each stance."""
FIRST, SPREAD = 2.5, 0.3
"""Least distance of the gap from the start [m], and the range from there on: about a stride."""
MARGIN = 0.014
"""Between a foot's stretch of ground and the gap [m]: the sole's radius is 6 mm, the forecast's deviation as much."""
SIGHT = 0.8
"""Distance of the gap from the trunk's middle from which on it is seen [m]: two strides before the front feet."""
MOST_AHEAD, MOST_BACK = 0.055, 0.012
"""Farthest that a foot is put ahead or back [m]: farther back, it could not be reached at the end of the stance."""
RESPONSE = {"cpg": 2.8, "tegotae": 3.3}
"""Displacement of the k-th footstep over k times the change of the step length [1]: the footstep experiment's fits."""
MOST_SHORTER = 0.04
"""Largest change of the step length [m], as in C."""
DEEP = 0.004
"""A foot whose sole is lower than the ground by more than this [m] is in the trench."""
BEHIND = 0.25
"""How far behind the gap the last foot must come [m]."""
LONGEST = 8.0
"""[s]"""


@dataclass(frozen=True, slots=True)
class Case:
    """One row of the table."""

    controller: str
    change: str
    """`none`, `all` legs alike, or `each` leg for itself."""
    width: float
    """[m]"""

    @property
    def key(self) -> str:
        """Name of the row."""
        return f"{self.controller}, {self.change}, {1e3 * self.width:g} mm"


def cases(quick: bool) -> list[Case]:
    """Open-loop CPG and Tegotae, three ways over gaps of several widths."""
    widths = WIDTHS[1:2] if quick else WIDTHS
    kinds = ("cpg",) if quick else ("cpg", "tegotae")
    return [Case(kind, change, width) for kind in kinds for change in CHANGES for width in widths]


def run(job: Job[Case]) -> Result:
    """One gap."""
    return cross(job)[0]


def cross(job: Job[Case], record: bool = False) -> tuple[Result, Recording, Twin[PantographParameters]]:
    """Trots over one gap, or into it; a recording where one is wanted."""
    # The same gaps for all rows, so that rows differ by what is done about them.
    near = FIRST + SPREAD * float(np.random.default_rng([job.settings.seed, job.repeat]).random())
    gap = Gap(near, near + job.case.width)
    robot, model = trench_model(job.settings.robot, gap)
    twin = Twin(robot, model=model)
    gait = pantograph.steady_gait(job.case.controller)
    controller = PantographController(robot, gait, twin.period_ns)
    stepper = _Stepper(twin, controller, gap, job.case)
    loop = Loop(twin, controller, stepper.feel)
    disturbed = DisturbedRun(twin, job.settings.disturbance, job.repeat)
    disturbed.begin()
    loop.run(constant(pantograph.trot(gait, 0.0, 0.0)), pantograph.STAND, record=False)
    commands = {0.0: constant(pantograph.trot(gait, pantograph.STEP_LENGTH, pantograph.STEADY_FREQUENCY))}

    def script(stamp: int) -> ControlCommand | None:
        change = stepper.length_change
        if change not in commands:
            length = pantograph.STEP_LENGTH + change
            commands[change] = constant(pantograph.trot(gait, length, pantograph.STEADY_FREQUENCY))
        return commands[change](stamp)

    recording = loop.run(
        script,
        LONGEST,
        record=record,
        until=lambda twin: twin.tilt() > FALLEN or stepper.behind or (bool(stepper.in_gap) and not record),
        before_tick=disturbed.tick,
    )
    stepper.close()
    result = {
        "gap_m": [gap.near, gap.far],
        "crossed": stepper.behind and not stepper.in_gap and twin.tilt() <= FALLEN,
        "feet_in_gap": sorted(LEGS[leg] for leg in stepper.in_gap),
        "fell": twin.tilt() > FALLEN,
        "changes_mm": [round(1e3 * change, 1) for change in stepper.changes()],
        "footfalls": stepper.footfalls,
    }
    return result, recording, twin


def filmed(case: Case, settings: Settings) -> tuple[mujoco.MjModel, Recording]:
    """The last 3 s of the first gap of a case."""
    _, recording, twin = cross(Job(case, 0, settings), record=True)
    return twin.model, recording.part(float(recording.time[-1]) - 3.0, float(recording.time[-1]))


def trench_model(name: str, gap: Gap) -> tuple[PantographParameters, mujoco.MjModel]:
    """The robot before a trench across its way, its edges at the gap's."""
    robot, spec = _trench(name)
    slab, beyond = spec.geom("scene_near"), spec.geom("scene_far")
    begin, end = slab.pos[0] - slab.size[0], beyond.pos[0] + beyond.size[0]
    for geom, low, high in ((slab, begin, gap.near), (beyond, gap.far, end)):
        geom.pos[0], geom.size[0] = 0.5 * (low + high), 0.5 * (high - low)
    return robot, spec.compile()


@functools.lru_cache(maxsize=2)
def _trench(name: str) -> tuple[PantographParameters, mujoco.MjSpec]:
    robot, _ = pantograph.compiled(name)
    return robot, build_spec(robot, SCENE)


class _Stepper:
    """Watches the feet after each tick, and changes the steps before the gap as the case says."""

    def __init__(self, twin: Twin[Any], controller: PantographController, gap: Gap, case: Case) -> None:
        self._twin, self._controller, self._gap, self._case = twin, controller, gap, case
        self._loads = TrueLoads(twin)
        self._sites = [twin.model.site(f"{leg}_foot").id for leg in LEGS]
        self._radius = twin.robot.leg.foot_radius
        self._footfalls = Footfalls()
        self._last: list[tuple[float, float] | None] = [None] * len(LEGS)
        self._shift_there = [0.0] * len(LEGS)
        self._planned = False
        self._most = [0.0] * len(LEGS)
        self.length_change = 0.0
        """Of all steps, from when the gap is seen [m]."""
        self.in_gap: set[int] = set()
        self.behind = False
        """Whether all feet are well behind the gap."""
        self.footfalls: list[dict[str, Any]] = []
        """Finished footfalls near the gap: leg, stretch from the near edge [mm], how far ahead it was put [mm]."""

    def feel(self, sensors: SensorData, output: MotionOutput) -> LegLoads | None:
        """The true loads; on the way, looks where the feet are and what is to be done."""
        feet = self._twin.data.site_xpos[self._sites]
        legs, forces = output.leg_states, sensors.foot_forces
        body = float(self._twin.odometry().x)
        self._keep(feet, forces)
        self._footfalls.step(
            body,
            feet[:, 0].tolist(),
            [force > pantograph.TOUCHING for force in forces],
            legs.phases,
            legs.phase_fractions,
        )
        if self._gap.near - body < SIGHT:
            self._change()
        self.behind = float(feet[:, 0].min()) > self._gap.far + BEHIND
        return self._loads.step(sensors, output)

    def _keep(self, feet: Any, forces: Sequence[float]) -> None:
        for leg in range(len(LEGS)):
            x, _, z = feet[leg].tolist()
            if self._gap.near < x < self._gap.far and z - self._radius < -DEEP:
                self.in_gap.add(leg)
            stretch = self._footfalls.stretch(leg)
            before, self._last[leg] = self._last[leg], stretch
            if stretch is None and before is not None:
                self._finish(leg, before)
            if stretch is not None and before is None:
                self._shift_there[leg] = self._controller.shifts[leg]

    def _finish(self, leg: int, stretch: tuple[float, float]) -> None:
        if abs(0.5 * sum(stretch) - self._gap.near) < 0.6:
            place = [round(1e3 * (edge - self._gap.near), 1) for edge in stretch]
            self.footfalls.append({"leg": LEGS[leg], "mm": place, "shift_mm": round(1e3 * self._shift_there[leg], 1)})

    def close(self) -> None:
        """Keeps the footfalls that are still going on."""
        for leg, stretch in enumerate(self._last):
            if stretch is not None:
                self._finish(leg, stretch)

    def _change(self) -> None:
        if self._case.change == "all" and not self._planned:
            change = length_change(self._gap, self._footfalls, MARGIN, RESPONSE[self._case.controller], MOST_SHORTER)
            if change is not None:
                self.length_change, self._planned = change, True
        if self._case.change != "each":
            return
        for leg in range(len(LEGS)):
            ahead = self._footfalls.ahead(leg)
            if ahead is None:
                continue
            shift = self._controller.shifts[leg]
            change = landing_change(self._gap, (ahead[0] - shift, ahead[1] - shift), MARGIN, MOST_AHEAD, MOST_BACK)
            self._controller.landings[leg] = change
            self._most[leg] = max(self._most[leg], change, key=abs)

    def changes(self) -> list[float]:
        """What was changed [m]: of all steps, or the largest of each leg."""
        return [self.length_change, *self._most]


def table(cases: Sequence[Case], settings: Settings, robot: RobotParameters, results: list[list[Result]]) -> list[Any]:
    """One row a case: the share of the gaps that were crossed, with its 95 % interval (Wilson)."""
    from scipy.stats import binomtest  # slow to load

    rows = []
    for case, runs in zip(cases, results, strict=True):
        crossed = sum(one["crossed"] for one in runs)
        interval = binomtest(crossed, len(runs)).proportion_ci(method="wilson")
        rows.append(
            {
                "controller": case.controller,
                "change": case.change,
                "width_m": case.width,
                "runs": len(runs),
                "crossed": crossed,
                "rate": crossed / len(runs),
                "rate_low": float(interval.low),
                "rate_high": float(interval.high),
                "fell": sum(one["fell"] for one in runs),
                "largest_change_mm": max((abs(change) for one in runs for change in one["changes_mm"]), default=0.0),
            }
        )
    return rows


def crossings(cases: Sequence[Case], results: list[list[Result]]) -> list[dict[str, Any]]:
    """Every run: its gap, whether it was crossed, and its footfalls near it."""
    return [
        {"controller": case.controller, "change": case.change, "width_m": case.width, "repeat": repeat, **one}
        for case, runs in zip(cases, results, strict=True)
        for repeat, one in enumerate(runs)
    ]


def _further(done: Finished[Case]) -> Facts:
    return {"runs": crossings(done.cases, done.results)}


def _figures(facts: Facts) -> Figures:
    from nermo_sim.report import modulation

    return [("gap_steps", "Gaps crossed, and footfalls against the gap", modulation.gap_crossings(facts))]


def _pictures(done: Outcome) -> list[Path]:
    from nermo_sim.render import film

    if not done.video:
        return []
    return film(done.folder / "gap_step.mp4", *filmed(Case("cpg", "each", WIDTHS[1]), done.settings))


EXPERIMENT = Experiment(
    name="gap-step",
    title="Steps over a gap that is seen ahead",
    help="""Steps over a trench that is seen ahead, at random distances: no change, all legs alike, each leg for itself.

    A foot in the trench is a result (`crossed`), not a failure.

    \b
    nermo experiment gap-step
    nermo experiment gap-step --repeats 50 --disturbed
    nermo experiment gap-step --quick --json gap.json
    """,
    columns=(
        *("controller", "change", "width_m", "runs", "crossed", "rate", "rate_low", "rate_high", "fell"),
        "largest_change_mm",
    ),
    cases=cases,
    run=run,
    table=table,
    families=("pantograph",),
    robot="cheetah_cub",
    repeats=Repeats(20, 3, "Gaps"),
    disturbed=False,
    video="the first gap, each leg for itself",
    further=_further,
    source="C 3.2.5",
    figures=_figures,
    tables=lambda facts: [("Gaps", facts["rows"])],
    pictures=_pictures,
)
