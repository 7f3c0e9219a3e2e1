"""Walks of a robot with pantograph legs, for the experiments of C chapter 3."""

from __future__ import annotations

import copy
import functools
from typing import Any

import mujoco

from nermo_control.oscillators.legs import OscillatorSettings
from nermo_control.pantograph_controller import PantographController, PantographGait
from nermo_control.types import ControlCommand, Posture
from nermo_description.model import build_model
from nermo_description.pantograph import PantographParameters
from nermo_description.robots import load_any_robot
from nermo_sim.experiments.runs import Job
from nermo_sim.loads import TrueLoads
from nermo_sim.loop import Loop, constant
from nermo_sim.twin import Twin

FREQUENCY = 2.86
"""Of the trot [Hz]."""
STEP_LENGTH = 0.126
"""L of C 3.2.5 [m]."""
FEEDBACK = 1.0
"""sigma of Tegotae for a load of one body weight [rad/s]: with more the legs leave the trot within seconds."""
TOUCHING = 0.5
"""Force from which a foot counts as set down [N]."""
STAND = 0.3
"""Before the walk [s]."""


def has_pantograph_legs(robot: str) -> bool:
    """Whether a robot, by name or file, has pantograph legs. Raises ParameterError."""
    return isinstance(load_any_robot(robot), PantographParameters)


@functools.lru_cache(maxsize=2)
def _compiled(robot: str) -> tuple[PantographParameters, mujoco.MjModel]:
    parameters = load_any_robot(robot)
    assert isinstance(parameters, PantographParameters)
    return parameters, build_model(parameters)


def standing_pantograph(job: Job[Any], gait: PantographGait) -> Loop[PantographController]:
    """The robot on its feet; a gait of the kind `tegotae` is told the true loads."""
    robot, model = _compiled(job.settings.robot)
    twin = Twin(robot, model=copy.copy(model))
    controller = PantographController(robot, gait, twin.period_ns)
    loop = Loop(twin, controller, TrueLoads(twin).step)
    loop.run(constant(ControlCommand(0, posture=Posture.STAND)), STAND, record=False)
    return loop


def gait_of_kind(kind: str) -> PantographGait:
    """The controller's own gait, coordinated by `cpg` or `tegotae`."""
    oscillators = OscillatorSettings(feedback=FEEDBACK, fixed_point_compensation=False)
    return PantographGait(kind=kind, oscillators=oscillators)


def trot(length: float, frequency: float) -> ControlCommand:
    """The command for a step length [m] and an excitation [Hz]; 0 Hz is standing."""
    if frequency <= 0.0:
        return ControlCommand(0, posture=Posture.STAND)
    duty = PantographGait().duty_factor
    return ControlCommand(0, forward_velocity=length * frequency / duty, gait="trot", gait_frequency=frequency)
