"""The scene that is written beside a recording: where the mouse was, and which pieces it did when."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from nermo_description.parameter_files import ParameterError, read_yaml
from nermo_description.stand import Stand
from nermo_gap.protocol.conduct import Played
from nermo_gap.protocol.types import Protocol, Scene, Segment
from simgap.data.errors import GapInputError
from simgap.data.setup import Setup

Array = NDArray[np.float64]

SCENE_FILE, TABLE_FILE, BAG_FOLDER = "scene.yaml", "recording.npz", "recording"
MUCH_SKIPPED = 0.02
"""Share of its time that an emulated device may leave out before it is said: its speeds are off by about as much."""


def setup_of(stand: Stand, rest: Array) -> Setup:
    """A stand as runs of a diagnosis have it; ``rest`` (7,) is its spring's."""
    return Setup("hung in the stand", (lambda model: stand.enter(model, rest),))


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
        stand = Stand(self.height, self.stiffness, self.damping, self.turning_damping)
        return setup_of(stand, np.array(self.rest))


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
    begun: int | None = None
    """[ns] Stamp of the first command, of a recording of the graph; other tables count from it themselves."""
    skipped: float | None = Field(None, ge=0.0, allow_inf_nan=False)
    """[s] that an emulated device left out meanwhile because its machine was too slow."""
    pieces: tuple[PieceRow, ...]

    @classmethod
    def of(
        cls,
        protocol: Protocol,
        segment: Segment,
        robot: str,
        stand: Stand,
        rest: Array,
        played: Sequence[Played] | None = None,
        skipped: float = 0.0,
    ) -> SceneFile:
        """Of a segment: all of its pieces one after the other, or those that were ``played``, when they were."""
        begun = None if played is None else played[0].begin
        if played is None:
            spans = [(piece, *segment.spans()[piece.name]) for piece in segment.pieces]
        else:
            spans = [(p.piece, (p.begin - played[0].begin) * 1e-9, (p.end - played[0].begin) * 1e-9) for p in played]
        pieces = tuple(PieceRow(name=p.name, begin=begin, end=end, looks=p.looks) for p, begin, end in spans)
        row = None
        if segment.scene == "hung":
            row = StandRow(
                height=stand.height,
                stiffness=stand.stiffness,
                damping=stand.damping,
                turning_damping=stand.turning_damping,
                rest=tuple(map(float, rest)),
            )
        return cls(
            protocol=protocol.name,
            segment=segment.name,
            robot=robot,
            scene=segment.scene,
            stand=row,
            begun=begun,
            skipped=skipped or None,
            pieces=pieces,
        )

    @property
    def slow_motion(self) -> str:
        """What to say of an emulated mouse that moved in slow motion; nothing of any other."""
        lasted = self.pieces[-1].end if self.pieces else 0.0
        if (self.skipped or 0.0) <= MUCH_SKIPPED * lasted:
            return ""
        return (
            f"this machine was too slow for the emulated device, which left out {self.skipped:.1f} of {lasted:.1f} s: "
            "the mouse moved in slow motion, and its speeds are no measurement (--target sim waits instead)"
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
