"""What the commands of a recording make a mouse do: the twin is told the same, from the stand."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from nermo_description.robots import AnyRobot
from nermo_node.recording_reader import Recording, RecordingError
from nermo_sim.twin import Twin
from nermo_track.clock import Motion

Array = NDArray[np.float64]
SERVO_TOPIC = "servo_command"


@dataclass(frozen=True)
class Commands:
    """What a recording's servos were told."""

    topic: str
    stamp: NDArray[np.int64]
    """(n,) [ns] of ROS time, rising."""
    position: Array
    """(n, servos) [rad] In the robot's order."""
    delay: int
    """[ns] From a command's stamp until it was logged, median."""

    def at(self, time: Array) -> NDArray[np.int64]:
        """(m,) [ns] Stamps of times [s] since the first command."""
        return self.stamp[0] + np.round(time * 1e9).astype(np.int64)


def recorded_robot(recording: Recording) -> str | None:
    """Name of the robot that a recording says it is of, or None."""
    for name in recording.topics:
        if name.endswith("/robot_parameters"):
            return str(recording.read([name])[name]["robot"][-1])
    return None


def recorded_commands(recording: Recording, robot: AnyRobot) -> Commands:
    """The servo commands of a recording.

    Raises:
        RecordingError: there are none, or they are another robot's.
    """
    topic = recording.topic_ending(SERVO_TOPIC)
    data = recording.read([topic])[topic]
    servos = list(robot.servos)
    position = data.by_name("position", servos)
    if np.isnan(position).any():
        lacking = servos[int(np.flatnonzero(np.isnan(position).any(axis=0))[0])]
        raise RecordingError(f"{recording.path}: {topic} does not command {lacking} of {robot.name} (--robot)")
    stamp, first = np.unique(data.stamp, return_index=True)
    if len(stamp) < 2:
        raise RecordingError(f"{recording.path}: {topic} holds {len(stamp)} commands; a clock needs more")
    return Commands(topic, stamp, position[first], int(np.median(data.log_time - data.stamp)))


def expected_motion(commands: Commands, robot: AnyRobot, say: Callable[[float], None] = lambda share: None) -> Motion:
    """Motion of the twin's base_link [s] since the first command, when it is told the same.

    It need not stay where the mouse goes: only its steps are compared with what is seen. Each tick obeys the newest
    command that was given by then.

    Raises:
        SimulationDivergedError: the twin's simulation broke down.
    """
    twin = Twin(robot)
    begin, period = int(commands.stamp[0]), twin.period_ns
    ticks = int((commands.stamp[-1] - begin) // period) + 1
    now = begin + np.arange(ticks, dtype=np.int64) * period
    rows = np.searchsorted(commands.stamp, now, side="right") - 1
    place, turn = np.empty((ticks, 3)), np.empty((ticks, 4))
    for tick in range(ticks):
        state = twin.base_state()
        place[tick], turn[tick] = state.position, state.quaternion
        fresh = commands.stamp[rows[tick]] > now[tick] - period
        twin.step(commands.position[rows[tick]].tolist() if fresh else None)
        if tick % 200 == 0:
            say(tick / ticks)
    return Motion(
        np.asarray((now - begin) * 1e-9, dtype=np.float64), place, Rotation.from_quat(turn, scalar_first=True)
    )
