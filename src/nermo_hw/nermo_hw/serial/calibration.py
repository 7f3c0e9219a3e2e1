"""From the angles that servos and encoders report to joint angles and back: zero positions and directions."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from nermo_description.parameter_files import ParameterError, read_yaml, validate, write_yaml
from nermo_description.parameters import LEGS, Parameters, RobotParameters

Array = NDArray[np.float64]


class Mounting(Parameters):
    """How one servo or encoder sits in the robot: angle = direction x (reported - zero)."""

    zero: Annotated[float, Field(ge=-3.2, le=3.2, json_schema_extra={"unit": "rad"})] = 0.0
    """What it reports where the angle is 0 [rad]."""
    direction: Literal[1, -1] = 1


class Calibration(Parameters):
    """What `nermo hw calibrate` finds. A servo or encoder that is not named sits as drawn: zero 0, direction 1."""

    robot: str
    servos: dict[str, Mounting] = Field(default_factory=dict)
    knee_encoders: dict[str, Mounting] = Field(default_factory=dict)
    """By leg."""

    @model_validator(mode="after")
    def _known(self) -> Calibration:
        for leg in self.knee_encoders:
            if leg not in LEGS:
                raise ValueError(f"knee_encoders: unknown leg {leg}; possible are {', '.join(LEGS)}")
        return self


def load_calibration(path: Path, robot: RobotParameters) -> Calibration:
    """Reads a calibration file. Raises ParameterError, also where it belongs to another robot."""
    calibration = validate(read_yaml(path), path, Calibration)
    check_calibration(calibration, robot, str(path))
    return calibration


def save_calibration(calibration: Calibration, path: Path) -> None:
    """Writes a calibration file, whole or not at all. Raises ParameterError."""
    write_yaml(calibration.model_dump(), path)


def check_calibration(calibration: Calibration, robot: RobotParameters, source: str) -> None:
    """Raises ParameterError where a calibration does not fit a robot."""
    if calibration.robot != robot.name:
        raise ParameterError(f"{source}: robot: is {calibration.robot!r}; this robot is {robot.name!r}")
    if unknown := [name for name in calibration.servos if name not in robot.servos]:
        raise ParameterError(f"{source}: servos: unknown {', '.join(unknown)}; the robot has {', '.join(robot.servos)}")


class Mountings:
    """A calibration as arrays, in the order of `names`."""

    def __init__(self, names: tuple[str, ...], mountings: dict[str, Mounting]) -> None:
        rows = [mountings.get(name, Mounting()) for name in names]
        self.zero: Array = np.array([row.zero for row in rows])
        self.direction: Array = np.array([float(row.direction) for row in rows])

    def angles(self, reported: Array) -> Array:
        """Joint angles [rad]."""
        return self.direction * (reported - self.zero)

    def velocities(self, reported: Array) -> Array:
        """Joint velocities [rad/s]."""
        return self.direction * reported

    def reported(self, angles: Array) -> Array:
        """What a servo must be told or will report for joint angles [rad]."""
        return self.direction * angles + self.zero
