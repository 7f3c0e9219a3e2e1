"""Robot and gait parameters for the tests of the controller."""

from __future__ import annotations

import pytest

from nermo_control.gait.knowledge_base import GaitParameters
from nermo_description.parameters import RobotParameters
from nermo_description.robots import load_robot


@pytest.fixture(scope="session")
def robot() -> RobotParameters:
    """Nermo-Lite, on which N's experiments ran."""
    return load_robot("nermo_lite")


@pytest.fixture(scope="session")
def gait_parameters() -> GaitParameters:
    """N's gait parameters."""
    return GaitParameters()
