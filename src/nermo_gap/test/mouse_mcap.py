"""Recordings of the mouse, written out for the tests."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from mcap.writer import Writer
from numpy.typing import NDArray
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from nermo_description.markers import MARKERS
from nermo_description.parameters import LEGS
from nermo_gap.robots.channels import TRACKER, command, encoder, marker, position

Array = NDArray[np.float64]
ROOT = Path(__file__).resolve().parents[3]


def write_mcap(
    path: Path,
    columns: dict[str, Array],
    servos: list[str],
    joint_every: int = 4,
    tracker: str = "",
    variance: Sequence[float] = (0.0,) * 6,
) -> None:
    """A recording as the graph's recorder makes it, of the channels of a table.

    The pose stands on a topic ``tracker``, which says ``variance`` of its place and turns.
    """
    types = get_typestore(Stores.ROS2_HUMBLE)
    for name in ("ServoCommand", "ServoStates"):
        text = (ROOT / "src/nermo_interfaces/msg" / f"{name}.msg").read_text(encoding="utf-8")
        types.register(get_types_from_msg(text, f"nermo_interfaces/msg/{name}"))
    make = types.types
    time_type, header_type = make["builtin_interfaces/msg/Time"], make["std_msgs/msg/Header"]

    def header(stamp: int) -> object:
        return header_type(time_type(stamp // 10**9, stamp % 10**9), "")

    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2", library="test")
        channels: dict[str, int] = {}

        def write(topic: str, kind: str, message: object, stamp: int) -> None:
            if topic not in channels:
                text = types.generate_msgdef(kind, ros_version=2)[0]
                schema = writer.register_schema(kind, "ros2msg", text.encode())
                channels[topic] = writer.register_channel(f"/nermo/{topic}", "cdr", schema)
            data = bytes(types.serialize_cdr(message, kind))
            writer.add_message(channels[topic], log_time=stamp, publish_time=stamp, data=data)

        none = np.zeros(0)
        for row, t in enumerate(columns["t"]):
            stamp = 1_000_000_000 + round(float(t) * 1e9)

            def values(names: list[str], at: int = row) -> Array:
                return np.array([columns[n][at] for n in names])

            states = make["nermo_interfaces/msg/ServoStates"](
                header(stamp), servos[::-1], values([position(s) for s in servos[::-1]]), none, none, none
            )
            write("servo_states", "nermo_interfaces/msg/ServoStates", states, stamp)
            told = make["nermo_interfaces/msg/ServoCommand"](
                header(stamp), servos, values([command(s) for s in servos])
            )
            write("servo_command", "nermo_interfaces/msg/ServoCommand", told, stamp + 1)
            if row % joint_every == 0:
                knees = [f"{leg}_knee_joint" for leg in LEGS]
                joints = make["sensor_msgs/msg/JointState"](
                    header(stamp), knees, values([encoder(leg) for leg in LEGS]), none, none
                )
                write("joint_states", "sensor_msgs/msg/JointState", joints, stamp)
            if tracker:
                pose = make["geometry_msgs/msg/Pose"](
                    make["geometry_msgs/msg/Point"](*values(list(TRACKER[:3]))),
                    make["geometry_msgs/msg/Quaternion"](*values([*TRACKER[4:], TRACKER[3]])),
                )
                still = make["geometry_msgs/msg/Twist"](*[make["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0)] * 2)
                odometry = make["nav_msgs/msg/Odometry"](
                    header(stamp),
                    "base_link",
                    make["geometry_msgs/msg/PoseWithCovariance"](pose, np.diag(variance).ravel()),
                    make["geometry_msgs/msg/TwistWithCovariance"](still, np.zeros(36)),
                )
                write(tracker, "nav_msgs/msg/Odometry", odometry, stamp)
            for place in (p for p in MARKERS if marker(p)[0] in columns and not np.isnan(columns[marker(p)[0]][row])):
                seen = make["geometry_msgs/msg/Point"](*values(list(marker(place))))
                point = make["geometry_msgs/msg/PointStamped"](header(stamp), seen)
                write(f"tracker/markers/{place}", "geometry_msgs/msg/PointStamped", point, stamp)
        writer.finish()
