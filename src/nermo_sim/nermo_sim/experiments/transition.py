"""Emergent gait transition (C 3.3.2.3): the excitation of the Tegotae rule is stepped up, and the body picks the gait.

C steps it by pi/2 from 0 to 8 pi, and so does Cheetah-Cub here; the gait frequency of a mouse's command is at least 0.1
and at most 3 Hz, so there from pi/2 to 6 pi. The gait of each step is named from the footfalls of its second half.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from nermo_control.gait.knowledge_base import MAX_GAIT_FREQUENCY
from nermo_control.oscillators.legs import OscillatorSettings
from nermo_control.pantograph_controller import LocusShape, PantographGait
from nermo_control.types import ControlCommand, Posture
from nermo_description.parameters import RobotParameters
from nermo_sim.disturbance import DisturbedRun
from nermo_sim.experiments import coordination, pantograph
from nermo_sim.experiments.experiment import Experiment, Facts, Figures, Finished
from nermo_sim.experiments.footfalls import name_gait, touch_down_lags, touch_downs
from nermo_sim.experiments.runs import FALLEN, SETTLE, Job, Result, Settings, standing_loop
from nermo_sim.loop import constant
from nermo_sim.run_table import Recording

STEP = math.pi / 2.0
"""Of the excitation [rad/s]."""
HOLD, QUICK_HOLD = 10.0, 3.0
"""Time that each step lasts [s]; 10 s in C."""
STRIDE = 0.05
"""Step length L that is asked for throughout [m]."""
TOUCHING = 0.15
"""Force from which a foot of the mouse counts as set down [N]."""
THESIS_LEVELS = 16
"""Steps of the excitation in C, to 8 pi."""
SHORT_STEP, SWEEP_FEEDBACK = 0.064, 37.8
"""L [m] and sigma for one body weight [rad/s] of Cheetah-Cub throughout."""
SWEEP_SHAPE = LocusShape(
    height=0.101, step_height=0.008, compression=0.81, touch_down_angle=1.63, take_off_angle=1.70, offset=0.0
)
"""Its foot path: of 20 random sets the one with which it stays up longest as the excitation rises. The gait that trots
at 2.86 Hz falls as soon as it is asked to go slowly."""
SWEEP_REAR_OFFSET = -0.003
"""x_o of its rear legs [m]."""
RUNNING_FRONT = LocusShape(
    height=0.10662,
    step_height=0.01297,
    offset=0.01188,
    compression=0.547,
    touch_down_angle=1.2,
    take_off_angle=1.097,
)
RUNNING_REAR = LocusShape(
    height=0.10662,
    step_height=0.01297,
    offset=-0.03208,
    compression=0.9596,
    touch_down_angle=1.904,
    take_off_angle=1.654,
)
RUNNING_STEP, RUNNING_FEEDBACK = 0.105, 3.0
"""Foot paths, L [m] and sigma of the running start: of 94 gaits the fastest that the oscillators of `cpg` pace with."""
RUNNING_LEVEL, MOUSE_RUNNING_LEVEL = 9, 3
"""Where a running start begins, in steps of the excitation: Cheetah-Cub and the mouse trot there."""
SERIES_EVERY = 0.05
"""[s]"""


@dataclass(frozen=True, slots=True)
class Case:
    """One sweep."""

    compensation: bool
    running: bool = False
    """Whether it begins at an excitation at which the robot trots, and not from standing."""

    @property
    def key(self) -> str:
        """Name of the sweep."""
        return f"tegotae, compensation {'on' if self.compensation else 'off'}{', running start' * self.running}"


def cases(quick: bool) -> list[Case]:
    """Without and with fixed-point compensation, and without from a running start on."""
    return [Case(False)] if quick else [Case(False), Case(True), Case(False, running=True)]


def run(job: Job[Case]) -> Result:
    """The whole sweep, or until the robot falls."""
    if job.settings.family == "pantograph":
        return _sweep_pantograph(job)
    loop, disturbed = standing_loop(job)
    case = coordination.Case("tegotae", "true", job.case.compensation)
    walking = coordination.walking_loop(loop.twin, case, job.settings, job.seed)
    walking.run(constant(ControlCommand(0, posture=Posture.STAND)), 0.5 * SETTLE, record=False)
    hold = QUICK_HOLD if job.settings.quick else HOLD
    levels: list[dict[str, Any]] = []
    for number in range(
        MOUSE_RUNNING_LEVEL if job.case.running else 1, math.floor(2.0 * math.pi * MAX_GAIT_FREQUENCY / STEP) + 1
    ):
        frequency = number * STEP / (2.0 * math.pi)
        command = ControlCommand(
            0, forward_velocity=STRIDE * frequency / 0.5, gait=coordination.GAIT, gait_frequency=frequency
        )
        recording = walking.run(
            constant(command), hold, until=lambda twin: twin.tilt() > FALLEN, before_tick=disturbed.tick
        )
        levels.append(_level(number, recording, TOUCHING))
        if walking.twin.tilt() > FALLEN:
            break
    return {"levels": levels, "fell": walking.twin.tilt() > FALLEN}


def _sweep_pantograph(job: Job[Case]) -> Result:
    """As C does, from standing on, or from a running start; `series` has the oscillators' phases over time."""
    running = job.case.running
    oscillators = OscillatorSettings(
        feedback=RUNNING_FEEDBACK if running else SWEEP_FEEDBACK, fixed_point_compensation=job.case.compensation
    )
    gait = PantographGait(
        kind="tegotae",
        oscillators=oscillators,
        front=RUNNING_FRONT if running else SWEEP_SHAPE,
        rear=RUNNING_REAR if running else SWEEP_SHAPE.model_copy(update={"offset": SWEEP_REAR_OFFSET}),
    )
    walking = pantograph.standing_pantograph(job, gait)
    disturbed = DisturbedRun(walking.twin, job.settings.disturbance, job.seed)
    disturbed.begin()
    hold = QUICK_HOLD if job.settings.quick else HOLD
    levels: list[dict[str, Any]] = []
    series: list[list[float]] = []
    begin, ticks = walking.twin.time_ns, round(SERIES_EVERY * 1e9 / walking.twin.period_ns)
    count = 0

    def before_tick() -> None:
        nonlocal count
        disturbed.tick()
        if count % ticks == 0:
            time = (walking.twin.time_ns - begin) * 1e-9
            series.append([round(time, 3), *(round(phase, 3) for phase in walking.controller.phases)])
        count += 1

    first = RUNNING_LEVEL if running else 0
    for number in range(first, THESIS_LEVELS + 1, 4 if job.settings.quick else 1):
        command = pantograph.trot(gait, RUNNING_STEP if running else SHORT_STEP, number * STEP / (2.0 * math.pi))
        recording = walking.run(
            constant(command), hold, until=lambda twin: twin.tilt() > FALLEN, before_tick=before_tick
        )
        levels.append(_level(number, recording, pantograph.TOUCHING))
        if walking.twin.tilt() > FALLEN:
            break
    return {"levels": levels, "fell": walking.twin.tilt() > FALLEN, "series": series}


