"""Bags of ROS 2 (and ROS 1) as columns of numbers, without ROS: `.mcap`, `.db3`, `.bag`, compressed or not.

A message is read by the definition that the bag holds of it, so that a message of nobody else's is read too.
"""

from __future__ import annotations

import bisect
import contextlib
import dataclasses
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from simgap.data.errors import GapInputError, nearest
from simgap.data.formats import BAGS
from simgap.data.mapping import BAG_TIME, ChannelRow, Map
from simgap.data.plant import euler_angles

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Names = dict[int, tuple[Any, list[str] | None]]
"""What parts of a message call the elements of their arrays, by id; the parts too, so that no id is given twice."""

_CLOCKS_APART = 0.05
"""[s] A recorder gets a message later than this after its stamp, or before it, only where clocks differ."""
_FIELDS: dict[type, tuple[str, ...]] = {}
"""Fields of each type of message met so far: a bag holds many of few."""
_NAMES = ("name", "joint_names", "names", "interface_names")
"""Fields that name the elements of the arrays beside them."""
_EULER = ("roll", "pitch", "yaw")


@dataclass(frozen=True)
class Topic:
    """What a bag holds of one topic: message type, number of messages, and the fields of its first one.

    ``fields`` are the paths that a map may name, each with the names of its elements, their number, or None of one
    number.
    """

    name: str
    type: str
    count: int
    fields: dict[str, list[str] | int | None] = field(default_factory=dict)


def is_bag(path: Path) -> bool:
    """Whether a path is a bag: a file by its ending, or a folder with a metadata.yaml or one such file."""
    if path.is_dir():
        return (path / "metadata.yaml").is_file() or len(_files(path)) == 1
    return path.suffix.lower() in BAGS


def read_bag(path: Path, mapping: Map, hollow: bool = False) -> tuple[dict[str, Array], list[str]]:
    """The channels that a map names, as `MessageColumns` gives them; ``hollow``: without those that hold no number.

    Returns:
        (columns, among them BAG_TIME [s] from the first stamp on; warnings)

    Raises:
        GapInputError: the bag cannot be read, or lacks a topic, a field, an element or a stamp that the map names.
    """
    gathered = MessageColumns(mapping, str(path))
    with _open(path) as reader:
        found = {c.topic: c for c in reader.connections}
        gathered.check_topics(found)
        wanted = [c for c in reader.connections if c.topic in gathered.topics]
        for connection, log_time, raw in reader.messages(wanted):
            gathered.take(connection.topic, log_time, _decode(reader, raw, connection.msgtype, path))
    for topic in gathered.silent:
        raise GapInputError(f"{path}: topic {topic!r} holds no messages")
    return gathered.columns(hollow)


class MessageColumns:
    """The channels that a map names, gathered message by message, from a bag or as they come.

    Messages are those of rosbags or of ROS itself. Time is their own stamps where all have one, else when they were
    received (see `TimeRow.clock`). The points of a trajectory are samples at the times that they are for; a newer
    trajectory replaces what lies ahead of an older.

    Raises:
        GapInputError: the map's rows name columns of a table.
    """

    def __init__(self, mapping: Map, source: str) -> None:
        if not mapping.of_bag:
            raise GapInputError(
                f"{mapping.source}: {source} is a bag, whose rows name topic and field instead of column"
            )
        self._mapping, self._source, self._rows = mapping, source, mapping.channels
        self._series = {place: _Series(row, f"{source}: {place} ({row.column})") for place, row in self._rows.items()}
        self._received: dict[str, list[int]] = {str(row.topic): [] for row in self._rows.values()}
        self._stamped: dict[str, list[int]] = {topic: [] for topic in self._received}
        self._origin: int | None = None

    @property
    def topics(self) -> list[str]:
        """Topics that the map names."""
        return list(self._received)

    @property
    def silent(self) -> list[str]:
        """Topics of which no message has come."""
        return [topic for topic, times in self._received.items() if not times]

    def check_topics(self, known: Iterable[str]) -> None:
        """Raises GapInputError where a topic of the map is not among the known ones."""
        known = list(known)
        for place, row in self._rows.items():
            if row.topic not in known:
                raise GapInputError(
                    f"{self._source}: {place}: no topic {row.topic!r}; {nearest(str(row.topic), known, 'topic')}"
                )

    def take(self, topic: str, received: int, message: Any) -> None:
        """The next message of a topic, and when it was received [ns].

        Raises:
            GapInputError: it lacks a field or an element that the map names.
        """
        mine = [one for one in self._series.values() if one.row.topic == topic]
        names: Names = {}
        # All are read before any is kept, so that what is refused leaves no trace.
        for one, values in [(one, one.read(message, names)) for one in mine]:
            one.keep(values)
        self._received[topic].append(received)
        self._stamped[topic].append(_stamp(message))

    def forget(self, seconds: float) -> None:
        """Forget all but the messages that were received in the last ``seconds``."""
        newest = max((times[-1] for times in self._received.values() if times), default=0)
        for topic, times in self._received.items():
            old = bisect.bisect_left(times, newest - round(1e9 * seconds))
            del times[:old], self._stamped[topic][:old]
            for one in self._series.values():
                if one.row.topic == topic:
                    one.forget(old)

    def columns(self, hollow: bool = False) -> tuple[dict[str, Array], list[str]]:
        """Columns on the stamps of all channels together, NaN where a channel has no sample; and warnings.

        With ``hollow``, a channel that holds no finite number is left out.

        BAG_TIME [s] is among them, counted from the first stamp that this was called with.

        Raises:
            GapInputError: a channel holds no finite number, or the messages lack the stamps that the map asks for.
        """
        warnings: list[str] = []
        clocks = _clock(self._mapping, self._received, self._stamped, self._source, warnings)
        samples = {
            place: one.samples(np.array(clocks[str(one.row.topic)], np.int64))
            for place, one in self._series.items()
            if not hollow or one.holds_numbers
        }
        grid: Ints = np.unique(np.concatenate([stamps for stamps, _ in samples.values()]))
        self._origin = int(grid[0]) if self._origin is None else self._origin
        columns = {BAG_TIME: (grid - self._origin) / 1e9}
        for place, (stamps, values) in samples.items():
            column = np.full(len(grid), np.nan)
            column[np.searchsorted(grid, stamps)] = values
            columns[self._rows[place].column] = column
        return columns, warnings


