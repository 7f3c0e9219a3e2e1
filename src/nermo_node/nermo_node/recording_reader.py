"""Reading recordings, whole or cut off, into NumPy arrays by topic.

A recorder that is killed leaves a file without index and footer. Everything up to the last whole chunk is read; the
cut itself is no error, it is reported as `Recording.complete`.
"""

from __future__ import annotations

import dataclasses
import os
import struct
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.exceptions import InvalidMagic, McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Schema
from mcap.stream_reader import get_chunk_data_stream
from mcap.writer import MCAP0_MAGIC as MAGIC
from numpy.typing import NDArray
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore

from nermo_node.older_messages import as_today

Array = NDArray[Any]


class RecordingError(RuntimeError):
    """A recording cannot be written or read; the message is one sentence that names the file and the reason."""


LONGEST_REASON = 200
"""Characters of a library's words, which may repeat a whole schema."""

_RECORD_HEADER = struct.Struct("<BQ")
"""Opcode and length of an MCAP record."""
_MESSAGE = struct.Struct("<HIQQ")
"""Channel, sequence, log time and publish time, before a message's data."""
_OUTSIDE_CHUNKS = frozenset({Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE})


@dataclass(frozen=True, slots=True)
class RawMessage:
    """One message as it was on the wire. Times in ns since the epoch, of the recording machine's clock."""

    channel: Channel
    schema: Schema
    log_time: int
    publish_time: int
    sequence: int
    data: bytes

    @property
    def topic(self) -> str:
        """Its topic's full name."""
        return self.channel.topic


@dataclass(frozen=True, slots=True)
class TopicInfo:
    """What a recording holds of one topic."""

    name: str
    type: str
    message_count: int


@dataclass(frozen=True)
class TopicData:
    """All messages of one topic as columns; row i of every column belongs to message i, in the order of arrival.

    Nested fields have dotted names (`pose.pose.position.x`), times are int64 ns (`header.stamp`), and arrays of one
    length become further axes. Arrays whose length changes stay object columns of one array a row.
    """

    name: str
    type: str
    log_time: NDArray[np.int64]
    """When the recorder got it, ns since the epoch."""
    publish_time: NDArray[np.int64]
    """When the publisher sent it, ns since the epoch."""
    columns: dict[str, Array]

    def __len__(self) -> int:
        return len(self.log_time)

    def __getitem__(self, column: str) -> Array:
        """One column.

        Raises:
            RecordingError: there is none of that name.
        """
        try:
            return self.columns[column]
        except KeyError:
            raise RecordingError(
                f"{self.name} ({self.type}) has no field {column}; it has {', '.join(self.columns) or 'no messages'}"
            ) from None

    @property
    def stamp(self) -> NDArray[np.int64]:
        """ROS time of the header, ns, shape (n,)."""
        return self["header.stamp"]

    def by_name(self, column: str, names: Sequence[str]) -> NDArray[np.float64]:
        """Values of a column that stands beside a `name` array, put into the order of `names`, shape (n, len(names)).

        A name that a message lacks is NaN there.
        """
        table = np.full((len(self), len(names)), np.nan)
        for row, (present, values) in enumerate(zip(self["name"], self[column], strict=True)):
            place = {name: position for position, name in enumerate(present)}
            for target, name in enumerate(names):
                if name in place and place[name] < len(values):
                    table[row, target] = values[place[name]]
        return table


