"""A camera: how it maps the world to its picture, and when it takes which row."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from nermo_description.parameter_files import read_yaml, validate, write_yaml

Array = NDArray[np.float64]

Distortion = Annotated[float, Field(ge=-50.0, le=50.0)]


class Camera(BaseModel):
    """What `camera.yaml` holds: a pinhole with the distortion of Brown and Conrady, as OpenCV has it.

    Camera axes: x right, y down, z along the line of sight. Pixels count from the middle of the upper left one.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    width: int = Field(ge=16, le=16384, json_schema_extra={"unit": "px"})
    height: int = Field(ge=16, le=16384, json_schema_extra={"unit": "px"})
    fx: float = Field(gt=0.0, le=1e6, json_schema_extra={"unit": "px"})
    fy: float = Field(gt=0.0, le=1e6, json_schema_extra={"unit": "px"})
    cx: float = Field(ge=-16384.0, le=32768.0, json_schema_extra={"unit": "px"})
    cy: float = Field(ge=-16384.0, le=32768.0, json_schema_extra={"unit": "px"})
    distortion: tuple[Distortion, Distortion, Distortion, Distortion, Distortion] = (0.0, 0.0, 0.0, 0.0, 0.0)
    """k1, k2, p1, p2, k3."""
    line_delay: float = Field(default=0.0, ge=0.0, le=1e-3, json_schema_extra={"unit": "s"})
    """[s] From one row's exposure to the next one's: of a rolling shutter. 0: all rows at once."""
    exposure: float = Field(default=0.0, ge=0.0, le=1.0, json_schema_extra={"unit": "s"})
    """[s] For which a row is exposed. 0: not known, and taken as short."""
    rms: float | None = Field(default=None, ge=0.0)
    """[px] Root mean square of the calibration's reprojection error; None where it was not calibrated here."""
    views: int | None = Field(default=None, ge=0)
    """Pictures that the calibration took."""
    coverage: float | None = Field(default=None, ge=0.0, le=1.0)
    """Share of the picture in which they showed the board."""

    @property
    def matrix(self) -> Array:
        """(3, 3) The camera matrix."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    @property
    def coefficients(self) -> Array:
        """(5,) The distortion."""
        return np.array(self.distortion)

    def project(self, points: Array) -> tuple[Array, Array]:
        """Pixels (n, 2) of points (n, 3) [m] in camera axes, and how they move with the points (n, 2, 3) [px/m]."""
        zero = np.zeros(3)
        pixels, jacobian = cv2.projectPoints(np.ascontiguousarray(points), zero, zero, self.matrix, self.coefficients)
        slope = np.asarray(jacobian[:, 3:6], dtype=np.float64)
        return np.asarray(pixels, dtype=np.float64).reshape(-1, 2), slope.reshape(-1, 2, 3)

    def rays(self, pixels: Array) -> Array:
        """(n, 3) Directions in camera axes, z = 1, of pixels (n, 2)."""
        # The picture's edge needs more rounds than OpenCV makes unless it is told.
        rounds = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-10)
        points = cv2.undistortPoints(
            np.ascontiguousarray(pixels, dtype=np.float64).reshape(-1, 1, 2),
            self.matrix,
            self.coefficients,
            criteria=rounds,
        )
        return np.column_stack([points.reshape(-1, 2), np.ones(len(pixels))])


def load_camera(path: Path) -> Camera:
    """The camera of a file.

    Raises:
        ParameterError: the file cannot be used.
    """
    return validate(read_yaml(path), path, Camera)


def save_camera(camera: Camera, path: Path) -> None:
    """Write a camera's file, whole or not at all.

    Raises:
        ParameterError: it cannot be written.
    """
    write_yaml(camera.model_dump(mode="json"), path)
