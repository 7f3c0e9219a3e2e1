"""What a bench's mouse was told, as a recorder would have left it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from ament_index_python.packages import get_package_share_directory
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from nermo_track.bench.walk import Walk

START = 1_700_000_000 * 10**9
"""[ns] Stamp of the first command."""
LOGGED = 2_000_000
"""[ns] From a command's stamp until it is logged."""


def write_commands(walked: Walk, servos: Sequence[str], path: Path) -> Path:
    """Write a recording of what servos were told in a walk, and of nothing that was measured; returns ``path``."""
    name = "nermo_interfaces/msg/ServoCommand"
    store = get_typestore(Stores.ROS2_KILTED)
    text = Path(get_package_share_directory("nermo_interfaces"), "msg", "ServoCommand.msg").read_text("utf-8")
    store.register(get_types_from_msg(text, name))
    time, header = store.types["builtin_interfaces/msg/Time"], store.types["std_msgs/msg/Header"]
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/nermo/servo_command", name, typestore=store)
        for now, told in zip(walked.time, walked.command, strict=True):
            stamp = START + round(now * 1e9)
            head = header(time(stamp // 10**9, stamp % 10**9), "")
            message = store.types[name](head, list(servos), np.ascontiguousarray(told))
            writer.write(connection, stamp + LOGGED, store.serialize_cdr(message, name))
    return path
