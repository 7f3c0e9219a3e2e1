"""Models of robots, built once a process: runs in a row differ in their disturbances, seldom in the robot."""

from __future__ import annotations

import copy
import functools

import mujoco

from nermo_description.model import build_model
from nermo_description.parameters import RobotParameters


def compiled(robot: RobotParameters, scene: str = "flat") -> mujoco.MjModel:
    """A copy of the mouse's model, which the caller may change."""
    return copy.copy(_compiled(robot.model_dump_json(), scene))


@functools.lru_cache(maxsize=4)
def _compiled(robot: str, scene: str) -> mujoco.MjModel:
    return build_model(RobotParameters.model_validate_json(robot), scene)
