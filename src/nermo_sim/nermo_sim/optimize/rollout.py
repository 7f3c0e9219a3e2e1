"""One rollout: a straight walk of the disturbed twin with a set of gait parameters, and what it was worth."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field
from typing import Any

import mujoco
import numpy as np

from nermo_control.controller import Controller
from nermo_control.gait.knowledge_base import GaitParameters
from nermo_control.types import ControlCommand, Posture, SpineModes, TrajectoryMode
from nermo_description.parameters import RobotParameters
from nermo_description.robots import load_robot
from nermo_sim.disturbance import Disturbance, DisturbedRun
from nermo_sim.divergence import SimulationDivergedError
from nermo_sim.experiments.orientation import orientation_noise
from nermo_sim.experiments.result_log import fingerprint
from nermo_sim.experiments.runs import FALLEN, SETTLE
from nermo_sim.loop import Loop, constant
from nermo_sim.models import compiled
from nermo_sim.run_table import Recording
from nermo_sim.twin import Twin

GRAVITY = 9.81
"""[m/s^2]"""
Metrics = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Walk:
    """What all rollouts of a search have in common."""

    robot: str = "nermo_lite"
    gait: str = "trot"
    frequency_hz: float = 0.8
    spine: bool = True
    """Stride extension with offset compensation."""
    cycles: int = 6
    """Gait cycles that are walked; the first one is not judged."""
    disturbance: Disturbance = field(default_factory=Disturbance)

    @property
    def mouse(self) -> RobotParameters:
        """The robot, with the rigid tail that costs least. Raises ParameterError."""
        return load_robot(self.robot).with_tail("rigid")

    def digest(self) -> str:
        """Digest of all that a rollout depends on, but for its parameters and its trial."""
        return fingerprint({**asdict(self), "robot": self.mouse.model_dump(mode="json"), "mujoco": mujoco.__version__})


@dataclass(frozen=True, slots=True)
class Trial:
    """Under what a set of parameters is tried."""

    seed: int
    """Of pushes, first pose and the deviation of the ground's friction."""
    ground: float = 1.0
    """Friction of the ground over the robot file's."""


@dataclass(frozen=True, slots=True)
class Rollout:
    """One job: plain, picklable data."""

    walk: Walk
    parameters: GaitParameters
    trial: Trial

    @property
    def key(self) -> str:
        """Name of the rollout, by its content."""
        return fingerprint([self.parameters.model_dump(mode="json"), asdict(self.trial)])[:24]


def run(rollout: Rollout) -> Metrics:
    """Walks; a fall or a simulation that runs away is a result."""
    walk = rollout.walk
    robot = walk.mouse
    twin = Twin(robot, model=compiled(robot))
    loop = Loop(twin, Controller(robot, rollout.parameters, twin.period_ns))
    kind = Disturbance(**{**asdict(walk.disturbance), "ground": rollout.trial.ground})
    disturbed = DisturbedRun(twin, kind, rollout.trial.seed)
    try:
        disturbed.begin()
        loop.run(constant(ControlCommand(0, posture=Posture.STAND)), SETTLE, record=False)
        yaw = twin.odometry().yaw
        recording = loop.run(
            constant(_command(walk, rollout.parameters)),
            walk.cycles / walk.frequency_hz,
            until=lambda twin: twin.tilt() > FALLEN,
            before_tick=disturbed.tick,
        )
    except SimulationDivergedError:
        return FAILED
    if twin.tilt() > FALLEN:
        return FAILED
    return measure(recording, walk.frequency_hz, yaw, robot.masses.total)


def measure(recording: Recording, frequency: float, heading: float, mass: float) -> Metrics:
    """Speed [m/s] along a heading [rad], deviations [deg] and cost of transport, all without the first cycle.

    The cost of transport is the positive mechanical work of all servos over weight times way: servos do not give work
    back. What they draw to hold a posture is not in it.
    """
    noise = orientation_noise(recording, frequency)
    steady = recording.part(1.0 / frequency, float(recording.time[-1]))
    duration = float(steady.time[-1] - steady.time[0])
    way = steady.position[-1, :2] - steady.position[0, :2]
    along = float(way[0] * math.cos(heading) + way[1] * math.sin(heading))
    power = np.maximum(steady.servo_torques * steady.servo_velocities, 0.0).sum(axis=1)
    work = float(power.mean()) * duration
    return {
        "speed_m_s": along / duration,
        "roll_sd_deg": noise["roll_sd_deg"],
        "pitch_sd_deg": noise["pitch_sd_deg"],
        "cost_of_transport": work / (mass * GRAVITY * max(along, 1e-3)),
        "fell": False,
    }


FAILED: Metrics = {"speed_m_s": 0.0, "roll_sd_deg": 90.0, "pitch_sd_deg": 90.0, "cost_of_transport": 1e3, "fell": True}
"""What a mouse that fell is worth."""


def _command(walk: Walk, parameters: GaitParameters) -> ControlCommand:
    return ControlCommand(
        0,
        forward_velocity=parameters.fastest(walk.gait, walk.frequency_hz),
        trajectory_mode=TrajectoryMode.STRAIGHT_LINE,
        gait=walk.gait,
        gait_frequency=walk.frequency_hz,
        spine_modes=SpineModes(stride_extension=walk.spine, offset_compensation=walk.spine),
    )