def topics(path: Path) -> list[Topic]:
    """What a bag holds, topic by topic.

    Raises:
        GapInputError: the bag cannot be read.
    """
    with _open(path) as reader:
        counts = {name: info.msgcount for name, info in reader.topics.items()}
        first: dict[str, Topic] = {}
        for connection, _, raw in reader.messages():
            if connection.topic not in first:
                message = _decode(reader, raw, connection.msgtype, path)
                first[connection.topic] = Topic(
                    connection.topic, connection.msgtype, counts[connection.topic], _fields(message)
                )
                if len(first) == sum(count > 0 for count in counts.values()):
                    break
    return [first[name] for name in sorted(first)]


def _files(folder: Path) -> list[Path]:
    return [file for file in sorted(folder.iterdir()) if file.suffix.lower() in BAGS]


@contextlib.contextmanager
def _open(path: Path) -> Iterator[AnyReader]:
    try:
        from rosbags.highlevel import AnyReader, AnyReaderError
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise GapInputError(f"{path}: bags need one package more: pip install 'simgap[bags]'") from error
    if not path.exists():
        raise GapInputError(f"{path}: no such recording")
    if path.is_dir() and not (path / "metadata.yaml").is_file():
        (path,) = _files(path)
    elif path.is_file() and (path.parent / "metadata.yaml").is_file() and _files(path.parent) == [path]:
        # How its messages are compressed stands there alone.
        path = path.parent
    try:
        # Bags of ROS 2 before Iron hold no definitions: those of the messages that everybody has stand in for them.
        with AnyReader([path], default_typestore=get_typestore(Stores.LATEST)) as reader:
            yield reader
    except GapInputError:
        raise
    except AnyReaderError as error:
        raise GapInputError(_unreadable(path, error)) from error
    except Exception as error:
        # A damaged bag makes its reader, its decompressor or its database raise whatever they run into.
        raise GapInputError(_unreadable(path, error)) from error


def _unreadable(path: Path, error: Exception) -> str:
    reason = " ".join(str(error).split())[:160] or type(error).__name__
    return (
        f"{path}: cannot read the bag ({reason}); if it was cut off while it was recorded, `mcap recover` or "
        "`ros2 bag reindex` mends it"
    )


def _decode(reader: AnyReader, raw: bytes, kind: str, path: Path) -> Any:
    try:
        return reader.deserialize(raw, kind)
    except Exception as error:
        raise GapInputError(
            f"{path}: a message of type {kind} cannot be decoded ({' '.join(str(error).split())[:120]}); "
            "the bag holds no definition of it, or is damaged"
        ) from error


