"""Where a corrected model came from: `corrects` of a map, as `simgap apply --map` writes it."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np

from simgap.data.errors import GapInputError
from simgap.data.mapping import Map, load_map
from simgap.data.plant import Plant, build_plant, load_spec
from simgap.data.recording import Recording


def origin(model: Path, map_: Path) -> tuple[Path, Path]:
    """The model and the map that diagnoses began with, where these may be corrected themselves, once or several times.

    Raises:
        GapInputError: a map names files that are not there, or itself.
    """
    seen: list[Path] = []
    while (row := load_map(map_).corrects) is not None:
        seen.append(map_.resolve())
        model, map_ = map_.parent / row.model, map_.parent / row.map
        for key, path in (("model", model), ("map", map_)):
            if not path.is_file():
                raise GapInputError(
                    f"{seen[-1]}: corrects.{key}: no such file as {path}; bring it back, or take `corrects` out of the "
                    "map, to diagnose the corrected model as one of its own"
                )
        if map_.resolve() in seen:
            raise GapInputError(f"{seen[-1]}: corrects.map: {map_} corrects itself")
    return model, map_


def original(mapping: Map) -> Plant | None:
    """The plant of the model that a map's model corrects; None where it corrects none.

    Raises:
        GapInputError: the files that the map names are not there, or are no model and map.
    """
    if mapping.corrects is None:
        return None
    folder = Path(mapping.source).parent
    model, map_ = origin(folder / mapping.corrects.model, Path(mapping.source))
    return build_plant(load_spec(model), load_map(map_))


def as_read_by(plant: Plant, recording: Recording, own: Plant) -> Recording:
    """A recording that was read by the map of ``own`` as that of ``plant`` reads it, of which only motors differ."""
    scale = np.array([b.scale / a.scale for a, b in zip(own.inputs, plant.inputs, strict=True)])
    return replace(recording, inputs=recording.inputs * scale)


def from_folder(path: Path, folder: Path) -> str:
    """A file as a map in ``folder`` names it."""
    return Path(os.path.relpath(path.resolve(), folder.resolve())).as_posix()