def _level(number: int, recording: Recording, touching: float) -> dict[str, Any]:
    """What the second half of a step of the excitation was."""
    half = recording.part(0.5 * float(recording.time[-1]), float(recording.time[-1]))
    downs = touch_downs(half.foot_forces, half.time, touching)
    gait, lags, reached = name_gait(downs), None, None
    if gait != "standing":
        found, _, reached = touch_down_lags(downs)
        lags = [None if math.isnan(lag) else round(lag, 3) for lag in found.tolist()]
    way = float(np.hypot(*(half.position[-1, :2] - half.position[0, :2])))
    return {
        "omega_rad_s": number * STEP,
        "excitation_hz": number * STEP / (2.0 * math.pi),
        "stride_hz": reached,
        "gait": gait,
        "lags": lags,
        "speed_m_s": way / float(half.time[-1]),
    }


def table(cases: Sequence[Case], settings: Settings, robot: RobotParameters, results: list[list[Result]]) -> list[Any]:
    """One row a step of each sweep."""
    return [
        {"compensation": case.compensation, "running_start": case.running, "repeat": repeat, **level}
        for case, runs in zip(cases, results, strict=True)
        for repeat, one in enumerate(runs)
        for level in one["levels"]
    ]


def series(cases: Sequence[Case], results: list[list[Result]]) -> list[dict[str, Any]]:
    """Time [s] and the four oscillators' phases [rad] of each sweep that has them, a list a sweep."""
    return [
        {
            "compensation": case.compensation,
            "running_start": case.running,
            "repeat": repeat,
            "phases": one["series"],
        }
        for case, runs in zip(cases, results, strict=True)
        for repeat, one in enumerate(runs)
        if "series" in one
    ]


def _further(done: Finished[Case]) -> Facts:
    return {"series": series(done.cases, done.results)}


def _figures(facts: Facts) -> Figures:
    from nermo_sim.report import modulation

    return [("gaits", "Lags of the footfalls, and phases (C figure 3.7)", modulation.transitions(facts))]


EXPERIMENT = Experiment(
    name="transition",
    title="Gaits as the excitation of the Tegotae rule rises",
    help="""
    Which gait emerges as the excitation of the Tegotae rule is stepped up (C 3.3.2.3), named from the footfalls.

    \b
    nermo experiment transition
    nermo experiment transition --robot cheetah_cub --repeats 1
    nermo experiment transition --quick --json transition.json
    """,
    columns=(
        *("compensation", "running_start", "repeat", "omega_rad_s", "excitation_hz", "stride_hz", "gait", "lags"),
        "speed_m_s",
    ),
    cases=cases,
    run=run,
    table=table,
    families=("mouse", "pantograph"),
    further=_further,
    source="C 3.3.2.3",
    figures=_figures,
    tables=lambda facts: [("Gaits", facts["rows"])],
)
