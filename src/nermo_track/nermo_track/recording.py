"""A recording with the tracker's odometry beside what was in it; the original stays as it is."""

from __future__ import annotations

import heapq
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, ValidationError
from rosbags.interfaces import Connection
from rosbags.rosbag2 import StoragePlugin, Writer, WriterError
from rosbags.rosbag2.metadata import parse_qos
from rosbags.typesys import Stores, get_typestore

from nermo_description.markers import MARKER_TOPIC
from nermo_description.parameter_files import ParameterError, read_yaml
from nermo_node.recording_reader import Recording, RecordingError
from nermo_track.commands import Commands
from nermo_track.fuse import Poses

ODOMETRY, MARKED = "nav_msgs/msg/Odometry", "geometry_msgs/msg/PoseWithCovarianceStamped"
TOPIC = "tracker/odom"
"""Where `nermo gap diagnose` looks for the pose of base_link, below the mouse's namespace."""
SCENE, CLOCK_PIECE = "scene.yaml", "clock"
"""Beside the recording of a protocol's segment: which pieces were played when. The one of this name tells the clock."""
INNER = "recording"
"""Folder of the recording within that of a protocol's segment."""


@dataclass(frozen=True)
class Source:
    """A recording, alone or with its scene in the folder of a protocol's segment."""

    bag: Path
    segment: Path | None
    """Folder of the segment, whose other files belong to it."""

    @classmethod
    def at(cls, path: Path) -> Source:
        """What lies at a path."""
        inner = path / INNER
        return cls(inner, path) if inner.is_dir() and not list(path.glob("*.mcap")) else cls(path, None)


class _Piece(BaseModel):
    name: str
    begin: float
    end: float


class _Scene(BaseModel):
    """What is read of it here."""

    begun: int | None = None
    """[ns] Stamp from which pieces count."""
    pieces: tuple[_Piece, ...] = ()


def clock_piece(source: Source, commands: Commands) -> tuple[float, float] | None:
    """From when to when [s], since the first command, a segment's mouse did what tells a film's clock; None if never.

    Raises:
        RecordingError: the segment's scene cannot be read.
    """
    file = source.segment / SCENE if source.segment is not None else None
    if file is None or not file.is_file():
        return None
    try:
        scene = _Scene.model_validate(read_yaml(file))
    except (ParameterError, ValidationError) as error:
        raise RecordingError(f"{file}: is no scene of a protocol ({' '.join(str(error).split())})") from error
    lead = 0.0 if scene.begun is None else (scene.begun - int(commands.stamp[0])) * 1e-9
    return next(((lead + p.begin, lead + p.end) for p in scene.pieces if p.name == CLOCK_PIECE), None)


def write_beside(
    source: Source, recording: Recording, commands: Commands, poses: Poses, markers: Mapping[str, Poses], out: Path
) -> str:
    """Copy a recording, and its scene, into a new folder with the tracker's poses in it; returns base_link's topic.

    The folder appears whole or not at all. Messages are copied as they are.

    Args:
        source: What is copied.
        recording: The same, open.
        commands: Its servo commands, whose namespace and delay from stamp to log the poses get.
        poses: Of base_link on the floor, in [s] since the first command.
        markers: Likewise of marked places, by the place.
        out: New folder.

    Raises:
        RecordingError: ``out`` exists, there are poses of a tracker already, or it cannot be written.
    """
    below = commands.topic.rsplit("/", 1)[0] + "/"
    topic = below + TOPIC
    tracks = {topic: (ODOMETRY, poses)}
    tracks |= {below + MARKER_TOPIC.format(place=place): (MARKED, seen) for place, seen in markers.items()}
    already = next((name for name in tracks if name in recording.topics), None)
    if already is not None:
        raise RecordingError(f"{recording.path} has {already} already; give the recording as it was before")
    if out.exists():
        raise RecordingError(f"{out} exists already; a recording is never overwritten")
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=f".{out.name}.", dir=out.parent) as folder:
            whole = Path(folder) / out.name
            bag = whole if source.segment is None else whole / INNER
            _write_bag(bag, recording, commands, tracks)
            for file in source.segment.iterdir() if source.segment is not None else ():
                if file.is_file():
                    shutil.copy2(file, whole / file.name)
            whole.rename(out)
    except (OSError, WriterError) as error:
        raise RecordingError(f"{out} cannot be written: {error}") from error
    return topic


def _write_bag(path: Path, recording: Recording, commands: Commands, tracks: Mapping[str, tuple[str, Poses]]) -> None:
    """Write a recording's messages and, by topic, poses as messages of a type, in the order of their times."""
    store = get_typestore(Stores.ROS2_KILTED)
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as bag:
        connections: dict[str, Connection] = {}

        def copied() -> Iterator[tuple[int, Connection, bytes]]:
            for message in recording.raw():
                if message.topic not in connections:
                    about = message.channel.metadata
                    connections[message.topic] = bag.add_connection(
                        message.topic,
                        message.schema.name,
                        msgdef=message.schema.data.decode(),
                        rihs01=about.get("topic_type_hash") or "unknown",
                        offered_qos_profiles=parse_qos(about.get("offered_qos_profiles", "")),
                    )
                yield message.log_time, connections[message.topic], message.data

        def seen(topic: str, kind: str, poses: Poses) -> Iterator[tuple[int, Connection, bytes]]:
            own = bag.add_connection(topic, kind, typestore=store)
            for time, message in _messages(commands, kind, poses):
                yield time, own, bytes(store.serialize_cdr(message, kind))

        tracked = [seen(topic, kind, poses) for topic, (kind, poses) in tracks.items()]
        for time, connection, data in heapq.merge(copied(), *tracked, key=lambda part: part[0]):
            bag.write(connection, time, data)


def _messages(commands: Commands, kind: str, poses: Poses) -> Iterator[tuple[int, Any]]:
    """Poses as messages of a type, each with the time [ns] at which a recorder would have got it."""
    types = get_typestore(Stores.ROS2_KILTED).types
    time, header = types["builtin_interfaces/msg/Time"], types["std_msgs/msg/Header"]
    point, quaternion, vector = (types[f"geometry_msgs/msg/{name}"] for name in ("Point", "Quaternion", "Vector3"))
    pose, posed = types["geometry_msgs/msg/Pose"], types["geometry_msgs/msg/PoseWithCovariance"]
    twist, moved = types["geometry_msgs/msg/Twist"], types["geometry_msgs/msg/TwistWithCovariance"]
    # A film tells poses. That it tells no speed is written as the covariance that REP-145 has for unknown.
    unknown = np.zeros(36)
    unknown[0] = -1.0
    still = moved(twist(vector(0.0, 0.0, 0.0), vector(0.0, 0.0, 0.0)), unknown)
    stamps = commands.at(poses.time).tolist()
    for now, place, turn, spread in zip(
        stamps, poses.position, poses.rotation.as_quat(), poses.covariance, strict=True
    ):
        stands = pose(point(*map(float, place)), quaternion(*map(float, turn)))
        head = header(time(now // 10**9, now % 10**9), "odom")
        sure = posed(stands, np.ascontiguousarray(spread.ravel()))
        message = types[ODOMETRY](head, "base_link", sure, still) if kind == ODOMETRY else types[MARKED](head, sure)
        yield now + commands.delay, message
