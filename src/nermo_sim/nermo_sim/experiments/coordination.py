"""Who lifts a foot: the clock, coupled oscillators, or the legs' own loads (C 3.3 on Nermo, where nobody has tried it).

The trot at 0.8 Hz on a straight line; after half of the time the mouse is pushed aside. With a leg that has fallen out
(C's outlook: amputation) its servos stay folded and its foot touches nothing.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nermo_control.controller import LOCKSTEP_MOTION, Controller
from nermo_control.oscillators.legs import Coordination, OscillatorSettings
from nermo_control.types import ControlCommand, MotionOutput, Posture, TrajectoryMode
from nermo_description.parameters import LEGS, RobotParameters
from nermo_sensors.parameters import tactile_of_robot
from nermo_sim.experiments.experiment import Experiment
from nermo_sim.experiments.losses import foot_motion
from nermo_sim.experiments.orientation import orientation_noise
from nermo_sim.experiments.runs import FALLEN, SETTLE, Job, Result, Settings, full_speed, mean, spread, standing_loop
from nermo_sim.loads import FeltLoads, TrueLoads
from nermo_sim.loop import Loop, constant
from nermo_sim.run_table import Recording
from nermo_sim.twin import Twin

GAIT, FREQUENCY = "trot", 0.8
DURATION = 16.0
"""[s]"""
PUSH = (0.0, 1.2, 0.0)
"""Force [N] of the push to the left, somewhat less than half of the weight."""
PUSH_DURATION = 0.1
"""[s]"""
CALM = 1.5
"""The mouse has recovered once no cycle is farther from the usual one than this times what cycles were before [1]."""
START = 1
"""Cycles from the start that say nothing of the usual one."""
FEEDBACK = 3.0
"""sigma for a load of one body weight [rad/s]: as large as it goes with a trot at 0.8 Hz that stays one (docs)."""


@dataclass(frozen=True, slots=True)
class Case:
    """One row of the table."""

    coordination: Coordination
    loads: str = "-"
    """What Tegotae listens to: true, estimated, or nothing (-)."""
    compensation: bool = False
    missing_leg: str = ""

    @property
    def key(self) -> str:
        """Name of the row."""
        parts = [self.coordination, f"loads {self.loads}", f"compensation {'on' if self.compensation else 'off'}"]
        return ", ".join([*parts, f"without {self.missing_leg}"] if self.missing_leg else parts)


def cases(quick: bool) -> list[Case]:
    """The clock, the oscillators, and Tegotae with true and with estimated loads; then each without a leg."""
    whole = [
        Case("timed"),
        Case("cpg"),
        Case("tegotae", "true"),
        Case("tegotae", "estimated"),
        Case("tegotae", "true", compensation=True),
    ]
    if quick:
        return whole[:1] + whole[3:4]
    lame = [replace(case, missing_leg="rear_left") for case in (whole[0], whole[2], whole[3])]
    return whole + lame


def run(job: Job[Case]) -> Result:
    """Walks, is pushed, walks on."""
    case, settings = job.case, job.settings
    loop, disturbed = standing_loop(job)
    walking = walking_loop(loop.twin, case, settings, job.seed)
    duration = 0.5 * DURATION if settings.quick else DURATION
    command = ControlCommand(
        0,
        forward_velocity=full_speed(settings, GAIT, FREQUENCY),
        trajectory_mode=TrajectoryMode.STRAIGHT_LINE,
        gait=GAIT,
        gait_frequency=FREQUENCY,
    )
    twin, pushed = walking.twin, False
    middle = twin.time_ns + round(0.5 * duration * 1e9)

    def before_tick() -> None:
        nonlocal pushed
        disturbed.tick()
        if not pushed and twin.time_ns >= middle:
            pushed = True
            twin.push(PUSH, PUSH_DURATION)

    walking.run(constant(ControlCommand(0, posture=Posture.STAND)), 0.5 * SETTLE, record=False)
    recording = walking.run(
        constant(command), duration, until=lambda twin: twin.tilt() > FALLEN, before_tick=before_tick
    )
    fell = twin.tilt() > FALLEN
    calm = recording.part(0.0, 0.5 * duration)
    way = float(np.hypot(*(calm.position[-1, :2] - calm.position[0, :2])))
    return {
        "speed_m_s": way / float(calm.time[-1]),
        **orientation_noise(calm, FREQUENCY),
        "recovery_s": None if fell else recovery_time(recording, 0.5 * duration),
        **step_scatter(calm, twin),
        "fell": fell,
    }


def walking_loop(twin: Twin[Any], case: Case, settings: Settings, seed: int) -> Loop[Any]:
    """A controller for the case around a twin that stands already."""
    motion = LOCKSTEP_MOTION.model_copy(
        update={
            "coordination": case.coordination,
            "oscillators": OscillatorSettings(feedback=FEEDBACK, fixed_point_compensation=case.compensation),
        }
    )
    parameters = settings.gait_parameters.model_copy(update={"foot_path": "locus"})
    controller = Controller(twin.robot, parameters, twin.period_ns, motion=motion)
    if case.missing_leg:
        _cut_off(twin, LEGS.index(case.missing_leg))
        controller = _Lame(controller, twin.robot, case.missing_leg)  # type: ignore[assignment]
    if case.loads == "estimated":
        return Loop(twin, controller, FeltLoads(twin, tactile_of_robot(twin.robot.name), seed=seed).step)
    return Loop(twin, controller, TrueLoads(twin).step if case.loads == "true" else None)


def _cut_off(twin: Twin[Any], leg: int) -> None:
    """Takes a foot out of all contacts."""
    for geom, owner in twin.layout.foot_of_geom.items():
        if owner == leg:
            twin.model.geom_contype[geom] = twin.model.geom_conaffinity[geom] = 0


class _Lame:
    """A controller whose one leg stays folded, whatever it is told."""

    def __init__(self, controller: Controller, robot: RobotParameters, leg: str) -> None:
        self._controller = controller
        names, folded = list(robot.servos), robot.posture("crouch")
        self._folded = {names.index(servo): folded[servo] for servo in (f"{leg}_hip", f"{leg}_knee")}
        self.high_level_controller = controller.high_level_controller

    def step(self, *arguments: Any) -> MotionOutput:
        output = self._controller.step(*arguments)
        servos = list(output.servo_positions)
        for number, position in self._folded.items():
            servos[number] = position
        return replace(output, servo_positions=tuple(servos))


def recovery_time(recording: Recording, pushed: float) -> float | None:
    """Time [s] from the push on after which every gait cycle is as those before it; None where that never comes.

    A cycle is described by its deviations of roll and pitch and by how fast it goes sideways and turns.
    """
    cycle = 1.0 / FREQUENCY
    begins = np.arange(START * cycle, float(recording.time[-1]) - cycle, 0.05)
    found = np.array([_describe(recording.part(begin, begin + cycle)) for begin in begins])
    before, after = begins < pushed - cycle, begins >= pushed
    usual = np.median(found[before], axis=0)
    reach = np.abs(found[before] - usual).max(axis=0)
    strange = begins[after][(np.abs(found[after] - usual) > CALM * reach).any(axis=1)]
    if not len(strange):
        return 0.0
    return None if strange[-1] == begins[-1] else float(strange[-1] - pushed)


def _describe(cycle: Recording) -> NDArray[np.float64]:
    roll, pitch, yaw = cycle.roll_pitch_yaw.T
    (dx, dy), seconds = (cycle.position[-1] - cycle.position[0])[:2], cycle.time[-1] - cycle.time[0]
    heading, turn = float(np.unwrap(yaw).mean()), float(np.unwrap(yaw)[-1] - np.unwrap(yaw)[0])
    aside = dy * np.cos(heading) - dx * np.sin(heading)
    return np.array([roll.std(), pitch.std(), aside / seconds, turn / seconds])


def step_scatter(recording: Recording, twin: Twin[Any]) -> dict[str, float | None]:
    """Mean and standard deviation of the steps' lengths [m]: from touch-down to touch-down of the same foot."""
    feet, base, _ = foot_motion(recording, twin.model)
    way = base[-1, :2] - base[0, :2]
    along = feet[:, :, :2] @ (way / max(float(np.linalg.norm(way)), 1e-9))
    steps: list[float] = []
    for leg in range(len(LEGS)):
        swings = recording.phases[:, leg] == 1
        # The place where a foot stands: in the middle of each planned stance, when it is surely down.
        edges = np.flatnonzero(np.diff(swings.astype(np.int8)))
        begins = [(a + b) // 2 for a, b in itertools.pairwise(edges) if not swings[a + 1]]
        steps += np.diff(along[begins, leg]).tolist()
    if len(steps) < 2:
        return {"step_m": None, "step_sd_m": None}
    return {"step_m": float(np.mean(steps)), "step_sd_m": float(np.std(steps))}


def table(cases: Sequence[Case], settings: Settings, robot: RobotParameters, results: list[list[Result]]) -> list[Any]:
    """One row a case."""
    rows = []
    for case, runs in zip(cases, results, strict=True):
        recovered = [one["recovery_s"] for one in runs if one["recovery_s"] is not None]
        rows.append(
            {
                "coordination": case.coordination,
                "loads": case.loads,
                "compensation": case.compensation,
                "missing_leg": case.missing_leg or None,
                "repeats": len(runs),
                "speed_m_s": mean(runs, "speed_m_s"),
                "speed_sd_m_s": spread(runs, "speed_m_s"),
                "roll_sd_deg": mean(runs, "roll_sd_deg"),
                "pitch_sd_deg": mean(runs, "pitch_sd_deg"),
                "step_m": mean(runs, "step_m"),
                "step_sd_m": mean(runs, "step_sd_m"),
                "recovery_s": float(np.mean(recovered)) if recovered else None,
                "recovered": len(recovered),
                "fell": any(one["fell"] for one in runs),
            }
        )
    return rows


EXPERIMENT = Experiment(
    name="coordination",
    title="Who coordinates the legs (C 3.3)",
    help="""The timed trot, coupled oscillators, and Tegotae on true and on estimated loads (C 3.3); a push, a leg lost.

    A fall is a result (`fell`), not a failure.

    \b
    nermo experiment coordination
    nermo experiment coordination --quick --json coordination.json
    """,
    columns=(
        *("coordination", "loads", "compensation", "missing_leg", "speed_m_s", "speed_sd_m_s", "roll_sd_deg"),
        *("pitch_sd_deg", "step_m", "step_sd_m", "recovery_s", "recovered", "repeats", "fell"),
    ),
    cases=cases,
    run=run,
    table=table,
)
