"""A recording's commands on a fresh twin, and how far the twin then is from what was recorded."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nermo_bringup.recording.errors import RecordingError
from nermo_bringup.teleop.script import CONTROL_TOPIC, SERVO_TOPIC, recorded_script
from nermo_control.controller import Controller
from nermo_control.gait.knowledge_base import GaitParameters
from nermo_description.parameters import RobotParameters
from nermo_node.recording_reader import Recording, TopicData
from nermo_sim.twin import Twin

Array = NDArray[np.float64]
Progress = Callable[[int, int], None]

POSE = ("x", "y", "yaw")


@dataclass(frozen=True)
class Comparison:
    """Recorded and replayed, at the same ticks. Rows are ticks."""

    time: Array
    """(n,) [s] since the first command."""
    servos: tuple[str, ...]
    commanded: Array
    """(n, servos) [rad], what the twin was told."""
    recorded_servos: Array
    """(n, servos) [rad]"""
    replayed_servos: Array
    """(n, servos) [rad]"""
    recorded_pose: Array
    """(n, 3) x [m], y [m] and yaw [rad] of base_link since the first command; NaN where there is no ground truth."""
    replayed_pose: Array
    """(n, 3), likewise."""

    def servo_difference(self) -> Array:
        """Root mean square of the difference of each servo [rad]."""
        return np.sqrt(np.mean((self.replayed_servos - self.recorded_servos) ** 2, axis=0))

    def final_pose_difference(self) -> Array:
        """Replayed less recorded x [m], y [m] and yaw [rad] at the end."""
        return self.replayed_pose[-1] - self.recorded_pose[-1]

    def save(self, path: Path) -> None:
        """Write a table with a header, one row a tick.

        Raises:
            RecordingError: the file cannot be written.
        """
        columns: list[tuple[str, Array]] = [("time_s", self.time)]
        for kind, values in (
            ("commanded", self.commanded),
            ("recorded", self.recorded_servos),
            ("replayed", self.replayed_servos),
        ):
            columns += [(f"{servo}_{kind}_rad", values[:, place]) for place, servo in enumerate(self.servos)]
        for kind, values in (("recorded", self.recorded_pose), ("replayed", self.replayed_pose)):
            columns += [
                (f"base_{name}_{kind}_{'rad' if name == 'yaw' else 'm'}", values[:, place])
                for place, name in enumerate(POSE)
            ]
        try:
            with path.open("w", newline="", encoding="utf-8") as file:
                table = csv.writer(file)
                table.writerow(name for name, _ in columns)
                table.writerows(zip(*(values.tolist() for _, values in columns), strict=True))
        except OSError as error:
            raise RecordingError(f"{path} cannot be written: {error.strerror}") from None


def recorded_robot(recording: Recording) -> str | None:
    """Name of the robot that a recording is of; None where it does not tell."""
    for name in recording.topics:
        if name.endswith("/robot_parameters"):
            return str(recording.read([name])[name]["robot"][-1])
    return None


def replay_servos(recording: Recording, robot: RobotParameters, progress: Progress) -> Comparison:
    """Feed the recorded servo commands to a twin that starts in the stand keyframe.

    In each tick the twin gets the newest command that was given by then; ticks without a new one are silent, so that
    its hold and crouch come as they did. The two agree to the last bit where the recording is of the same twin in
    stepped mode, began when the simulation did, and lost nothing.

    Raises:
        RecordingError: the recording lacks commands or servo states, or names other servos.
    """
    topic = recording.topic_ending(SERVO_TOPIC)
    data = recording.read([topic])[topic]
    servos = tuple(robot.servos)
    positions = data.by_name("position", servos)
    if np.isnan(positions).any():
        lacking = [servo for servo, column in zip(servos, positions.T, strict=True) if np.isnan(column).any()]
        raise RecordingError(f"{topic} of {recording.path} does not command {', '.join(lacking)} of {robot.name}")
    order = np.argsort(data.stamp, kind="stable")
    stamps, positions = data.stamp[order], positions[order]
    begin = int(stamps[0])
    twin = Twin(robot)

    def command(tick: int) -> Sequence[float] | None:
        now = begin + tick * twin.period_ns
        place = int(np.searchsorted(stamps, now, side="right")) - 1
        return positions[place].tolist() if stamps[place] > now - twin.period_ns else None

    return _compare(recording, twin, servos, begin, int(stamps[-1]), command, progress)


def replay_controls(
    recording: Recording, robot: RobotParameters, gaits: GaitParameters, progress: Progress
) -> Comparison:
    """Feed the recorded control commands to a controller and a twin that start together in the stand keyframe.

    Raises:
        RecordingError: the recording lacks commands or servo states.
    """
    script = recorded_script(recording, "control")
    topic = recording.topic_ending(CONTROL_TOPIC)
    begin = int(recording.read([topic])[topic].stamp.min())
    twin = Twin(robot)
    controller = Controller(robot, gaits, twin.period_ns)

    def command(tick: int) -> Sequence[float]:
        sensors = twin.sensors()
        place = int(np.searchsorted(script.times, twin.time_ns, side="right")) - 1
        wish = None if place < 0 else script.control_at(script.times[place], script.times[place])
        return controller.step(twin.time_ns, wish, twin.odometry(), sensors.servo_positions).servo_positions

    return _compare(recording, twin, tuple(robot.servos), begin, begin + script.duration, command, progress)


def _compare(
    recording: Recording,
    twin: Twin[Any],
    servos: tuple[str, ...],
    begin: int,
    end: int,
    command: Callable[[int], Sequence[float] | None],
    progress: Progress,
) -> Comparison:
    """Run the twin from begin to end [ns of the recording] and put the recording beside it."""
    ticks = (end - begin) // twin.period_ns + 1
    commanded, replayed = np.full((ticks, len(servos)), np.nan), np.zeros((ticks, len(servos)))
    pose = np.zeros((ticks, 3))
    for tick in range(ticks):
        odometry, target = twin.odometry(), command(tick)
        pose[tick] = odometry.x, odometry.y, odometry.yaw
        replayed[tick] = twin.sensors().servo_positions
        commanded[tick] = commanded[tick - 1] if target is None else target
        twin.step(target)
        if tick % 200 == 0 or tick == ticks - 1:
            progress(tick + 1, ticks)
    now = begin + np.arange(ticks, dtype=np.int64) * twin.period_ns
    states_topic = recording.topic_ending("servo_states")
    states = recording.read([states_topic])[states_topic]
    return Comparison(
        time=np.asarray((now - begin) * 1e-9, dtype=np.float64),
        servos=servos,
        commanded=commanded,
        recorded_servos=_at(now, states, states.by_name("position", servos)),
        replayed_servos=replayed,
        recorded_pose=_since_first(_recorded_pose(recording, now)),
        replayed_pose=_since_first(pose),
    )


def _recorded_pose(recording: Recording, now: NDArray[np.int64]) -> Array:
    """x, y and yaw of the ground truth at some times [ns], shape (n, 3); NaN where there is none."""
    try:
        topic = recording.topic_ending("truth/odom")
    except RecordingError:
        return np.full((len(now), 3), np.nan)
    data = recording.read([topic])[topic]
    turn = "pose.pose.orientation"
    yaw = np.arctan2(
        2.0 * (data[f"{turn}.w"] * data[f"{turn}.z"] + data[f"{turn}.x"] * data[f"{turn}.y"]),
        1.0 - 2.0 * (data[f"{turn}.y"] ** 2 + data[f"{turn}.z"] ** 2),
    )
    values = np.column_stack([data["pose.pose.position.x"], data["pose.pose.position.y"], np.unwrap(yaw)])
    return _at(now, data, values)


def _at(now: NDArray[np.int64], data: TopicData, values: Array) -> Array:
    """Values at some times: those of the newest message by then, of the first one before it."""
    order = np.argsort(data.stamp, kind="stable")
    rows = np.maximum(np.searchsorted(data.stamp[order], now, side="right") - 1, 0)
    return values[order][rows]


def _since_first(pose: Array) -> Array:
    """Poses (x, y, yaw) seen from the first of them."""
    yaw = float(pose[0, 2])
    cosine, sine = math.cos(yaw), math.sin(yaw)
    turned = (pose[:, :2] - pose[0, :2]) @ np.array([[cosine, -sine], [sine, cosine]])
    return np.column_stack([turned, np.unwrap(pose[:, 2]) - yaw])
