"""An MCAP bag on disk, laid out as rosbag2 does: a directory with `<name>_0.mcap` and `metadata.yaml`."""

from __future__ import annotations

import contextlib
import errno
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

import yaml
from mcap.writer import CompressionType, Writer

from nermo_bringup.recording.errors import RecordingError
from nermo_bringup.recording.qos import Offer

METADATA_FILE = "metadata.yaml"
METADATA_VERSION = 9
LIBRARY = "nermo_bringup 0.1.0"


@dataclass(slots=True, eq=False)
class Topic:
    """One recorded topic. `offers` may grow while the recording runs."""

    name: str
    type: str
    schema: str
    type_hash: str = ""
    offers: list[Offer] = field(default_factory=list)
    message_count: int = 0


class BagWriter:
    """Writes one bag. Not thread-safe; `BackgroundWriter` puts it on a thread of its own.

    Messages become readable on disk with `flush`, which closes the chunk in progress.
    """

    def __init__(self, directory: Path, custom_data: Mapping[str, str] | None = None) -> None:
        """Create the directory and open the file in it.

        Raises:
            RecordingError: the directory exists already or cannot be written.
        """
        self.directory = directory
        self.path = directory / f"{directory.name}_0.mcap"
        self._custom_data = dict(custom_data or {})
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self._topics: dict[str, Topic] = {}
        self._first_ns = 0
        self._last_ns = 0
        self.message_count = 0
        try:
            directory.mkdir(parents=True)
            self._file: BinaryIO = self.path.open("xb")
        except FileExistsError:
            raise RecordingError(f"{directory} exists already; a recording is never overwritten") from None
        except OSError as error:
            raise RecordingError(f"cannot record into {directory}: {error.strerror}") from None
        self._writer = Writer(self._file, compression=CompressionType.ZSTD)
        try:
            self._writer.start(profile="ros2", library=LIBRARY)
            self._file.flush()
        except OSError as error:
            raise self._failed(error) from None

    def add(self, topic: Topic) -> None:
        """Register a topic. Adding it again does nothing.

        Raises:
            RecordingError: the file cannot be written.
        """
        if topic.name in self._channels:
            return
        try:
            if topic.type not in self._schemas:
                self._schemas[topic.type] = self._writer.register_schema(topic.type, "ros2msg", topic.schema.encode())
            offered = yaml.safe_dump([offer.as_metadata() for offer in topic.offers], sort_keys=False)
            self._channels[topic.name] = self._writer.register_channel(
                topic.name,
                "cdr",
                self._schemas[topic.type],
                {"offered_qos_profiles": offered, "topic_type_hash": topic.type_hash},
            )
        except OSError as error:
            raise self._failed(error) from None
        self._topics[topic.name] = topic

    def write(self, topic: Topic, log_time: int, publish_time: int, sequence: int, data: bytes) -> None:
        """Append one message of a topic, which is registered if it is new. Times in ns since the epoch.

        Raises:
            RecordingError: the file cannot be written.
        """
        self.add(topic)
        try:
            self._writer.add_message(
                self._channels[topic.name], log_time=log_time, publish_time=publish_time, sequence=sequence, data=data
            )
        except OSError as error:
            raise self._failed(error) from None
        self._first_ns = log_time if self.message_count == 0 else min(self._first_ns, log_time)
        self._last_ns = max(self._last_ns, log_time)
        self.message_count += 1
        topic.message_count += 1

    def flush(self) -> None:
        """Make everything written so far readable, whatever happens to this process.

        Raises:
            RecordingError: the file cannot be written.
        """
        try:
            self._writer.flush()
        except OSError as error:
            raise self._failed(error) from None

    def close(self) -> None:
        """Write index, footer and `metadata.yaml`.

        Raises:
            RecordingError: the file cannot be written; what was flushed stays readable.
        """
        try:
            self._writer.finish()
            self._file.flush()
            os.fsync(self._file.fileno())
            self._file.close()
            times = self._first_ns, self._last_ns
            topics = list(self._topics.values())
            write_metadata(self.directory / METADATA_FILE, topics, times, self.path.name, self._custom_data)
        except OSError as error:
            raise self._failed(error) from None

    def _failed(self, error: OSError) -> RecordingError:
        reason = "the disk is full" if error.errno in (errno.ENOSPC, errno.EDQUOT) else error.strerror
        # Closing tries to write the rest once more and fails like the write before it, which is reported.
        with contextlib.suppress(OSError):
            self._file.close()
        return RecordingError(
            f"the recording {self.directory} stopped after {self.message_count} messages: {reason}; "
            "what was written before stays readable"
        )


def write_metadata(
    path: Path, topics: Sequence[Topic], times: tuple[int, int], mcap: str, custom_data: Mapping[str, str]
) -> None:
    """Writes the `metadata.yaml` of a bag, whole or not at all.

    Args:
        path: The file.
        topics: What was recorded.
        times: Log times of the first and last message [ns].
        mcap: Name of the MCAP file beside it.
        custom_data: Further notes.

    Raises:
        OSError: The file cannot be written.
    """
    count = sum(topic.message_count for topic in topics)
    span = {
        "duration": {"nanoseconds": times[1] - times[0]},
        "starting_time": {"nanoseconds_since_epoch": times[0]},
    }
    information = {
        "version": METADATA_VERSION,
        "storage_identifier": "mcap",
        **span,
        "message_count": count,
        "topics_with_message_count": [
            {
                "topic_metadata": {
                    "name": topic.name,
                    "type": topic.type,
                    "serialization_format": "cdr",
                    "offered_qos_profiles": [offer.as_metadata() for offer in topic.offers],
                    "type_description_hash": topic.type_hash,
                },
                "message_count": topic.message_count,
            }
            for topic in topics
        ],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [mcap],
        "files": [{"path": mcap, **span, "message_count": count}],
        "custom_data": dict(custom_data) or None,
        "ros_distro": os.environ.get("ROS_DISTRO", "kilted"),
    }
    temporary = path.with_name(f".{path.name}.partial")
    temporary.write_text(yaml.safe_dump({"rosbag2_bagfile_information": information}, sort_keys=False), "utf-8")
    temporary.replace(path)
