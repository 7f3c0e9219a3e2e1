"""The robot that is simulated, built once."""

from __future__ import annotations

import copy

import mujoco
import pytest

from nermo_control.gait.knowledge_base import GaitParameters
from nermo_description.model import build_model
from nermo_description.parameters import RobotParameters
from nermo_description.robots import load_robot
from nermo_sim.loop import Loop
from nermo_sim.twin import Twin


@pytest.fixture(scope="session")
def robot() -> RobotParameters:
    return load_robot("nermo_lite")


@pytest.fixture(scope="session")
def compiled(robot: RobotParameters) -> mujoco.MjModel:
    return build_model(robot)


@pytest.fixture
def twin(robot: RobotParameters, compiled: mujoco.MjModel, tmp_path) -> Twin:
    return Twin(robot, model=copy.deepcopy(compiled), dump_folder=tmp_path / "dump")


@pytest.fixture
def loop(robot: RobotParameters) -> Loop:
    return Loop.build(robot, GaitParameters())
