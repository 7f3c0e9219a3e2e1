"""Giving a cut recording its index, footer and metadata.yaml back, so that every tool opens it.

`Recording` reads a cut file as it is. `rosbags` and `ros2 bag` want a whole one: `repair` writes it beside the cut
file and puts it in its place only when it is complete.
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from nermo_bringup.recording.bag import METADATA_FILE, BagWriter, Topic
from nermo_bringup.recording.errors import RecordingError
from nermo_bringup.recording.qos import Offer
from nermo_node.recording import RawMessage, Recording


def repair(directory: Path) -> int:
    """Make a recording whole; the number of messages in it. A whole recording is left as it is.

    Raises:
        RecordingError: there is no recording, it is not a directory, or the disk cannot take the copy.
    """
    if not directory.is_dir():
        raise RecordingError(f"{directory} is no recording directory")
    recording = Recording(directory)
    count = sum(topic.message_count for topic in recording.topics.values())
    if recording.complete and (directory / METADATA_FILE).exists():
        return count
    workshop = directory / ".repair"
    shutil.rmtree(workshop, ignore_errors=True)
    workshop.mkdir()
    bag = BagWriter(
        workshop / directory.resolve().name, {"repaired": "the recorder was killed; this is all it had written"}
    )
    topics: dict[str, Topic] = {}
    for message in recording.raw():
        topic = topics.setdefault(message.topic, _topic(message))
        bag.write(topic, message.log_time, message.publish_time, message.sequence, message.data)
    bag.close()
    bag.path.replace(directory / bag.path.name)
    (bag.directory / METADATA_FILE).replace(directory / METADATA_FILE)
    if recording.path.name != bag.path.name:
        recording.path.unlink()
    shutil.rmtree(workshop)
    return count


def _topic(message: RawMessage) -> Topic:
    metadata = message.channel.metadata
    offers = [_offer(entry) for entry in yaml.safe_load(metadata.get("offered_qos_profiles", "")) or ()]
    return Topic(
        message.topic, message.schema.name, message.schema.data.decode(), metadata.get("topic_type_hash", ""), offers
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
