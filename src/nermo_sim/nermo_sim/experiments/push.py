"""How hard a push to the side each way to coordinate the legs takes (C 3.3 on Nermo): survived, and recovered when.

The trot of the coordination experiment, pushed in the middle of a run. The pushes grow until the mouse falls: with the
one push of that experiment all recover at once, which tells nothing apart.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from nermo_control.oscillators.legs import Coordination
from nermo_control.types import ControlCommand, Posture, TrajectoryMode
from nermo_description.parameters import RobotParameters
from nermo_sim.experiments import coordination
from nermo_sim.experiments.experiment import Experiment, Facts, Figures
from nermo_sim.experiments.runs import FALLEN, SETTLE, Job, Result, Settings, full_speed, standing_loop
from nermo_sim.loop import constant

PUSHES = (1.2, 1.4, 1.6, 1.8, 2.0, 2.4)
"""[N], to the left, for `coordination.PUSH_DURATION`; a mouse weighs about 2.8 N."""
BEFORE, AFTER = 5.0, 6.0
"""Walking before the push and after it [s]."""


@dataclass(frozen=True, slots=True)
class Case:
    """One row of the table."""

    coordination: Coordination
    loads: str
    push: float
    """[N]"""

    @property
    def key(self) -> str:
        """Name of the row."""
        return f"{self.coordination}, loads {self.loads}, push {self.push:g} N"


def cases(quick: bool) -> list[Case]:
    """The clock, and Tegotae on the true and on the felt loads, under growing pushes."""
    kinds: list[tuple[Coordination, str]] = [("timed", "-"), ("tegotae", "true"), ("tegotae", "estimated")]
    pushes = PUSHES[::3] if quick else PUSHES
    return [Case(kind, loads, push) for kind, loads in (kinds[:2] if quick else kinds) for push in pushes]


def run(job: Job[Case]) -> Result:
    """Walks, is pushed, walks on or falls."""
    case, settings = job.case, job.settings
    # The same ground, pose and small pushes for all rows, so that rows differ by what coordinates the legs.
    loop, disturbed = standing_loop(Job(Case("timed", "-", 0.0), job.repeat, settings))
    walking = coordination.walking_loop(loop.twin, coordination.Case(case.coordination, case.loads), settings, job.seed)
    twin, pushed = walking.twin, False
    walking.run(constant(ControlCommand(0, posture=Posture.STAND)), 0.5 * SETTLE, record=False)
    moment = twin.time_ns + round(BEFORE * 1e9)

    def before_tick() -> None:
        nonlocal pushed
        disturbed.tick()
        if not pushed and twin.time_ns >= moment:
            pushed = True
            twin.push((0.0, case.push, 0.0), coordination.PUSH_DURATION)

    command = ControlCommand(
        0,
        forward_velocity=full_speed(settings, coordination.GAIT, coordination.FREQUENCY),
        trajectory_mode=TrajectoryMode.STRAIGHT_LINE,
        gait=coordination.GAIT,
        gait_frequency=coordination.FREQUENCY,
    )
    recording = walking.run(
        constant(command), BEFORE + AFTER, until=lambda twin: twin.tilt() > FALLEN, before_tick=before_tick
    )
    fell = twin.tilt() > FALLEN
    after = recording.part(BEFORE, BEFORE + AFTER)
    return {
        "fell": fell,
        "recovery_s": None if fell else coordination.recovery_time(recording, BEFORE),
        "largest_roll_deg": float(np.degrees(np.abs(after.roll_pitch_yaw[:, 0]).max())),
    }


def table(cases: Sequence[Case], settings: Settings, robot: RobotParameters, results: list[list[Result]]) -> list[Any]:
    """One row a case."""
    rows = []
    for case, runs in zip(cases, results, strict=True):
        times = [one["recovery_s"] for one in runs if one["recovery_s"] is not None]
        rows.append(
            {
                "coordination": case.coordination,
                "loads": case.loads,
                "push_n": case.push,
                "runs": len(runs),
                "survived": sum(not one["fell"] for one in runs),
                "recovered": len(times),
                "recovery_s": float(np.mean(times)) if times else None,
                "largest_roll_deg": float(np.mean([one["largest_roll_deg"] for one in runs])),
            }
        )
    return rows


def _figures(facts: Facts) -> Figures:
    from nermo_sim.report import modulation

    return [("pushes", "Survived, and recovered when", modulation.pushes(facts))]


EXPERIMENT = Experiment(
    name="push",
    title="Pushes aside",
    help="""
    How hard a push aside the timed trot and Tegotae take, and how soon they have recovered (C 3.3 on the mouse).

    A fall is a result (`survived`), not a failure.

    \b
    nermo experiment push
    nermo experiment push --quick --json push.json
    """,
    columns=("coordination", "loads", "push_n", "runs", "survived", "recovered", "recovery_s", "largest_roll_deg"),
    cases=cases,
    run=run,
    table=table,
    figures=_figures,
    tables=lambda facts: [("Pushes", facts["rows"])],
)
