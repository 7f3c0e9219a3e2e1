"""What is left of a cut MCAP file, and the same as a whole one: bytes are copied, and only the index is made anew.

The layout is that of the MCAP specification, version 0 (mcap.dev/spec). Nothing is deserialised; each chunk is unpacked
once to see that its checksum holds and which channels it has.
"""

from __future__ import annotations

import mmap
import struct
import zlib
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, ChunkIndex, DataEnd, Footer, McapRecord, Schema, Statistics
from mcap.stream_reader import get_chunk_data_stream
from mcap.writer import MCAP0_MAGIC as MAGIC

from nermo_bringup.recording.errors import RecordingError

Progress = Callable[[int, int], None]
"""Gets bytes done and bytes in all."""

_HEADER = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQ")
"""Channel, sequence and log time at the beginning of a message."""
_COPY = 1 << 20
_UNREADABLE = (McapError, ValueError, OverflowError, MemoryError, struct.error)
"""What the parts of a damaged file raise."""
_COPIED = frozenset({Opcode.HEADER, Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.ATTACHMENT, Opcode.METADATA})


@dataclass(frozen=True, slots=True)
class Span:
    """Bytes of the cut file that stay as they are."""

    begin: int
    end: int


@dataclass
class Salvage:
    """What a file holds."""

    path: Path
    whole: bool = False
    """Whether it ends as it should, so that nothing needs to be done."""
    damaged: int = 0
    """Chunks that were left out because their checksum does not hold."""
    unused: int = 0
    """Bytes at the end that are no whole record any more."""
    pieces: list[Span | bytes] = field(default_factory=list)
    size: int = len(MAGIC)
    """Of the pieces, with the magic before them [bytes]."""
    chunks: list[ChunkIndex] = field(default_factory=list)
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    counts: Counter[int] = field(default_factory=Counter)
    """Messages by channel."""
    first: int = 0
    last: int = 0
    """Log times of the first and last message [ns]."""

    @property
    def message_count(self) -> int:
        """In all channels."""
        return self.counts.total()

    def _add(self, piece: Span | bytes) -> None:
        self.size += piece.end - piece.begin if isinstance(piece, Span) else len(piece)
        last = self.pieces[-1] if self.pieces else None
        if isinstance(piece, Span) and isinstance(last, Span) and last.end == piece.begin:
            self.pieces[-1] = Span(last.begin, piece.end)
        else:
            self.pieces.append(piece)

    def _see(self, channel: int, times: Sequence[int]) -> None:
        self.first = min(times) if not self.counts else min(self.first, *times)
        self.last = max(self.last, *times)
        self.counts[channel] += len(times)


def scan(path: Path, progress: Progress = lambda done, total: None) -> Salvage:
    """Looks at every record of a file up to its end or cut.

    Raises RecordingError where it is no MCAP file, or where nothing in it can be read.
    """
    salvage = Salvage(path)
    try:
        with path.open("rb") as file:
            if file.read(len(MAGIC)) != MAGIC:
                raise RecordingError(f"{path} is no MCAP file")
            with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
                _scan(salvage, data, progress)
    except OSError as error:
        raise RecordingError(f"{path} cannot be read: {error.strerror}") from error
    except _UNREADABLE as error:
        raise RecordingError(f"{path}: a schema or channel cannot be read: it is left as it is") from error
    if not salvage.whole and not salvage.message_count:
        raise RecordingError(
            f"{path} holds no message that can be read (of {path.stat().st_size} bytes): it is left as it is"
        )
    return salvage


def _scan(salvage: Salvage, data: mmap.mmap, progress: Progress) -> None:
    place = len(MAGIC)
    for opcode, begin, end in _records(data, len(MAGIC)):
        if begin == len(MAGIC) and opcode != Opcode.HEADER:
            break
        if opcode == Opcode.CHUNK:
            _take_chunk(salvage, data, begin, end)
        elif opcode in _COPIED:
            _note(salvage, opcode, data[begin + _HEADER.size : end])
            salvage._add(Span(begin, end))
        elif opcode == Opcode.FOOTER:
            salvage.whole = data[end : end + len(MAGIC)] == MAGIC and salvage.damaged == 0
            place = len(data)
            break
        place = end
        progress(place, len(data))
    salvage.unused = len(data) - place


def _records(data: mmap.mmap | bytes, begin: int) -> Iterator[tuple[int, int, int]]:
    """Opcode, begin and end of each whole record."""
    while begin + _HEADER.size <= len(data):
        opcode, length = _HEADER.unpack_from(data, begin)
        end = begin + _HEADER.size + length
        if not Opcode.HEADER <= opcode <= Opcode.DATA_END or end > len(data):
            return
        yield opcode, begin, end
        begin = end


