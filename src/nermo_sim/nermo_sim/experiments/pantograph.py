"""Walks of a robot with pantograph legs, for the experiments of C chapter 3."""

from __future__ import annotations

import copy
import functools
from typing import Any

import mujoco

from nermo_control.oscillators.legs import OscillatorSettings
from nermo_control.pantograph_controller import LocusShape, PantographController, PantographGait
from nermo_control.types import ControlCommand, Posture
from nermo_description.model import build_model
from nermo_description.pantograph import PantographParameters
from nermo_description.robots import load_of_family
from nermo_sim.experiments.runs import Job
from nermo_sim.loads import TrueLoads
from nermo_sim.loop import Loop, constant
from nermo_sim.twin import Twin

FREQUENCY = 2.86
"""Of the trot [Hz]."""
STEP_LENGTH = 0.126
"""L of C 3.2.5 [m]."""
STEADY_FREQUENCY = 3.17217
"""Of the trot with a steady limit cycle [Hz]."""
STEADY = PantographGait(
    front=LocusShape(
        height=0.109111,
        step_height=0.026366,
        offset=-0.006826,
        compression=0.726491,
        touch_down_angle=1.933726,
        take_off_angle=1.078138,
    ),
    rear=LocusShape(
        height=0.113295,
        step_height=0.023369,
        offset=-0.016477,
        compression=0.73371,
        touch_down_angle=1.856727,
        take_off_angle=1.458488,
    ),
    duty_factor=0.571744,
)
"""Found for L = 12.6 cm by `nermo optimize --cost limit-cycle --generations 10`, seed 0."""
FEEDBACK = 3.0
"""sigma of Tegotae for a load of one body weight [rad/s]: with 1 the legs do not hold together, and the robot falls."""
TOUCHING = 0.5
"""Force from which a foot counts as set down [N]."""
STAND = 0.3
"""Before the walk [s]."""


@functools.lru_cache(maxsize=2)
def compiled(robot: str) -> tuple[PantographParameters, mujoco.MjModel]:
    """A robot with pantograph legs and its model on level ground, built once a process."""
    parameters = load_of_family(PantographParameters, robot)
    return parameters, build_model(parameters)


def standing_pantograph(job: Job[Any], gait: PantographGait) -> Loop[PantographController]:
    """The robot on its feet; a gait of the kind `tegotae` is told the true loads."""
    robot, model = compiled(job.settings.robot)
    twin = Twin(robot, model=copy.copy(model))
    controller = PantographController(robot, gait, twin.period_ns)
    loop = Loop(twin, controller, TrueLoads(twin).step)
    loop.run(constant(ControlCommand(0, posture=Posture.STAND)), STAND, record=False)
    return loop


def steady_gait(kind: str) -> PantographGait:
    """STEADY, coordinated by `cpg` or `tegotae`."""
    oscillators = OscillatorSettings(feedback=FEEDBACK, fixed_point_compensation=False)
    return STEADY.model_copy(update={"kind": kind, "oscillators": oscillators})


def trot(gait: PantographGait, length: float, frequency: float) -> ControlCommand:
    """The command for a step length [m] and an excitation [Hz]; 0 Hz is standing."""
    if frequency <= 0.0:
        return ControlCommand(0, posture=Posture.STAND)
    velocity = length * frequency / gait.duty_factor
    return ControlCommand(0, forward_velocity=velocity, gait="trot", gait_frequency=frequency)
