"""What a protocol could show of a mouse with given sensors, before anybody builds or buys any: nothing is diagnosed."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np

from nermo_description.model import build_model
from nermo_description.parameters import RobotParameters
from nermo_description.stand import Stand
from nermo_gap.protocol.looks import looker
from nermo_gap.protocol.play import Body, play
from nermo_gap.protocol.scene import setup_of
from nermo_gap.protocol.types import Protocol
from nermo_gap.robots.channels import Channels, resolution
from nermo_gap.robots.diagnosis import options_for, placed, robot_plant, warm_up_of
from simgap.data.align import align
from simgap.data.errors import GapInputError
from simgap.data.noise_floor import noise_floor
from simgap.data.recording import concatenate
from simgap.preparation.detectability import Detectable, detectability

SENSORS = tuple(field.name for field in dataclasses.fields(Channels))


@dataclass(frozen=True)
class Shown:
    """An effect at a site, and the piece of the protocol that shows it most."""

    found: Detectable
    piece: str

    def report(self) -> dict[str, Any]:
        """As JSON."""
        return {**self.found.report(), "piece": self.piece}


def channels_of(sensors: str, robot: RobotParameters) -> Channels:
    """Kinds of sensors by their names, with commas between; what the robot has where empty.

    Raises:
        GapInputError: a name that is none.
    """
    if not sensors:
        return Channels.of(robot)
    names = [name.strip() for name in sensors.split(",")]
    for name in names:
        if name not in SENSORS:
            raise GapInputError(f"--sensors: {name!r} is unknown: choose from {', '.join(SENSORS)}")
    return Channels(**{name: name in names for name in SENSORS})


def detectable(robot: RobotParameters, protocol: Protocol, channels: Channels, seed: int = 0) -> list[Shown]:
    """What the protocol shows of the twin, by effect and site, smallest sizes first as the library lists them.

    Raises:
        GapInputError: the protocol is too short.
        SimulationDivergedError: the twin broke down.
    """
    stand, body, random = Stand(), Body.twin(robot, channels.markers), np.random.default_rng(seed)
    rest = stand.rest(build_model(robot))
    hung, tables = setup_of(stand, rest), []
    looks: dict[float, tuple[float, ...]] = {}
    pieces: list[tuple[str, float, float]] = []
    for segment in protocol.segments:
        table, _ = play(segment, body, stand, rest, random)
        table["run"] += len(pieces)
        # One clock for all, so that a time says which piece it is in.
        begin = pieces[-1][2] if pieces else 0.0
        table["t"] += begin
        for piece in segment.pieces:
            looks[float(len(pieces))] = piece.looks
            first, last = segment.spans()[piece.name]
            pieces.append((f"{segment.name}: {piece.name}", begin + first, begin + last))
        tables.append(table)
    columns = list(tables[0])
    plant = robot_plant(robot, columns, channels)
    stands = [hung if segment.scene == "hung" else None for segment in protocol.segments]
    plant, recordings = placed(plant, tables, stands, [segment.name for segment in protocol.segments])
    aligned = align(concatenate(recordings), plant)
    floor = np.maximum(noise_floor(aligned), [resolution(columns).get(o.name, 0.0) for o in plant.outputs])
    options = dataclasses.replace(options_for(plant, robot, columns), cut=looker(looks, warm_up_of(channels.servos)))
    rows = detectability(plant, aligned, floor, None, options)

    def piece_of(time: float) -> str:
        return next((name for name, first, last in pieces if first <= time < last), "")

    return [Shown(row, piece_of(row.segment[0])) for row in rows]