class Recording:
    """One recording: a directory with an `.mcap` file in it, or the file itself."""

    def __init__(self, path: Path) -> None:
        """Find the file and count its messages.

        Raises:
            RecordingError: there is no recording, or it is no ROS 2 recording.
        """
        self.path = recording_file(path)
        self.complete = False
        counts: dict[str, int] = {}
        types: dict[str, str] = {}
        for message in self.raw():
            counts[message.topic] = counts.get(message.topic, 0) + 1
            types[message.topic] = message.schema.name
        self.topics = {name: TopicInfo(name, types[name], counts[name]) for name in sorted(counts)}

    def raw(self, topics: Iterable[str] | None = None) -> Iterator[RawMessage]:
        """Messages of some topics (default: all) in the order of the file, up to its end or cut.

        Raises:
            RecordingError: the file cannot be read, or is no MCAP file.
        """
        wanted = None if topics is None else frozenset(topics)
        schemas: dict[int, Schema] = {}
        channels: dict[int, Channel] = {}
        left_out: set[int] = set()
        for opcode, content, begin, end in self._records():
            if opcode == Opcode.MESSAGE:
                number, sequence, log_time, publish_time = _MESSAGE.unpack_from(content, begin)
                if number in left_out:
                    continue
                channel = channels.get(number)
                schema = None if channel is None else schemas.get(channel.schema_id)
                if channel is None or schema is None:
                    raise RecordingError(f"{self.path} is damaged: a message comes before its channel and schema")
                data = content[begin + _MESSAGE.size : end]
                yield RawMessage(channel, schema, log_time, publish_time, sequence, data)
            elif opcode == Opcode.CHANNEL:
                channel = Channel.read(ReadDataStream(BytesIO(content[begin:end])))
                channels[channel.id] = channel
                if wanted is not None and channel.topic not in wanted:
                    left_out.add(channel.id)
            elif opcode == Opcode.SCHEMA:
                schema = Schema.read(ReadDataStream(BytesIO(content[begin:end])))
                schemas[schema.id] = schema

    def decoded(self, topics: Iterable[str] | None = None) -> Iterator[tuple[RawMessage, Any]]:
        """Messages of some topics together with their decoded form: objects with the fields as attributes.

        Raises:
            RecordingError: as `raw`, or a topic is not in the recording.
        """
        decoder = _Decoder(self.path)
        for message in self.raw(self._checked(topics)):
            yield message, decoder(message)

    def read(self, topics: Iterable[str] | None = None) -> dict[str, TopicData]:
        """Arrays of some topics (default: all) in one pass over the file.

        Raises:
            RecordingError: as `raw`, or a topic is not in the recording.
        """
        wanted = self._checked(topics)
        raw: dict[str, list[RawMessage]] = {name: [] for name in wanted}
        values: dict[str, list[Any]] = {name: [] for name in wanted}
        for message, value in self.decoded(wanted):
            raw[message.topic].append(message)
            values[message.topic].append(value)
        return {
            name: TopicData(
                name,
                self.topics[name].type,
                np.array([message.log_time for message in raw[name]], dtype=np.int64),
                np.array([message.publish_time for message in raw[name]], dtype=np.int64),
                _columns(values[name], ""),
            )
            for name in wanted
        }

    def topic_ending(self, name: str) -> str:
        """The one recorded topic whose name is `name` in any namespace, such as `/nermo/odom` for `odom`.

        Raises:
            RecordingError: there is none, or more than one.
        """
        found = [topic for topic in self.topics if topic == name or topic.endswith(f"/{name.lstrip('/')}")]
        # `odom` also ends `truth/odom`: the shortest name is the one in the plain namespace.
        shortest = [topic for topic in found if topic.count("/") == min(other.count("/") for other in found)]
        if len(shortest) != 1:
            what = f"has {', '.join(shortest)} for" if shortest else "has no topic"
            raise RecordingError(f"{self.path} {what} {name}; its topics: {', '.join(self.topics) or 'none'}")
        return shortest[0]

    def _checked(self, topics: Iterable[str] | None) -> list[str]:
        wanted = list(self.topics) if topics is None else list(topics)
        for name in wanted:
            if name not in self.topics:
                raise RecordingError(f"{self.path} has no topic {name}; its topics: {', '.join(self.topics) or 'none'}")
        return wanted

    def _records(self) -> Iterator[tuple[int, bytes, int, int]]:
        """Schemas, channels and messages, also those in chunks: opcode, bytes, and from where to where in them it is.

        Plain offsets, since a recording has a million of them and most are not wanted.
        """
        try:
            with self.path.open("rb") as file:
                end = _end_of_whole_records(file)
                file.seek(len(MAGIC))
                while file.tell() < end:
                    opcode, length = _RECORD_HEADER.unpack(file.read(_RECORD_HEADER.size))
                    if opcode == Opcode.CHUNK:
                        content = self._unpacked(file.read(length))
                        yield from _records_of_chunk(content)
                    elif opcode in _OUTSIDE_CHUNKS:
                        yield opcode, file.read(length), 0, length
                    else:
                        file.seek(length, os.SEEK_CUR)
                    if file.tell() >= end:
                        self.complete = opcode == Opcode.FOOTER and file.read() == MAGIC
        except InvalidMagic:
            raise RecordingError(f"{self.path} is no MCAP file") from None
        except OSError as error:
            raise RecordingError(f"cannot read {self.path}: {error.strerror}") from None
        except (McapError, ValueError, OverflowError, struct.error) as error:
            raise RecordingError(f"{self.path} is damaged: {' '.join(str(error).split())}") from None

    def _unpacked(self, chunk: bytes) -> bytes:
        try:
            stream, length = get_chunk_data_stream(Chunk.read(ReadDataStream(BytesIO(chunk))), validate_crc=True)
            return stream.read(length)
        except Exception as error:  # each codec has errors of its own
            raise RecordingError(f"{self.path} is damaged: {' '.join(str(error).split())}") from None


