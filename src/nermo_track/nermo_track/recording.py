"""A recording with the tracker's odometry beside what was in it; the original stays as it is."""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.rosbag2 import StoragePlugin, Writer, WriterError
from rosbags.rosbag2.metadata import parse_qos
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

from nermo_node.recording_reader import Recording, RecordingError

Array = NDArray[np.float64]

ODOMETRY = "nav_msgs/msg/Odometry"
TOPIC = "tracker/odom"
"""Where `nermo gap diagnose` looks for the pose of base_link, below the mouse's namespace."""
INNER = "recording"
"""Folder of the recording within that of a protocol's segment."""


def write_beside(
    recording: Recording,
    out: Path,
    command_topic: str,
    stamp: NDArray[np.int64],
    position: Array,
    rotation: Rotation,
    covariance: Array,
) -> str:
    """Copy a recording into a new folder with the tracker's poses in it; returns their topic.

    The folder appears whole or not at all. Messages are copied as they are, and stand in the order of their times.

    Args:
        recording: What is copied.
        out: New folder.
        command_topic: Topic of the servo commands, whose namespace the poses get, and whose delay from stamp to log.
        stamp: (n,) [ns] of ROS time.
        position: (n, 3) [m] of base_link in the floor's frame.
        rotation: n of them.
        covariance: (n, 6, 6) [m, rad, fixed axes]

    Raises:
        RecordingError: ``out`` exists, there are poses of a tracker already, or it cannot be written.
    """
    topic = command_topic.rsplit("/", 1)[0] + "/" + TOPIC
    if topic in recording.topics:
        raise RecordingError(f"{recording.path} has {topic} already; a recording takes one film's poses")
    if out.exists():
        raise RecordingError(f"{out} exists already; a recording is never overwritten")
    commands = recording.read([command_topic])[command_topic]
    delay = int(np.median(commands.log_time - commands.stamp))
    store = get_typestore(Stores.ROS2_KILTED)
    poses = _messages(stamp, position, rotation, covariance)
    raw = [(message.log_time, message) for message in recording.raw()]
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=f".{out.name}.", dir=out.parent) as folder:
            inner = Path(folder) / out.name
            with Writer(inner, version=9, storage_plugin=StoragePlugin.MCAP) as bag:
                connections = {}
                for _, message in raw:
                    if message.topic not in connections:
                        connections[message.topic] = bag.add_connection(
                            message.topic,
                            message.schema.name,
                            msgdef=message.schema.data.decode(),
                            rihs01=message.channel.metadata.get("topic_type_hash") or "unknown",
                            offered_qos_profiles=parse_qos(message.channel.metadata.get("offered_qos_profiles", "")),
                        )
                own = bag.add_connection(topic, ODOMETRY, typestore=store)
                parts = [(time, connections[message.topic], message.data) for time, message in raw]
                parts += [(time + delay, own, bytes(store.serialize_cdr(pose, ODOMETRY))) for time, pose in poses]
                for time, connection, data in sorted(parts, key=lambda part: part[0]):
                    bag.write(connection, time, data)
            inner.rename(out)
    except (OSError, WriterError) as error:
        raise RecordingError(f"{out} cannot be written: {error}") from error
    return topic


def find(path: Path) -> tuple[Path, Path]:
    """A recording, and the folder that is copied with it: that of a protocol's segment, else the recording itself."""
    inner = path / INNER
    return (inner, path) if inner.is_dir() and not list(path.glob("*.mcap")) else (path, path)


def copy_rest(folder: Path, out: Path) -> None:
    """Copy what lies beside the recording in a segment's folder, as its scene.

    Raises:
        RecordingError: it cannot be copied.
    """
    try:
        for file in folder.iterdir():
            if file.is_file():
                shutil.copy2(file, out / file.name)
    except OSError as error:
        raise RecordingError(f"{out} cannot be written: {error}") from error


def _messages(
    stamp: NDArray[np.int64], position: Array, rotation: Rotation, covariance: Array
) -> list[tuple[int, Any]]:
    types = get_typestore(Stores.ROS2_KILTED).types
    time, header = types["builtin_interfaces/msg/Time"], types["std_msgs/msg/Header"]
    point, quaternion, vector = (types[f"geometry_msgs/msg/{name}"] for name in ("Point", "Quaternion", "Vector3"))
    pose, posed = types["geometry_msgs/msg/Pose"], types["geometry_msgs/msg/PoseWithCovariance"]
    twist, moved = types["geometry_msgs/msg/Twist"], types["geometry_msgs/msg/TwistWithCovariance"]
    # A film tells poses. That it tells no speed is written as the covariance that REP-145 has for unknown.
    unknown = np.zeros(36)
    unknown[0] = -1.0
    still = moved(twist(vector(0.0, 0.0, 0.0), vector(0.0, 0.0, 0.0)), unknown)
    found = []
    for now, place, turn, spread in zip(stamp.tolist(), position, rotation.as_quat(), covariance, strict=True):
        stands = pose(point(*map(float, place)), quaternion(*map(float, turn)))
        head = header(time(now // 10**9, now % 10**9), "odom")
        message = types[ODOMETRY](head, "base_link", posed(stands, np.ascontiguousarray(spread.ravel())), still)
        found.append((now, message))
    return found