def _stamp(message: Any) -> int:
    """Stamp of a message's header [ns], 0 where there is none."""
    stamp = getattr(getattr(message, "header", None), "stamp", None)
    return 0 if stamp is None else int(stamp.sec) * 10**9 + int(stamp.nanosec)


def _clock(
    mapping: Map,
    received: dict[str, list[int]],
    stamped: dict[str, list[int]],
    source: str,
    warnings: list[str],
) -> dict[str, list[int]]:
    """Times [ns] of each topic's messages by the clock that the map asks for, or the best that all topics have."""
    bare = sorted(topic for topic, times in stamped.items() if not all(times))
    if mapping.time.clock == "header" and bare:
        raise GapInputError(
            f"{source}: time.clock: messages of {bare[0]} have no stamp; the clock can only be received"
        )
    if mapping.time.clock == "received" or bare:
        if bare and len(bare) < len(stamped) and mapping.time.clock is None:
            warnings.append(
                f"messages of {', '.join(bare)} have no stamp, so that all topics are timed by when they were received"
            )
        return received
    late = {t: float(np.median(np.subtract(received[t], stamped[t]))) / 1e9 for t in stamped}
    if len(late) > 1 and max(late.values()) - min(late.values()) > _CLOCKS_APART:
        first, last = min(late, key=late.__getitem__), max(late, key=late.__getitem__)
        warnings.append(
            f"stamps of {last} are {late[last] - late[first]:.3g} s older when received than those of {first}: "
            "two clocks, or a slow way; `time: {clock: received}` uses the recorder's"
        )
    return stamped


class _Series:
    """One channel as it is read: a value, or the points of a trajectory, for each message."""

    def __init__(self, row: ChannelRow, where: str) -> None:
        self.row, self._where = row, where
        self._component = getattr(row, "component", None)
        self._values: list[list[tuple[int, float]]] = []
        """For each message, (ns after its stamp, value)."""
        self._any = False
        self._parts = [self._part(text) for text in str(row.field).split(".")]

    def read(self, message: Any, names: Names) -> list[tuple[int, float]]:
        """(ns after its stamp, value) of the channel in a message; ``names`` is what its channels have in common."""
        return self._walk(message, 0, message, 0, names)

    def keep(self, values: list[tuple[int, float]]) -> None:
        """What `read` found in the next message."""
        self._values.append(values)
        self._any = True

    def forget(self, count: int) -> None:
        """Forget the first messages."""
        del self._values[:count]

    @property
    def holds_numbers(self) -> bool:
        """Whether any of its values is finite."""
        return any(np.isfinite(value) for values in self._values for _, value in values)

    def samples(self, times: Ints) -> tuple[Ints, Array]:
        """(stamps [ns], ascending and each once; values) where the messages' own times are ``times``."""
        order = np.argsort(times, kind="stable")
        stamps: list[int] = []
        values: list[float] = []
        for i in order:
            points = [(int(times[i]) + after, value) for after, value in self._values[i] if np.isfinite(value)]
            # What an older trajectory still had ahead, this message replaces.
            while stamps and points and stamps[-1] >= points[0][0]:
                stamps.pop()
                values.pop()
            for at, value in sorted(points):
                if not stamps or at > stamps[-1]:
                    stamps.append(at)
                    values.append(value)
        if not stamps:
            raise GapInputError(f"{self._where}: no message holds a finite number there")
        return np.array(stamps, np.int64), np.array(values)

    def _part(self, text: str) -> tuple[str, int | None]:
        match = re.fullmatch(r"(\w+)(?:\[(\d+)\])?", text)
        if match is None:
            raise GapInputError(f"{self._where}: field: {text!r} is no name of a field, such as position or points[0]")
        return match[1], None if match[2] is None else int(match[2])

    def _walk(self, at: Any, depth: int, parent: Any, after: int, seen: Names) -> list[tuple[int, float]]:
        """(ns after the message's stamp, value) of all that the path leads to from ``at``, its ``depth`` parts done."""
        if depth == len(self._parts):
            value = self._number(at, parent, seen)
            return [(after, value)]
        name, index = self._parts[depth]
        names = _message_fields(at)
        if name not in names:
            raise GapInputError(f"{self._where}: the message has no field {name!r}; {nearest(name, names, 'field')}")
        inner = getattr(at, name)
        if index is not None:
            if not hasattr(inner, "__len__") or index >= len(inner):
                raise GapInputError(f"{self._where}: field {name!r} has no element {index}")
            inner = inner[index]
        holder = at if _names_of(at, seen) is not None else parent
        if isinstance(inner, list | tuple) and inner and _message_fields(inner[0]):
            if not hasattr(inner[0], "time_from_start"):
                raise GapInputError(f"{self._where}: field {name!r} is a list of messages; say which, as in {name}[0]")
            found = []
            for point in inner:
                found += self._walk(point, depth + 1, holder, after + _duration(point.time_from_start), seen)
            return found
        if isinstance(inner, list | tuple) and not inner and depth + 1 < len(self._parts):
            return []
        return self._walk(inner, depth + 1, holder, after, seen)

    def _number(self, value: Any, holder: Any, seen: Names) -> float:
        """The number that the row means of what its field holds."""
        element = self.row.element
        if isinstance(value, bool | int | float | np.number | np.bool_):
            return float(value)
        if _message_fields(value):
            return self._component_of(value)
        if isinstance(value, str) or not hasattr(value, "__len__"):
            raise GapInputError(f"{self._where}: the field holds {type(value).__name__}, not numbers")
        names = _names_of(holder, seen)
        if isinstance(element, str) and names is not None:
            if element not in names:
                if not self._any and len(names) == len(value):
                    raise GapInputError(
                        f"{self._where}: the first message has no {element!r}; {nearest(element, names, 'name')} "
                        "(`named` says what the message calls it)"
                    )
                return np.nan
            position = names.index(element)
            return float(value[position]) if position < len(value) else np.nan
        if isinstance(element, int):
            if element >= len(value):
                raise GapInputError(f"{self._where}: index {element} is beyond the {len(value)} elements of the field")
            return float(value[element])
        if len(value) == 1 and element is None:
            return float(value[0])
        hint = f"named: one of {', '.join(names[:12])}" if names else f"index: 0 to {len(value) - 1}"
        raise GapInputError(f"{self._where}: the field is an array of {len(value)}; say which element ({hint})")

    def _component_of(self, value: Any) -> float:
        names = _message_fields(value)
        if self._component in names:
            return float(getattr(value, self._component))
        if self._component in _EULER and {"w", "x", "y", "z"} <= set(names):
            angles = euler_angles(np.array([value.w, value.x, value.y, value.z]))
            return float(angles[_EULER.index(self._component)])
        raise GapInputError(
            f"{self._where}: the field is a message with {', '.join(names)}; name one of them, "
            f"as in {self.row.field}.{names[0]}"
        )