def _records_of_chunk(content: bytes) -> Iterator[tuple[int, bytes, int, int]]:
    place, unpack, header = 0, _RECORD_HEADER.unpack_from, _RECORD_HEADER.size
    while place + header <= len(content):
        opcode, length = unpack(content, place)
        begin = place + header
        place = begin + length
        yield opcode, content, begin, place


class _Decoder:
    """Decodes messages by the schemas that the recording itself carries, and makes those of today of older ones."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._types = get_typestore(Stores.EMPTY)
        self._known: set[str] = set()

    def __call__(self, message: RawMessage) -> Any:
        name = message.schema.name
        if name not in self._known:
            try:
                types = get_types_from_msg(message.schema.data.decode(), name)
                self._types.register({key: value for key, value in types.items() if key not in self._types.fielddefs})
            except (UnicodeDecodeError, TypesysError) as error:
                raise self._unusable(message, f"its schema cannot be read: {error}") from error
            self._known.add(name)
        try:
            return as_today(name, self._types.deserialize_cdr(message.data, name))
        except KeyError as error:
            raise self._unusable(message, f"its schema does not say what {error.args[0]} is") from error
        except (SerdeError, ValueError) as error:
            raise self._unusable(message, f"a message does not fit its schema: {error}") from error

    def _unusable(self, message: RawMessage, why: str) -> RecordingError:
        text = " ".join(why.split())[:LONGEST_REASON]
        return RecordingError(f"{self._path}: topic {message.topic} of type {message.schema.name}: {text}")


def _end_of_whole_records(file: BinaryIO) -> int:
    """Offset behind the last record that is wholly in the file, which a kill may have cut; 0 if there is none."""
    size = file.seek(0, os.SEEK_END)
    end = len(MAGIC)
    file.seek(0)
    if file.read(end) not in (MAGIC, b""):
        raise InvalidMagic("first bytes")
    while end + _RECORD_HEADER.size <= size:
        file.seek(end)
        length: int = _RECORD_HEADER.unpack(file.read(_RECORD_HEADER.size))[1]
        if end + _RECORD_HEADER.size + length > size:
            break
        end += _RECORD_HEADER.size + length
    file.seek(0)
    return end if end > len(MAGIC) else 0


def recording_file(path: Path) -> Path:
    """The `.mcap` file of a recording given by its directory or by the file.

    Raises:
        RecordingError: there is none, or more than one.
    """
    if path.is_file():
        return path
    if not path.exists():
        raise RecordingError(f"{path} does not exist")
    files = sorted(path.glob("*.mcap"))
    if len(files) != 1:
        raise RecordingError(f"{path} holds {len(files)} .mcap files, a recording holds one")
    return files[0]


def _columns(values: Sequence[Any], prefix: str) -> dict[str, Array]:
    """Columns of equal messages or field values; `prefix` is the dotted name so far."""
    if not values:
        return {}
    first = values[0]
    if dataclasses.is_dataclass(first):
        names = [field.name for field in dataclasses.fields(first) if field.name != "__msgtype__"]
        if set(names) == {"sec", "nanosec"}:
            return {prefix: np.array([value.sec * 10**9 + value.nanosec for value in values], dtype=np.int64)}
        columns: dict[str, Array] = {}
        for name in names:
            columns |= _columns([getattr(value, name) for value in values], f"{prefix}.{name}" if prefix else name)
        return columns
    if isinstance(first, list | np.ndarray):
        return _array_columns(values, prefix)
    return {prefix: np.array(values, dtype=object if isinstance(first, str) else None)}


def _array_columns(values: Sequence[Any], prefix: str) -> dict[str, Array]:
    length = len(values[0])
    if any(len(value) != length for value in values):
        ragged = np.empty(len(values), dtype=object)
        ragged[:] = values
        return {prefix: ragged}
    if length and dataclasses.is_dataclass(values[0][0]):
        inner = _columns([element for value in values for element in value], prefix)
        return {name: column.reshape(len(values), length, *column.shape[1:]) for name, column in inner.items()}
    strings = length > 0 and isinstance(values[0][0], str)
    return {prefix: np.array(values, dtype=object if strings else None)}
