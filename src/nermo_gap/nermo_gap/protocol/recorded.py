"""Recordings read back: tables whose runs are the pieces of the protocol, what each hung in, and where to look."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nermo_description.parameters import RobotParameters
from nermo_gap.protocol.scene import BAG_FOLDER, TABLE_FILE, SceneFile, StandRow
from nermo_gap.robots.mcap_table import mcap_table
from simgap.data.recording import load_table
from simgap.data.setup import Setup

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Recorded:
    """Some recordings of one mouse.

    Attributes:
        tables: their columns; runs are numbered through from one to the next.
        stands: what each hung in; None on the floor.
        looks: {run: [s] from its beginning} where a diagnosis looks; empty unless all are of protocols that say so.
    """

    tables: list[dict[str, Array]]
    stands: list[Setup | None]
    looks: dict[float, tuple[float, ...]]


def is_mcap(path: Path) -> bool:
    """Whether a recording is an MCAP (a file, or the folder of a bag) rather than a table."""
    return path.suffix.lower() == ".mcap" or path.is_dir()


def read(paths: Sequence[Path], scenes: Sequence[SceneFile | None], robot: RobotParameters) -> Recorded:
    """Read recordings with their scenes, None for one that is of no protocol.

    Raises:
        GapInputError: a recording cannot be read.
    """
    tables, first = [], 0
    looks: dict[float, tuple[float, ...]] = {}
    stands: dict[StandRow, Setup] = {}
    hung: list[Setup | None] = []
    for path, scene in zip(paths, scenes, strict=True):
        table = _table(path, scene, robot)
        row = None if scene is None else scene.stand
        hung.append(None if row is None else stands.setdefault(row, row.setup()))
        if scene is not None:
            table["run"] += first
            looks |= {float(first + i): piece.looks for i, piece in enumerate(scene.pieces)}
            first += len(scene.pieces)
        tables.append(table)
    return Recorded(tables, hung, looks if _all_say(scenes) else {})


def _all_say(scenes: Sequence[SceneFile | None]) -> bool:
    """Whether all are of protocols, each of which says in some piece where to look."""
    says: dict[str, bool] = {}
    for scene in scenes:
        if scene is None:
            return False
        says[scene.protocol] = says.get(scene.protocol, False) or any(piece.looks for piece in scene.pieces)
    return all(says.values())


def _table(path: Path, scene: SceneFile | None, robot: RobotParameters) -> dict[str, Array]:
    """A recording's columns; of a protocol's segment, with the number of the piece as its run."""
    parts = (path / TABLE_FILE, *([] if scene is None else [path / BAG_FOLDER]))
    file = next((part for part in parts if part.exists()), path)
    begun = None if scene is None else scene.begun
    table = mcap_table(file, robot, begun) if is_mcap(file) else load_table(file)
    if scene is not None:
        run = scene.pieces_at(table["t"])
        table = {name: values[np.isfinite(run)] for name, values in table.items()}
        table["run"] = run[np.isfinite(run)]
    return table