def _message_fields(value: Any) -> tuple[str, ...]:
    """Names of a message's fields, none of what is no message."""
    kind = type(value)
    if kind not in _FIELDS:
        _FIELDS[kind] = _fields_of(kind)
    return _FIELDS[kind]


def _fields_of(kind: type) -> tuple[str, ...]:
    if hasattr(kind, "get_fields_and_field_types"):  # a message of ROS itself
        return tuple(kind.get_fields_and_field_types())
    if not dataclasses.is_dataclass(kind):
        return ()
    return tuple(f.name for f in dataclasses.fields(kind) if not f.name.startswith("__"))


def _names_of(message: Any, seen: Names) -> list[str] | None:
    """Names of the elements of a message's arrays, where it says them; ``seen`` keeps those of one message."""
    if id(message) not in seen:
        seen[id(message)] = message, _find_names(message)
    return seen[id(message)][1]


def _find_names(message: Any) -> list[str] | None:
    for name in _NAMES:
        names = getattr(message, name, None)
        if isinstance(names, list | tuple) and names and all(isinstance(n, str) for n in names):
            return list(names)
    return None


def _duration(value: Any) -> int:
    """A duration [ns]."""
    return int(value.sec) * 10**9 + int(value.nanosec)


def _fields(message: Any, prefix: str = "", names: Sequence[str] | None = None) -> dict[str, list[str] | int | None]:
    """Paths of all numbers of a message; see `Topic.fields`."""
    found: dict[str, list[str] | int | None] = {}
    names = _find_names(message) or names
    for name in _message_fields(message):
        value, path = getattr(message, name), f"{prefix}{name}"
        # A name in capitals is a constant of the message's type.
        if name in ("header", "time_from_start") or isinstance(value, str) or name.isupper():
            continue
        if isinstance(value, bool | int | float | np.number | np.bool_):
            found[path] = None
        elif _message_fields(value):
            found |= _fields(value, f"{path}.", names)
        elif isinstance(value, list | tuple) and value and _message_fields(value[0]):
            timed = hasattr(value[0], "time_from_start")
            found |= _fields(value[0], f"{path}." if timed else f"{path}[0].", names)
        elif hasattr(value, "__len__") and len(value) and not isinstance(value[0], str):
            found[path] = list(names) if names is not None and len(names) == len(value) else len(value)
    return found
