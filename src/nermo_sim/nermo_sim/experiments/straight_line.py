"""The straight-line experiment (N 6.1.3, 6.2.1, A.4): speed and orientation noise by gait, frequency and stride."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from nermo_control.gait.knowledge_base import GaitParameters, gait_speed
from nermo_control.spine.kinematics import SpineKinematics
from nermo_control.spine.stride import StrideExtension
from nermo_control.types import ControlCommand, SpineModes, TrajectoryMode
from nermo_description.parameters import RobotParameters
from nermo_sim.console import print_rows
from nermo_sim.experiments.experiment import Experiment, Facts, Outcome
from nermo_sim.experiments.losses import stride_losses
from nermo_sim.experiments.orientation import mean_cycles, orientation_noise
from nermo_sim.experiments.runs import FALLEN, Job, Result, Settings, mean, spread, standing_loop
from nermo_sim.experiments.springs import spring_deflections
from nermo_sim.loop import constant
from nermo_sim.run_table import Moved, Recording
from nermo_sim.twin import Twin

GAITS = ("trot", "walking_trot", "lateral_walk")
FREQUENCIES = (0.5, 0.67, 0.8)
"""[Hz], N table 6.1."""
STRIDE = 0.06
"""Largest stride length [m] (N table A.7), which N's headline speeds imply."""
NORMALIZED_STRIDES = (0.0, 0.5, 0.8, 1.0)
"""l_n of N table 6.1, for the ideal trot at 0.8 Hz."""
ON_THE_SPOT_DURATION = 15.0
"""Duration of a run without stride, which may never cover the distance [s]."""
THESIS_SPEEDS = {
    ("trot", 0.8, STRIDE, False): 0.086,
    ("trot", 0.8, STRIDE, True): 0.105,
    ("trot", 0.8, 0.0, True): 0.019,
    ("trot", 0.67, STRIDE, False): 0.076,
    ("trot", 0.67, STRIDE, True): 0.082,
    ("lateral_walk", 0.8, STRIDE, False): 0.068,
}
"""Speeds [m/s] of N's twin: "approximately 10 % lower" than 0.096 m/s; 22 % more with spine; the spine alone; at
0.67 Hz the robot's 0.067 and 0.077 m/s, which are 12 and 6 % less than the twin's; the lateral walk's from the 27 %
that the trot is faster.
"""
ON_THE_SPOT = 1e-9
"""A forward velocity of exactly 0 means to stand; the stride of 0 m in table 6.1 means to step on the spot [m/s]."""


@dataclass(frozen=True, slots=True)
class Case:
    """One row of the table. `spine` is stride extension, `offset_compensation` makes up for the hip's roll in it."""

    gait: str
    frequency_hz: float
    stride_m: float
    spine: bool = False
    offset_compensation: bool = False

    @property
    def key(self) -> str:
        """Name of the row."""
        spine = "off" if not self.spine else "with offsets" if self.offset_compensation else "on"
        return f"{self.gait} {self.frequency_hz} Hz, stride {self.stride_m} m, spine {spine}"


def cases(quick: bool = False) -> list[Case]:
    """All rows: gaits x frequencies without and, for the trots, with spine; the strides of the ideal trot.

    The lateral walk never uses the spine (N 6.1.3). With the spine, offset compensation is on, but for one set of rows
    of the ideal trot without it. quick leaves most out.
    """
    frequencies = FREQUENCIES[::2] if quick else FREQUENCIES
    strides = NORMALIZED_STRIDES[:1] if quick else NORMALIZED_STRIDES[:-1]
    rows = [Case(gait, frequency, STRIDE) for gait in GAITS for frequency in frequencies]
    rows += [Case(gait, frequency, STRIDE, True, True) for gait in GAITS[:2] for frequency in frequencies]
    rows += [Case("trot", frequency, STRIDE, True) for frequency in frequencies]
    for stride in (round(share * STRIDE, 4) for share in strides):
        rows += [Case("trot", 0.8, stride, True, True)]
        rows += [Case("trot", 0.8, stride)] if stride else []
    return rows


