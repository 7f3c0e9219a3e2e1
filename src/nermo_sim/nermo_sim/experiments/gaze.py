"""Gaze: how much the head's cameras swing with the gait, with and without the neck against it (proposed in N 7.1.2)."""

from __future__ import annotations

import functools
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, get_args

import mujoco
import numpy as np
from numpy.typing import NDArray

from nermo_control.controller import LOCKSTEP_MOTION
from nermo_control.head import GazeMode
from nermo_control.types import ControlCommand, SpineModes, TrajectoryMode
from nermo_description.parameters import RobotParameters
from nermo_sim.divergence import STATE
from nermo_sim.experiments.experiment import Experiment
from nermo_sim.experiments.runs import FALLEN, Job, Result, Settings, full_speed, mean, spread, standing_loop
from nermo_sim.loop import constant
from nermo_sim.run_table import Recording

GAIT, FREQUENCY = "trot", 0.8
"""With stride extension and offset compensation: where the spine swings the head most."""
DURATION, QUICK_DURATION = 15.0, 5.0
"""[s]"""
CAMERA = "head_left"
_LATERAL = re.compile(r"spine_lateral_\d+_joint")
MODES: tuple[GazeMode, ...] = get_args(GazeMode)

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Case:
    """One row of the table."""

    gaze: GazeMode

    @property
    def key(self) -> str:
        """Name of the row."""
        return f"{GAIT} {FREQUENCY} Hz, gaze {self.gaze}"


def cases(quick: bool = False) -> list[Case]:
    """Each mode of the neck."""
    return [Case(mode) for mode in MODES]


def run(job: Job[Case]) -> Result:
    """Walks straight on and looks at the head."""
    settings = job.settings
    loop, disturbed = standing_loop(job)
    motion = loop.controller.motion_module
    motion.set_config(LOCKSTEP_MOTION.model_copy(update={"gaze": job.case.gaze}))
    command = ControlCommand(
        0,
        forward_velocity=full_speed(settings, GAIT, FREQUENCY),
        trajectory_mode=TrajectoryMode.STRAIGHT_LINE,
        gait=GAIT,
        gait_frequency=FREQUENCY,
        spine_modes=SpineModes(stride_extension=True, offset_compensation=True),
    )
    duration = QUICK_DURATION if settings.quick else DURATION
    recording = loop.run(
        constant(command), duration, until=lambda twin: twin.tilt() > FALLEN, before_tick=disturbed.tick
    )
    return {**measure(recording, loop.twin.model), "fell": loop.twin.tilt() > FALLEN}


def measure(recording: Recording, model: mujoco.MjModel) -> Result:
    """Deviation of yaw and pitch of the head and of base_link, and the spine's part in it, without the first cycles.

    `front_share` is the slope of base_link's yaw over the angle of the whole spine: how much of the spine's bend turns
    the front torso.
    """
    recording = recording.part(2.0 / FREQUENCY, float(recording.time[-1]))
    data = mujoco.MjData(model)
    head = int(model.cam_bodyid[model.camera(CAMERA).id])
    joints = (model.joint(number) for number in range(model.njnt))
    bends = [joint.qposadr[0] for joint in joints if _LATERAL.fullmatch(joint.name)]
    axes, bend = np.zeros((len(recording.stamps), 3, 3)), np.zeros(len(recording.stamps))
    for row, state in enumerate(recording.states):
        mujoco.mj_setState(model, data, state, STATE)
        mujoco.mj_kinematics(model, data)
        axes[row] = data.xmat[head].reshape(3, 3)
        bend[row] = data.qpos[bends].sum()
    head_yaw = np.unwrap(np.arctan2(axes[:, 1, 0], axes[:, 0, 0]))
    head_pitch = np.arcsin(np.clip(-axes[:, 2, 0], -1.0, 1.0))
    base_pitch, base_yaw = recording.roll_pitch_yaw[:, 1], np.unwrap(recording.roll_pitch_yaw[:, 2])
    return {
        "head_yaw_sd_deg": _deviation(head_yaw),
        "head_pitch_sd_deg": _deviation(head_pitch),
        "head_pitch_mean_deg": float(np.degrees(head_pitch.mean())),
        "body_yaw_sd_deg": _deviation(base_yaw),
        "body_pitch_sd_deg": _deviation(base_pitch),
        "front_share": abs(float(np.polyfit(bend, base_yaw, 1)[0])),
    }


def _deviation(angle: Array) -> float:
    return float(np.degrees(angle.std()))


def table(cases: Sequence[Case], settings: Settings, robot: RobotParameters, results: list[list[Result]]) -> list[Any]:
    """One row a mode."""
    rows = []
    for case, runs in zip(cases, results, strict=True):
        of = functools.partial(mean, runs)
        measured = [name for name in runs[0] if name != "fell"]
        rows.append(
            {
                "robot": robot.name,
                "gaze": case.gaze,
                "repeats": len(runs),
                **{name: of(name) for name in measured},
                "head_yaw_sd_spread_deg": spread(runs, "head_yaw_sd_deg"),
                "fell": any(one["fell"] for one in runs),
            }
        )
    return rows


EXPERIMENT = Experiment(
    name="gaze",
    title="Gaze: the neck against the gait's swing (N 7.1.2)",
    help="""How much the head's cameras swing in a trot with the spine, with and without the neck against it (N 7.1.2).

    \b
    nermo experiment gaze
    nermo experiment gaze --robot nermo --json gaze.json
    """,
    columns=(
        *("robot", "gaze", "head_yaw_sd_deg", "head_pitch_sd_deg", "head_pitch_mean_deg", "body_yaw_sd_deg"),
        *("body_pitch_sd_deg", "front_share", "fell"),
    ),
    cases=cases,
    run=run,
    table=table,
)
