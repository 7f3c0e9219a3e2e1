"""A protocol recorded in process: a folder for each segment, with its scene written into it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from nermo_description.model import build_model
from nermo_description.parameter_files import write_yaml
from nermo_description.stand import Stand
from nermo_gap.protocol.play import Body, play
from nermo_gap.protocol.scene import SCENE_FILE, TABLE_FILE, SceneFile
from nermo_gap.protocol.types import Protocol
from simgap.data.errors import GapInputError


def record(
    protocol: Protocol,
    body: Body,
    out: Path,
    seed: int,
    say: Callable[[str, float], None] = lambda stage, share: None,
    stand: Stand | None = None,
) -> list[Path]:
    """Play a protocol in process and write a folder for each segment; returns the folders, in order.

    Raises:
        GapInputError: ``out`` holds something already, or cannot be written.
        SimulationDivergedError: the mouse's simulation broke down.
    """
    stand, random = stand or Stand(), np.random.default_rng(seed)
    rest = stand.rest(build_model(body.robot))
    if out.exists() and any(out.iterdir()):
        raise GapInputError(f"{out}: holds something already; give a folder that is new or empty")
    folders = []
    for number, segment in enumerate(protocol.segments):
        say(segment.name, number / len(protocol.segments))
        table, _ = play(segment, body, stand, rest, random)
        folder = out / f"{number + 1}_{segment.name}"
        try:
            folder.mkdir(parents=True)
            scene = SceneFile.of(protocol, segment, body.robot.name, stand, rest)
            write_yaml(scene.model_dump(mode="json", exclude_none=True), folder / SCENE_FILE)
            np.savez_compressed(folder / TABLE_FILE, **table)  # type: ignore[arg-type]
        except OSError as error:
            raise GapInputError(f"{folder} cannot be written: {error.strerror}") from error
        folders.append(folder)
    return folders