def theory(case: Case, parameters: GaitParameters, robot: RobotParameters) -> float:
    """No-slip speed [m/s] by (5.21); the spine adds d_ext between its extremes (5.32) to the stride, 0.0157 m."""
    stride = case.stride_m + (spine_stride(robot, parameters) if case.spine else 0.0)
    return gait_speed(case.frequency_hz, stride, parameters.gaits[case.gait].gait_factor)


def spine_stride(robot: RobotParameters, parameters: GaitParameters) -> float:
    """What the spine adds to a stride [m]: d_ext (5.32) of a diagonal at one end of the range less at the other."""
    limit = min(parameters.max_spine_flexion, robot.spine.max_flexion)
    extension = StrideExtension(SpineKinematics(robot.spine), robot.hip_positions, limit)
    return float(extension.distance(0, extension.extension[0]) - extension.distance(0, extension.compression[0]))


def walk(job: Job[Case]) -> tuple[Recording, Twin[Any]]:
    """Walks one run: over the distance, or until the mouse has fallen, or for twice the time it should take."""
    case, settings = job.case, job.settings
    loop, run = standing_loop(job)
    speed = gait_speed(case.frequency_hz, case.stride_m, settings.gait_parameters.gaits[case.gait].gait_factor)
    command = ControlCommand(
        0,
        forward_velocity=max(speed, ON_THE_SPOT),
        trajectory_mode=TrajectoryMode.STRAIGHT_LINE,
        gait=case.gait,
        gait_frequency=case.frequency_hz,
        spine_modes=SpineModes(stride_extension=case.spine, offset_compensation=case.offset_compensation),
    )
    start = loop.twin.odometry()
    forward = (math.cos(start.yaw), math.sin(start.yaw))

    def ended(twin: Twin[Any]) -> bool:
        here = twin.odometry()
        along = (here.x - start.x) * forward[0] + (here.y - start.y) * forward[1]
        return along >= settings.distance or twin.tilt() > FALLEN

    longest = 2.0 * settings.distance / speed if speed else ON_THE_SPOT_DURATION
    return loop.run(constant(command), longest, until=ended, before_tick=run.tick), loop.twin


def measure(moved: Moved, frequency: float) -> Result:
    """Speed along the first heading, drift, and orientation noise without the first gait cycle."""
    position, angles = moved.position, moved.roll_pitch_yaw
    heading = angles[0, 2]
    way = position[-1, :2] - position[0, :2]
    along = way[0] * math.cos(heading) + way[1] * math.sin(heading)
    across = way[1] * math.cos(heading) - way[0] * math.sin(heading)
    duration = float(moved.time[-1])
    return {
        "speed_m_s": float(along) / duration,
        "distance_m": float(along),
        "duration_s": duration,
        "lateral_drift_m": float(across),
        "heading_error_deg": float(np.degrees(angles[-1, 2] - heading)),
        **orientation_noise(moved, frequency),
        "fell": bool(np.abs(angles[:, :2]).max() > FALLEN),
    }


def run(job: Job[Case]) -> Result:
    """Walks and measures one run; the first one of a case also keeps two gait cycles for the figures."""
    recording, twin = walk(job)
    case, parameters = job.case, job.settings.gait_parameters
    result = measure(recording, case.frequency_hz)
    result.update(spring_deflections(recording, twin.model, twin.robot))
    if case.stride_m and not result["fell"]:
        losses = stride_losses(recording, twin.model, twin.robot, case.stride_m, 1.0 / case.frequency_hz)
        result["losses"] = losses.as_speeds(case.frequency_hz * parameters.gaits[case.gait].gait_factor)
        result["early_touch_down"] = losses.early_touch_down
    if job.repeat == 0:
        result["cycles"] = mean_cycles(recording, case.frequency_hz)
    return result


def table(cases: Sequence[Case], settings: Settings, robot: RobotParameters, results: list[list[Result]]) -> list[Any]:
    """One row a case, with the keys of the JSON contract."""
    return [_row(case, settings, robot, runs) for case, runs in zip(cases, results, strict=True)]