def _note(salvage: Salvage, opcode: int, content: bytes) -> None:
    """Remembers a schema or channel, and counts a message."""
    stream = ReadDataStream(BytesIO(content))
    if opcode == Opcode.SCHEMA:
        schema = Schema.read(stream)
        salvage.schemas[schema.id] = schema
    elif opcode == Opcode.CHANNEL:
        channel = Channel.read(stream)
        salvage.channels[channel.id] = channel
    elif opcode == Opcode.MESSAGE:
        channel_id, _, time = _MESSAGE.unpack_from(content)
        salvage._see(channel_id, (time,))


def _take_chunk(salvage: Salvage, data: mmap.mmap, begin: int, end: int) -> None:
    """Takes a chunk over as it is, with a new index of its messages; leaves out one that is damaged."""
    try:
        chunk = Chunk.read(ReadDataStream(BytesIO(data[begin + _HEADER.size : end])))
        if chunk.uncompressed_size > _largest_unpacked(len(chunk.data)):
            raise McapError("a size that no compression reaches")
        stream, length = get_chunk_data_stream(chunk)
        content = stream.read(length)
        damaged = chunk.uncompressed_crc not in (0, zlib.crc32(content))
    except Exception:  # each codec has errors of its own
        damaged = True
    if damaged:
        salvage.damaged += 1
        return
    entries: dict[int, list[int]] = {}
    for opcode, at, until in _records(content, 0):
        if opcode == Opcode.MESSAGE:
            channel, _, time = _MESSAGE.unpack_from(content, at + _HEADER.size)
            entries.setdefault(channel, []).extend((time, at))
        else:
            _note(salvage, opcode, content[at + _HEADER.size : until])

    start = salvage.size
    salvage._add(Span(begin, end))
    offsets, before = {}, salvage.size
    for channel, pairs in entries.items():
        offsets[channel] = salvage.size
        salvage._add(_message_index(channel, pairs))
        salvage._see(channel, pairs[::2])
    salvage.chunks.append(
        ChunkIndex(
            chunk_length=end - begin,
            chunk_start_offset=start,
            compression=chunk.compression,
            compressed_size=len(chunk.data),
            message_end_time=max((max(pairs[::2]) for pairs in entries.values()), default=0),
            message_index_length=salvage.size - before,
            message_index_offsets=offsets,
            message_start_time=min((min(pairs[::2]) for pairs in entries.values()), default=0),
            uncompressed_size=chunk.uncompressed_size,
        )
    )


def _largest_unpacked(packed: int) -> int:
    """Zstandard makes at most 128 kB of a block of 4 bytes."""
    return (1 << 20) + (packed << 15)


def _message_index(channel: int, pairs: list[int]) -> bytes:
    """The record for a channel; `pairs` are times and places in turn."""
    content = struct.pack(f"<HI{len(pairs)}Q", channel, 8 * len(pairs), *pairs)
    return _HEADER.pack(Opcode.MESSAGE_INDEX, len(content)) + content


def write(salvage: Salvage, target: BinaryIO, progress: Progress = lambda done, total: None) -> None:
    """Writes what a file holds as a whole file. Raises OSError."""
    done = 0
    target.write(MAGIC)
    with salvage.path.open("rb") as source:
        for piece in salvage.pieces:
            if isinstance(piece, bytes):
                target.write(piece)
                continue
            source.seek(piece.begin)
            left = piece.end - piece.begin
            while left:
                copied = target.write(source.read(min(left, _COPY)))
                left, done = left - copied, done + copied
                progress(done, salvage.size)
    end = _packed(DataEnd(data_section_crc=0))
    target.write(end)
    for record in (*salvage.schemas.values(), *salvage.channels.values(), _statistics(salvage), *salvage.chunks):
        target.write(_packed(record))
    target.write(_packed(Footer(summary_start=salvage.size + len(end), summary_offset_start=0, summary_crc=0)))
    target.write(MAGIC)


def _statistics(salvage: Salvage) -> Statistics:
    return Statistics(
        attachment_count=0,
        channel_count=len(salvage.channels),
        channel_message_counts=dict(salvage.counts),
        chunk_count=len(salvage.chunks),
        message_count=salvage.message_count,
        message_end_time=salvage.last,
        message_start_time=salvage.first,
        metadata_count=0,
        schema_count=len(salvage.schemas),
    )


def _packed(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())
