"""A recording of the graph (MCAP) as a table of the mouse's channels."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nermo_description.markers import MARKER_TOPIC, MARKERS
from nermo_description.parameters import LEGS, RobotParameters
from nermo_gap.robots.channels import (
    GYRO,
    TRACKER,
    command,
    encoder,
    leg_servos,
    marker,
    phase,
    position,
    said,
    torque,
)
from nermo_node.recording_reader import Recording, RecordingError, TopicData
from simgap.data.errors import GapInputError, nearest

Array = NDArray[np.float64]

TRACKERS = ("tracker/odom", "truth/odom")
"""Topics with the pose of base_link as an outside tracker sees it, the first that is recorded. A simulation's truth
stands in for the tracker; nothing else of it is read."""


def recorded_robot(path: Path) -> str | None:
    """Name of the robot that a recording says it is of, or None.

    Raises:
        GapInputError: the recording cannot be read.
    """
    try:
        recording = Recording(path)
        for name in recording.topics:
            if name.endswith("/robot_parameters"):
                return str(recording.read([name])[name]["robot"][-1])
    except RecordingError as error:
        raise GapInputError(str(error)) from error
    return None


def mcap_table(path: Path, robot: RobotParameters, begun: int | None = None) -> dict[str, Array]:
    """Columns of a recording on the stamps of its servo commands; NaN where a channel has no sample there.

    Time is the headers' ROS time, counted from the stamp ``begun`` [ns], else from the first command. Messages arrive
    in any order.

    Raises:
        GapInputError: the recording cannot be read, commands no servo of this robot, or measures nothing.
    """
    try:
        recording = Recording(path)
        return _table(recording, robot, begun)
    except RecordingError as error:
        raise GapInputError(str(error)) from error


def _table(recording: Recording, robot: RobotParameters, begun: int | None) -> dict[str, Array]:
    topics = {name: _topic(recording, name) for name in ("servo_command", "servo_states", "joint_states", "leg_states")}
    topics["imu"] = _topic(recording, "imu/data_raw")
    topics["tracker"] = next((t for t in (_topic(recording, n) for n in TRACKERS) if t is not None), None)
    commands = topics["servo_command"]
    if commands is None or len(commands) < 2:
        raise GapInputError(f"{recording.path}: servo_command: not recorded, and without it a replay would be a guess")
    if topics["servo_states"] is None and topics["tracker"] is None and topics["imu"] is None:
        raise GapInputError(f"{recording.path}: nothing measured is recorded (servo_states, imu/data_raw, truth/odom)")
    _check_names(recording, commands, robot)
    stamps = np.unique(commands.stamp)
    table: dict[str, Array] = {"t": (stamps - (stamps[0] if begun is None else begun)) * 1e-9}

    def put(topic: TopicData, names: list[str], values: Array) -> None:
        rows, found = _rows(stamps, topic.stamp)
        for name, column in zip(names, values.T, strict=True):
            if np.isfinite(column).any():
                table[name] = np.full(len(stamps), np.nan)
                table[name][rows] = column[found]

    servos, measured = list(robot.servos), leg_servos(robot)
    put(commands, [command(s) for s in servos], commands.by_name("position", servos))
    if (states := topics["servo_states"]) is not None:
        put(states, [position(s) for s in measured], states.by_name("position", measured))
        put(states, [torque(s) for s in measured], states.by_name("torque", measured))
    if (joints := topics["joint_states"]) is not None:
        put(joints, [encoder(leg) for leg in LEGS], joints.by_name("position", [f"{leg}_knee_joint" for leg in LEGS]))
    if (imu := topics["imu"]) is not None:
        put(imu, list(GYRO), np.column_stack([imu[f"angular_velocity.{axis}"] for axis in "xyz"]))
    if (tracker := topics["tracker"]) is not None:
        pose = [tracker[f"pose.pose.position.{axis}"] for axis in "xyz"]
        pose += [tracker[f"pose.pose.orientation.{part}"] for part in "wxyz"]
        put(tracker, list(TRACKER), np.column_stack(pose))
        put(tracker, [said(column) for column in TRACKER], _said(tracker))
    for place in MARKERS:
        if (seen := _topic(recording, MARKER_TOPIC.format(place=place))) is not None:
            columns, bare = list(marker(place)), "point.x" in seen.columns
            where = "point" if bare else "pose.pose.position"
            put(seen, columns, np.column_stack([seen[f"{where}.{axis}"] for axis in "xyz"]))
            if not bare:
                put(seen, [said(column) for column in columns], _said(seen)[:, :3])
    if (legs := topics["leg_states"]) is not None:
        put(legs, [phase(leg) for leg in LEGS], np.asarray(legs["phases"], dtype=np.float64))
    return table


def _said(tracker: TopicData) -> Array:
    """(n, 7) standard deviations of poses by their covariances: place [m] and quaternion; NaN where none is said."""
    variance = np.asarray(tracker["pose.covariance"], dtype=np.float64).reshape(-1, 6, 6).diagonal(axis1=1, axis2=2)
    variance = np.where((variance > 0.0) & np.isfinite(variance), variance, np.nan)
    # A quaternion turns by half the angle.
    turn = 0.5 * np.sqrt(variance[:, 3:].mean(axis=1, keepdims=True))
    return np.hstack([np.sqrt(variance[:, :3]), np.repeat(turn, 4, axis=1)])


def _topic(recording: Recording, name: str) -> TopicData | None:
    """A topic by the end of its name, or None where it is not recorded."""
    ends = [topic for topic in recording.topics if topic == f"/{name}" or topic.endswith(f"/{name}")]
    if not ends:
        return None
    shortest = min(ends, key=lambda topic: (topic.count("/"), topic))
    data = recording.read([shortest])[shortest]
    return data if len(data) else None


def _check_names(recording: Recording, commands: TopicData, robot: RobotParameters) -> None:
    present = set(commands["name"][0])
    lacking = [s for s in robot.servos if s not in present]
    if lacking:
        raise GapInputError(
            f"{recording.path}: servo_command: does not command {lacking[0]} of {robot.name}; "
            f"is it a recording of another robot (--robot)? {nearest(lacking[0], sorted(present), 'servo')}"
        )
    unknown = sorted(present - set(robot.servos))
    if unknown:
        raise GapInputError(
            f"{recording.path}: servo_command: commands {unknown[0]}, which {robot.name} has not; "
            "it is a recording of another robot (--robot)"
        )


def _rows(grid: NDArray[np.int64], stamps: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows of the grid nearest to stamps, and which stamps they are; those farther than half a period are left out."""
    reach = max(int(np.median(np.diff(grid))) // 2, 1)
    after = np.clip(np.searchsorted(grid, stamps), 1, len(grid) - 1)
    nearest_row = np.where(stamps - grid[after - 1] <= grid[after] - stamps, after - 1, after)
    found = np.flatnonzero(np.abs(grid[nearest_row] - stamps) <= reach)
    return nearest_row[found].astype(np.int64), found.astype(np.int64)