def _row(case: Case, settings: Settings, robot: RobotParameters, runs: list[Result]) -> dict[str, Any]:
    of = functools.partial(mean, runs)
    noise = [name for name in runs[0] if name.startswith(("roll_", "pitch_", "yaw_"))]
    springs = [name for name in runs[0] if "_yield_" in name]
    losses = [one["losses"] for one in runs if "losses" in one]
    return {
        **asdict(case),
        "repeats": len(runs),
        "speed_m_s": of("speed_m_s"),
        "speed_sd_m_s": spread(runs, "speed_m_s"),
        "thesis_m_s": THESIS_SPEEDS.get((case.gait, case.frequency_hz, case.stride_m, case.spine)),
        "theory_m_s": theory(case, settings.gait_parameters, robot),
        **{name: of(name) for name in (*noise, *springs)},
        "lateral_drift_m": max((one["lateral_drift_m"] for one in runs), key=abs),
        "heading_error_deg": max((one["heading_error_deg"] for one in runs), key=abs),
        "duration_s": of("duration_s"),
        "fell": any(one["fell"] for one in runs),
        "losses": {name: mean(losses, name) for name in losses[0]} if losses else None,
        "early_touch_down": mean(runs, "early_touch_down") if losses else None,
        "cycles": next((one["cycles"] for one in runs if "cycles" in one), None),
    }


def _pictures(done: Outcome) -> list[Path]:
    """The table's speeds and one trot as pictures, and that trot as a video."""
    from nermo_sim.plots import plot_run, plot_speeds
    from nermo_sim.render import film

    done.folder.mkdir(parents=True, exist_ok=True)
    pictures = [done.folder / "speed.png", done.folder / "trot.png"]
    plot_speeds(done.facts["rows"], pictures[0])
    case = Case("trot", 0.8, STRIDE)
    recording, twin = walk(Job(case, 0, done.settings))
    plot_run(recording, pictures[1], case.key)
    if done.video:
        pictures += film(done.folder / "trot.mp4", twin.model, recording.part(0.0, 10.0))
    return pictures


_SPRINGS = tuple(
    f"{place}_{joint}_yield_{kind}_deg"
    for joint in ("knee", "ankle")
    for place in ("front", "rear")
    for kind in ("mean", "p95")
)
_CASE = ("gait", "frequency_hz", "stride_m", "spine", "offset_compensation")


def _notes(facts: Facts) -> None:
    print_rows("deflection of the springs in loaded stance", facts["rows"], (*_CASE, *_SPRINGS))


def _failure(facts: Facts) -> str | None:
    return "the mouse fell: see the column `fell`" if any(row["fell"] for row in facts["rows"]) else None


EXPERIMENT = Experiment(
    name="straight-line",
    title="Straight line (N 6.2.1)",
    help="""Speed and orientation noise by gait, frequency, stride length and spine (N 6.1.3, 6.2.1).

    A run that was stopped goes on where it was. Exit status 1 if the mouse fell.

    With --target the runs of N's real robot are played on a mouse, one by one, with who stands beside it; with --film,
    then or later, they are measured. The twin's and N's own stand beside.

    \b
    nermo experiment straight-line
    nermo experiment straight-line --quick --json straight.json
    nermo experiment straight-line --robot nermo --seed 7 --out /tmp/nermo
    nermo experiment straight-line --target serial --port /dev/ttyUSB0 --calibration my_robot.yaml --out today
    nermo experiment straight-line --film films --camera camera.yaml --out today --json today.json
    """,
    columns=(
        *(*_CASE, "speed_m_s", "speed_sd_m_s"),
        *("thesis_m_s", "theory_m_s", "roll_sd_deg", "pitch_sd_deg", "yaw_sd_deg", "fell"),
    ),
    cases=cases,
    run=run,
    table=table,
    tail="rigid",
    video="the trot at 0.8 Hz",
    notes=_notes,
    pictures=_pictures,
    failure=_failure,
)
