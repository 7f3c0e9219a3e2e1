"""The robot's messages as CDR, without ROS."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cache
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from nermo_description.parameters import RobotParameters
from nermo_hw.sample_topics import SAMPLE_TOPICS, fill
from nermo_hw.types import SensorSample

# The robot has no nermo_interfaces; a test holds these to the package's own files.
DEFINITIONS = {
    "nermo_interfaces/msg/ServoCommand": "std_msgs/Header header\nstring[] name\nfloat64[] position",
    "nermo_interfaces/msg/ServoStates": (
        "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] torque\n"
        "float64[] current"
    ),
    "nermo_interfaces/msg/Tactile": "std_msgs/Header header\nstring[] name\nfloat64[] voltage",
}


@cache
def types() -> Any:
    """The message types by name, and what reads and writes them."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for name, text in DEFINITIONS.items():
        store.register(get_types_from_msg(text, name))
    return store


def encode(message: Any) -> bytes:
    """A message as CDR."""
    return bytes(types().serialize_cdr(message, message.__msgtype__))


def decode_command(payload: bytes) -> tuple[int, Sequence[str], Sequence[float]]:
    """Stamp [ns], names and positions [rad] of a ServoCommand. Raises ValueError for anything else."""
    try:
        message = types().deserialize_cdr(payload, "nermo_interfaces/msg/ServoCommand")
        stamp = message.header.stamp
        return stamp.sec * 1_000_000_000 + stamp.nanosec, list(message.name), message.position.tolist()
    except Exception as error:  # generated readers fail in many ways on bytes that are no message
        raise ValueError(f"not a ServoCommand: {type(error).__name__}: {error}") from error


def decode_bool(payload: bytes) -> bool:
    """A std_msgs/Bool. Raises ValueError for anything else."""
    if len(payload) < 5 or payload[4] not in (0, 1):
        raise ValueError("not a Bool")
    return bool(payload[4])


def encode_command(stamp: int, names: Sequence[str], positions: Sequence[float]) -> bytes:
    """A ServoCommand."""
    return encode(_make("nermo_interfaces/msg/ServoCommand")(_header(stamp), list(names), np.asarray(positions, float)))


class SensorMessages:
    """What one sample of the device becomes, by topic: the messages of `sample_topics`."""

    def __init__(self, robot: RobotParameters) -> None:
        self._messages = {name: _blank(topic.type) for name, topic in SAMPLE_TOPICS.items()}
        for name, message in self._messages.items():
            fill(message, SAMPLE_TOPICS[name].fixed(robot))

    def of(self, sample: SensorSample, due: Callable[[str], bool] = lambda _: True) -> Iterator[tuple[str, bytes]]:
        """Topic and CDR of each message that is due, in the order of SAMPLE_TOPICS."""
        for name, topic in SAMPLE_TOPICS.items():
            if topic.said_with(sample) and due(name):
                message = self._messages[name]
                message.header = _header(sample.stamp, topic.frame)
                fill(message, topic.fields(sample))
                yield name, encode(message)


def encode_diagnostics(stamp: int, hardware_id: str, parts: Iterable[tuple[str, int, str, dict[str, object]]]) -> bytes:
    """A DiagnosticArray of (name, level, sentence, values)."""
    status, pair = _make("diagnostic_msgs/msg/DiagnosticStatus"), _make("diagnostic_msgs/msg/KeyValue")
    statuses = [
        status(level, name, sentence, hardware_id, [pair(key, str(value)) for key, value in values.items()])
        for name, level, sentence, values in parts
    ]
    return encode(_make("diagnostic_msgs/msg/DiagnosticArray")(_header(stamp), statuses))


def decode_diagnostics(payload: bytes) -> dict[str, dict[str, str]]:
    """Values of a DiagnosticArray by part, with its sentence as `message`."""
    array = types().deserialize_cdr(payload, "diagnostic_msgs/msg/DiagnosticArray")
    return {
        status.name: {"message": status.message, **{pair.key: pair.value for pair in status.values}}
        for status in array.status
    }


def _make(name: str) -> Any:
    return types().types[name]


def _header(stamp: int, frame: str = "") -> Any:
    seconds, nanoseconds = divmod(stamp, 1_000_000_000)
    return _make("std_msgs/msg/Header")(_make("builtin_interfaces/msg/Time")(seconds, nanoseconds), frame)


def _blank(name: str) -> Any:
    """A message whose numbers are zero and whose words and sequences are empty."""
    return _make(name)(*(_zero(kind) for _, kind in types().fielddefs[name][1]))


def _zero(kind: Any) -> Any:
    node, detail = kind
    if node is Nodetype.NAME:
        return _blank(detail)
    if node is Nodetype.BASE:
        return "" if detail[0] == "string" else 0
    (_, (base, _)), length = detail  # what an array or sequence is of; a sequence has no length
    return [] if base == "string" else np.zeros(length, base)
