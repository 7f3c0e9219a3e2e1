"""Where tags sit: on the mouse, on its feet, and on the floor, whose tags are the world's frame."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, model_validator
from scipy.spatial.transform import Rotation

from nermo_description.markers import MARKERS
from nermo_description.parameter_files import read_yaml, validate

Array = NDArray[np.float64]

STANDARD = Path(__file__).with_name("tags.yaml")
FAMILY, DICTIONARY = "AprilTag 36h11", cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
"""Of the tags that are printed and looked for, and OpenCV's patterns of them; another family is named here alone."""
MODULES: int = DICTIONARY.markerSize + 2
"""Squares along the edge of a tag of this family, its black border included."""
TAGS: int = len(DICTIONARY.bytesList)
"""How many this family has."""

Metre = Annotated[float, Field(ge=-20.0, le=20.0, json_schema_extra={"unit": "m"})]
Degree = Annotated[float, Field(ge=-360.0, le=360.0, json_schema_extra={"unit": "deg"})]


class Tag(BaseModel):
    """One tag in the frame of what it sits on."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    id: int = Field(ge=0, le=TAGS - 1)
    size: float = Field(ge=0.004, le=1.0, json_schema_extra={"unit": "m"})
    """Edge of the black square [m]."""
    position: tuple[Metre, Metre, Metre]
    """Its middle [m]."""
    rpy_deg: tuple[Degree, Degree, Degree] = (0.0, 0.0, 0.0)
    """Roll, pitch and yaw of the tag, about fixed axes [deg]."""

    @property
    def rotation(self) -> Rotation:
        """The tag's axes in that frame."""
        return Rotation.from_euler("xyz", self.rpy_deg, degrees=True)

    @property
    def corners(self) -> Array:
        """(4, 3) [m] Corners of the black square in that frame, as OpenCV names them: upper left first, clockwise."""
        return np.asarray(self.rotation.apply(square(self.size)) + np.array(self.position), dtype=np.float64)


class Layout(BaseModel):
    """All tags."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    mouse: tuple[Tag, ...] = Field(min_length=1)
    """In base_link."""
    floor: tuple[Tag, ...] = Field(min_length=1)
    """In the world."""
    markers: dict[str, Annotated[tuple[Tag, ...], Field(min_length=1)]] = {}
    """Of places that are followed beside base_link, each in the place's own frame (`MARKERS`)."""

    @model_validator(mode="after")
    def _known_places(self) -> Layout:
        unknown = next((place for place in self.markers if place not in MARKERS), None)
        if unknown is not None:
            raise ValueError(f"markers: {unknown} is no place for one; choose of {', '.join(MARKERS)}")
        return self

    @model_validator(mode="after")
    def _one_of_each(self) -> Layout:
        twice = sorted({number for number in self.ids if self.ids.count(number) > 1})
        if twice:
            raise ValueError(f"tag {twice[0]} is there twice; a tag can be in one place only")
        return self

    @cached_property
    def ids(self) -> tuple[int, ...]:
        """Numbers of all tags, the mouse's first."""
        glued = [tag for tags in self.markers.values() for tag in tags]
        return tuple(tag.id for tag in (*self.mouse, *self.floor, *glued))


def square(size: float) -> Array:
    """(4, 3) [m] Corners of a tag of this edge in its own frame, upper left first, clockwise."""
    return 0.5 * size * np.array([[-1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [1.0, -1.0, 0.0], [-1.0, -1.0, 0.0]])


def load_layout(path: Path | None = None) -> Layout:
    """The tags of a file, or of the sheets that we print.

    Raises:
        ParameterError: the file cannot be used.
    """
    file = path or STANDARD
    return validate(read_yaml(file), file, Layout)
