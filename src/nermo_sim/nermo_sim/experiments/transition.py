"""Emergent gait transition (C 3.3.2.3): the excitation of the Tegotae rule is stepped up, and the body picks the gait.

C steps it by pi/2 from 0 to 8 pi; the gait frequency of our command is at least 0.1 and at most 3 Hz, so here from
pi/2 to 6 pi. The gait of each step is named from the footfalls of its second half.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from nermo_control.gait.knowledge_base import MAX_GAIT_FREQUENCY
from nermo_control.types import ControlCommand, Posture
from nermo_description.parameters import RobotParameters
from nermo_sim.experiments import coordination
from nermo_sim.experiments.footfalls import name_gait, touch_down_lags, touch_downs
from nermo_sim.experiments.runs import FALLEN, SETTLE, Job, Result, Settings, standing_loop
from nermo_sim.loop import constant

STEP = math.pi / 2.0
"""Of the excitation [rad/s]."""
HOLD, QUICK_HOLD = 10.0, 3.0
"""Time that each step lasts [s]; 10 s in C."""
STRIDE = 0.05
"""Step length L that is asked for throughout [m]."""
TOUCHING = 0.15
"""Force from which a foot counts as set down [N]."""


@dataclass(frozen=True, slots=True)
class Case:
    """One sweep."""

    compensation: bool

    @property
    def key(self) -> str:
        """Name of the sweep."""
        return f"tegotae, compensation {'on' if self.compensation else 'off'}"


def cases(quick: bool) -> list[Case]:
    """Without and with fixed-point compensation."""
    return [Case(False)] if quick else [Case(False), Case(True)]


def run(job: Job[Case]) -> Result:
    """The whole sweep, or until the mouse falls."""
    loop, disturbed = standing_loop(job)
    case = coordination.Case("tegotae", "true", job.case.compensation)
    walking = coordination.walking_loop(loop.twin, case, job.settings, job.seed)
    walking.run(constant(ControlCommand(0, posture=Posture.STAND)), 0.5 * SETTLE, record=False)
    hold = QUICK_HOLD if job.settings.quick else HOLD
    levels: list[dict[str, Any]] = []
    for number in range(1, math.floor(2.0 * math.pi * MAX_GAIT_FREQUENCY / STEP) + 1):
        frequency = number * STEP / (2.0 * math.pi)
        command = ControlCommand(
            0, forward_velocity=STRIDE * frequency / 0.5, gait=coordination.GAIT, gait_frequency=frequency
        )
        recording = walking.run(
            constant(command), hold, until=lambda twin: twin.tilt() > FALLEN, before_tick=disturbed.tick
        )
        half = recording.part(0.5 * float(recording.time[-1]), float(recording.time[-1]))
        downs = touch_downs(half.foot_forces, half.time, TOUCHING)
        gait, lags, reached = name_gait(downs), None, None
        if gait != "standing":
            found, _, reached = touch_down_lags(downs)
            lags = [None if math.isnan(lag) else round(lag, 3) for lag in found.tolist()]
        way = float(np.hypot(*(half.position[-1, :2] - half.position[0, :2])))
        levels.append(
            {
                "omega_rad_s": number * STEP,
                "excitation_hz": frequency,
                "stride_hz": reached,
                "gait": gait,
                "lags": lags,
                "speed_m_s": way / float(half.time[-1]),
            }
        )
        if walking.twin.tilt() > FALLEN:
            break
    return {"levels": levels, "fell": walking.twin.tilt() > FALLEN}


def table(cases: Sequence[Case], settings: Settings, robot: RobotParameters, results: list[list[Result]]) -> list[Any]:
    """One row a step of each sweep."""
    return [
        {"compensation": case.compensation, "repeat": repeat, **level}
        for case, runs in zip(cases, results, strict=True)
        for repeat, one in enumerate(runs)
        for level in one["levels"]
    ]
