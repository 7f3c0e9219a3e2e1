"""The parameter that every node of the controller has: which robot it is."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field

from nermo_description.parameters import RobotParameters
from nermo_description.robots import load_robot
from nermo_node.parameters import blame


class RobotChoice(BaseModel):
    """Part of a node's parameters."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    robot: str = Field(
        "nermo_lite",
        description="Name of a robot, or path of its parameter file",
        json_schema_extra={"readOnly": True},
    )

    def load(self) -> RobotParameters:
        """The robot's parameters. Raises ParameterError."""
        with blame("robot"):
            return load_robot(self.robot)
