"""Files that another process is still writing: what has come since one last looked, as columns of numbers."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from simgap.data.bag import MessageColumns, is_bag
from simgap.data.errors import GapInputError, nearest
from simgap.data.mapping import Map
from simgap.data.tables import delimiter, numbers
from simgap.data.units import factor

Array = NDArray[np.float64]

BLOCK = 1 << 20
"""Bytes that are read at once; of a file that has long been written, one block after the other."""
_MAGIC, _FOOTER = b"\x89MCAP0\r\n", 2
_FRAME = 9
"""Bytes before the content of a record of MCAP: what it is, and its length."""


class Growing(Protocol):
    """A file that grows."""

    def read(self, keep: float) -> dict[str, Array] | None:
        """Columns of the last ``keep`` seconds before what is new, and of what is new; None where nothing is.

        Raises:
            GapInputError: what was written cannot be used.
        """


def follow(path: Path, mapping: Map) -> Growing:
    """The file that a recording is being written to: a CSV, or a bag of MCAP.

    Raises:
        GapInputError: there is no such file, the map is for the other kind, or its kind cannot be read while it grows.
    """
    if path.is_dir():
        found = sorted(path.glob("*.mcap"))
        if not found:
            raise GapInputError(f"{path}: holds no .mcap yet; start the recorder first, with MCAP as its storage")
        path = found[-1]
    if not path.exists():
        raise GapInputError(f"{path}: no such recording; start what writes it first")
    if path.suffix.lower() == ".mcap":
        return GrowingMcap(path, mapping)
    if path.suffix.lower() == ".csv":
        return GrowingCsv(path, mapping)
    kind = "a bag that is no MCAP" if is_bag(path) else f"{path.suffix or 'a file without extension'}"
    raise GapInputError(f"{path}: only .csv and .mcap can be read while they are written, not {kind}")


class _Tail:
    """Bytes of a file beyond those that were read."""

    def __init__(self, path: Path) -> None:
        self._path, self._at = path, 0

    def read(self) -> bytes:
        """The next block, empty where nothing new was written."""
        try:
            with self._path.open("rb") as file:
                if file.seek(0, io.SEEK_END) < self._at:
                    raise GapInputError(f"{self._path}: became shorter while it was followed; start the monitor anew")
                file.seek(self._at)
                block = file.read(BLOCK)
        except OSError as error:
            raise GapInputError(f"{self._path}: cannot be read ({error.strerror})") from error
        self._at += len(block)
        return block


class GrowingCsv:
    """The columns of a growing CSV that a map names. A row counts when its line is complete."""

    def __init__(self, path: Path, mapping: Map) -> None:
        if mapping.of_bag:
            raise GapInputError(f"{mapping.source}: its rows name topics of a bag, but {path} is no bag (.mcap)")
        self._path, self._map = path, mapping
        self._tail, self._left = _Tail(path), b""
        self._header: list[str] = []
        self._between, self._rows = ",", 1
        self._columns: dict[str, Array] = {}
        self._seconds = factor(mapping.time.unit, ("time",), f"{mapping.source}: time ({mapping.time.column})")[0]
        self._wanted = {mapping.time.column: "time", **{row.column: place for place, row in mapping.channels.items()}}

    def read(self, keep: float) -> dict[str, Array] | None:
        """See Growing."""
        block = self._tail.read()
        complete, newline, self._left = (self._left + block).rpartition(b"\n")
        if not newline:
            return None
        try:
            lines = complete.decode("utf-8-sig" if not self._header else "utf-8").splitlines()
        except UnicodeDecodeError as error:
            raise GapInputError(f"{self._path}: is no text in UTF-8 ({error.reason})") from error
        if not self._header:
            self._take_header(lines.pop(0))
        rows = [row for row in csv.reader(lines, delimiter=self._between) if row]
        if not rows:
            return None
        new = {name: self._cells(rows, name) for name in self._wanted}
        self._rows += len(rows)
        old = self._recent(keep)
        self._columns = {name: np.concatenate([old[name], v]) if old else v for name, v in new.items()}
        return self._columns

    def _recent(self, keep: float) -> dict[str, Array]:
        """What was read before, but for what is older than ``keep`` seconds."""
        if not self._columns:
            return {}
        time = self._columns[self._map.time.column]
        recent = np.flatnonzero(self._seconds * (np.nanmax(time) - time) <= keep)
        first = int(recent[0]) if len(recent) else len(time)
        return {name: values[first:] for name, values in self._columns.items()}

    def _take_header(self, line: str) -> None:
        self._between = delimiter(line)
        self._header = [name.strip() for name in next(csv.reader([line], delimiter=self._between), [])]
        for name, place in self._wanted.items():
            if name not in self._header:
                raise GapInputError(
                    f"{self._path}: {place}: no column {name!r} in the table; {nearest(name, self._header, 'column')}"
                )

    def _cells(self, rows: list[list[str]], name: str) -> Array:
        place = self._header.index(name)
        wrong = next((i for i, row in enumerate(rows) if len(row) != len(self._header)), None)
        if wrong is not None:
            raise GapInputError(
                f"{self._path}: row {self._rows + wrong + 1} has {len(rows[wrong])} cells where the header has "
                f"{len(self._header)}; is it one process that writes this file?"
            )
        values = numbers([row[place] for row in rows], f"{self._path}: column {name!r}", self._rows + 1)
        if values.dtype.kind not in "biuf":
            raise GapInputError(
                f"{self._path}: column {name!r}: row {self._rows + 1} holds {str(values[0])!r}, no number"
            )
        return values.astype(np.float64)


class GrowingMcap:
    """The channels of a growing MCAP that a map names. Who writes it in chunks is seen chunk by chunk."""

    def __init__(self, path: Path, mapping: Map) -> None:
        try:
            import mcap.stream_reader  # noqa: F401
            import rosbags  # noqa: F401
        except ImportError as error:
            raise GapInputError(f"{path}: bags need two packages more: pip install 'simgap[bags]'") from error
        from rosbags.typesys import Stores, get_typestore

        self._path, self._tail, self._left = path, _Tail(path), b""
        self._gathered = MessageColumns(mapping, str(path))
        self._types = get_typestore(Stores.EMPTY)
        self._schemas: dict[int, Any] = {}
        self._channels: dict[int, tuple[str, str]] = {}
        self._begun = False

    def read(self, keep: float) -> dict[str, Array] | None:
        """See Growing."""
        from mcap.records import Channel, Message, Schema

        self._gathered.forget(keep)
        came = False
        for record in self._records():
            if isinstance(record, Schema):
                self._schemas[record.id] = record
            elif isinstance(record, Channel) and record.topic in self._gathered.topics:
                self._register(record)
            elif isinstance(record, Message) and record.channel_id in self._channels:
                topic, kind = self._channels[record.channel_id]
                self._gathered.take(topic, record.log_time, self._decode(record.data, kind))
                came = True
        return self._gathered.columns()[0] if came and not self._gathered.silent else None

    def _records(self) -> Iterator[Any]:
        """Records that are complete by now; the rest waits."""
        from mcap.exceptions import McapError
        from mcap.stream_reader import StreamReader

        data = self._left + self._tail.read()
        at = 0
        if not self._begun:
            if len(data) < len(_MAGIC):
                self._left = data
                return
            if not data.startswith(_MAGIC):
                raise GapInputError(
                    f"{self._path}: is no MCAP; a bag of SQLite (.db3) cannot be read while it is written"
                )
            at, self._begun = len(_MAGIC), True
        end = start = at
        while end + _FRAME <= len(data) and data[end] != _FOOTER:
            length = int.from_bytes(data[end + 1 : end + _FRAME], "little")
            if end + _FRAME + length > len(data):
                break
            end += _FRAME + length
        self._left = data[end:]
        try:
            yield from _until_end(StreamReader(io.BytesIO(data[start:end]), skip_magic=True))
        except (McapError, ValueError) as error:
            raise GapInputError(f"{self._path}: cannot read the bag ({' '.join(str(error).split())[:160]})") from error

    def _register(self, channel: Any) -> None:
        """Learn the message type of a channel from its definition in the file."""
        from rosbags.typesys import get_types_from_idl, get_types_from_msg

        if channel.id in self._channels:
            return
        schema = self._schemas.get(channel.schema_id)
        if schema is None or not schema.data:
            raise GapInputError(f"{self._path}: topic {channel.topic!r}: the bag holds no definition of its messages")
        text = schema.data.decode("utf-8", "replace")
        try:
            if schema.encoding == "ros2idl":
                parts = text.split("=" * 80 + "\n")
                types: Any = {}
                for part in parts:
                    types |= get_types_from_idl(part.split("\n", 1)[1] if part.startswith("IDL: ") else part)
            else:
                types = get_types_from_msg(text, schema.name)
            self._types.register(types)
        except Exception as error:  # what its parser raises has no common base
            raise GapInputError(
                f"{self._path}: topic {channel.topic!r}: the definition of {schema.name} cannot be read "
                f"({' '.join(str(error).split())[:120]})"
            ) from error
        self._channels[channel.id] = channel.topic, schema.name

    def _decode(self, data: bytes, kind: str) -> Any:
        try:
            return self._types.deserialize_cdr(data, kind)
        except Exception as error:  # as above
            raise GapInputError(
                f"{self._path}: a message of type {kind} cannot be decoded ({' '.join(str(error).split())[:120]})"
            ) from error


def _until_end(reader: Any) -> Iterator[Any]:
    """All records of a stream that has no footer."""
    from mcap.exceptions import EndOfFile

    records = reader.records
    while True:
        try:
            yield next(records)
        except (EndOfFile, StopIteration):
            return
