"""Giving a cut recording its index, footer and metadata.yaml back, so that every tool opens it.

`Recording` reads a cut file as it is. `rosbags` and `ros2 bag` want a whole one: `repair` writes it beside the cut
file, puts it in its place only when it is complete, and keeps what was there.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from nermo_bringup.recording.errors import RecordingError
from nermo_bringup.recording.qos import Offer
from nermo_bringup.recording.salvage import Progress, Salvage, scan, write
from nermo_bringup.recording.writer import METADATA_FILE, Topic, write_metadata
from nermo_description.parameter_files import ParameterError, parse_yaml
from nermo_node.recording_reader import recording_file

BACKUP = ".orig"
_NOTE = {"repaired": "the recorder was killed; this is all it had written"}


@dataclass(frozen=True)
class Repaired:
    """What has become of a recording."""

    message_count: int
    backup: Path | None
    """What the file was before; None where it was whole."""
    damaged_chunks: int
    """Left out, because their checksum does not hold."""
    unused_bytes: int
    """At the end of the cut file, no whole record any more."""


def repair(directory: Path, progress: Progress = lambda done, total: None) -> Repaired:
    """Make a recording whole. A whole file is left as it is, a cut one is kept under another name.

    Raises:
        RecordingError: There is no recording, it is not a directory, nothing in it can be read, there is a backup
            already, or the disk cannot take the copy. Then nothing has changed.
    """
    if not directory.is_dir():
        raise RecordingError(f"{directory} is no recording directory")
    path = recording_file(directory)
    salvage = scan(path, progress)
    topics = [_topic(salvage, channel, path) for channel in salvage.channels]
    metadata, times = directory / METADATA_FILE, (salvage.first, salvage.last)
    backup = None
    try:
        if not salvage.whole:
            backup = _replace(salvage, progress)
        if backup is not None or not metadata.exists():
            write_metadata(metadata, topics, times, path.name, {} if backup is None else _NOTE)
    except OSError as error:
        raise RecordingError(f"{directory} cannot be repaired: {error.strerror}; {path.name} is as it was") from error
    return Repaired(salvage.message_count, backup, salvage.damaged, salvage.unused)


def _replace(salvage: Salvage, progress: Progress) -> Path:
    """Puts the whole file in the place of the cut one, which becomes the backup."""
    path = salvage.path
    backup, new = path.with_name(path.name + BACKUP), path.with_name(f".{path.name}.partial")
    if backup.exists():
        raise RecordingError(f"{backup} exists already: move it away, a backup is never overwritten")
    try:
        with new.open("wb") as file:
            write(salvage, file, progress)
        path.rename(backup)
        new.replace(path)
    finally:
        new.unlink(missing_ok=True)
    return backup


def _topic(salvage: Salvage, channel_id: int, path: Path) -> Topic:
    channel = salvage.channels[channel_id]
    schema = salvage.schemas.get(channel.schema_id)
    if schema is None:
        raise RecordingError(f"{path}: the topic {channel.topic} has no schema: it is no ROS 2 recording")
    try:
        offered = parse_yaml(channel.metadata.get("offered_qos_profiles", ""), f"{path}: QoS of {channel.topic}") or ()
        offers = [_offer(entry) for entry in offered]
    except (ParameterError, KeyError, TypeError, ValueError) as error:
        raise RecordingError(f"{path}: the QoS of {channel.topic} cannot be read: {error}") from error
    return Topic(
        channel.topic,
        schema.name,
        "",
        channel.metadata.get("topic_type_hash", ""),
        offers,
        salvage.counts[channel_id],
    )


def _offer(entry: Mapping[str, Any]) -> Offer:
    def nanoseconds(name: str) -> int:
        return int(entry[name]["sec"]) * 10**9 + int(entry[name]["nsec"])

    return Offer(
        reliability=entry["reliability"],
        durability=entry["durability"],
        history=entry["history"],
        depth=entry["depth"],
        deadline_ns=nanoseconds("deadline"),
        lifespan_ns=nanoseconds("lifespan"),
        liveliness=entry["liveliness"],
        lease_ns=nanoseconds("liveliness_lease_duration"),
    )
