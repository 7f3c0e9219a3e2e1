"""Both robots and their models."""

from __future__ import annotations

import mujoco
import pytest

from nermo_description.model import build_model
from nermo_description.parameters import RobotParameters
from nermo_description.robots import load_robot, robot_names


@pytest.fixture(scope="session", params=robot_names())
def robot(request: pytest.FixtureRequest) -> RobotParameters:
    return load_robot(request.param)


@pytest.fixture(scope="session")
def models() -> dict[str, mujoco.MjModel]:
    return {name: build_model(load_robot(name)) for name in robot_names()}


@pytest.fixture
def model(robot: RobotParameters, models: dict[str, mujoco.MjModel]) -> mujoco.MjModel:
    return models[robot.name]


@pytest.fixture
def data(model: mujoco.MjModel) -> mujoco.MjData:
    """Standing."""
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("stand").id)
    return data
