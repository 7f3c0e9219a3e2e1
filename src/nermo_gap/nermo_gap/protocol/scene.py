"""The scene that is written beside a recording: where the mouse was, and which pieces it did when."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, ValidationError

from nermo_description.parameter_files import ParameterError, read_yaml
from nermo_gap.protocol.pieces import Protocol, Scene, Segment
from nermo_gap.robots.stand import Stand
from simgap.data.errors import GapInputError
from simgap.data.setup import Setup

Array = NDArray[np.float64]

SCENE_FILE, TABLE_FILE = "scene.yaml", "recording.npz"


class StandRow(BaseModel):
    """The stand of a hung segment; see `Stand`."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    height: float
    stiffness: float
    damping: float
    turning_damping: float
    rest: tuple[float, float, float, float, float, float, float]
    """Pose to which its spring pulls: [m] and quaternion."""

    def setup(self) -> Setup:
        """The stand as runs of a diagnosis have it."""
        return Stand(self.height, self.stiffness, self.damping, self.turning_damping).setup(np.array(self.rest))


class PieceRow(BaseModel):
    """When a piece was done, [s] from the first command of the segment."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str
    begin: float
    end: float
    looks: tuple[float, ...] = ()
    """[s] from its begin; see `Piece`."""


class SceneFile(BaseModel):
    """What `scene.yaml` holds."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    protocol: str
    segment: str
    robot: str
    scene: Scene
    stand: StandRow | None = None
    pieces: tuple[PieceRow, ...]

    @classmethod
    def of(cls, protocol: Protocol, segment: Segment, robot: str, stand: Stand, rest: Array) -> SceneFile:
        """Of a segment that is about to be recorded."""
        spans = segment.spans()
        pieces = tuple(
            PieceRow(name=p.name, begin=spans[p.name][0], end=spans[p.name][1], looks=p.looks) for p in segment.pieces
        )
        row = None
        if segment.scene == "hung":
            row = StandRow(
                height=stand.height,
                stiffness=stand.stiffness,
                damping=stand.damping,
                turning_damping=stand.turning_damping,
                rest=tuple(map(float, rest)),  # type: ignore[arg-type]
            )
        return cls(
            protocol=protocol.name,
            segment=segment.name,
            robot=robot,
            scene=segment.scene,
            stand=row,
            pieces=pieces,
        )

    def pieces_at(self, time: Array) -> Array:
        """(n,) Number of the piece at each time [s] from the segment's first command; NaN between pieces."""
        found = np.full(len(time), np.nan)
        for number, piece in enumerate(self.pieces):
            found[(time >= piece.begin - 1e-9) & (time < piece.end - 1e-9)] = number
        return found


def segments(path: Path) -> list[Path]:
    """The segments' folders within a protocol's folder, or ``path`` itself where it is anything else."""
    found = sorted(p.parent for p in path.glob(f"*/{SCENE_FILE}")) if path.is_dir() else []
    return found or [path]


def scene_of(path: Path) -> SceneFile | None:
    """The scene that is written into a recording's folder, or None where there is none.

    Raises:
        GapInputError: it cannot be read.
    """
    file = path / SCENE_FILE
    if not path.is_dir() or not file.is_file():
        return None
    try:
        return SceneFile.model_validate(read_yaml(file))
    except ParameterError as error:
        raise GapInputError(str(error)) from error
    except ValidationError as error:
        fault = error.errors()[0]
        place = ".".join(map(str, fault["loc"])) or "its content"
        raise GapInputError(f"{file}: {place}: {fault['msg']}") from error
