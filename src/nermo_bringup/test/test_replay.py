"""Recordings of the in-process loop, replayed on a fresh twin."""

from __future__ import annotations

import csv
import math
from pathlib import Path

import numpy as np
import pytest
from nav_msgs.msg import Odometry
from rclpy.serialization import serialize_message
from typer.testing import CliRunner

from nermo_bringup.cli import app
from nermo_bringup.recording.errors import RecordingError
from nermo_bringup.recording.replay import recorded_robot, replay_controls, replay_servos
from nermo_bringup.recording.schema import ros2msg
from nermo_bringup.recording.writer import BagWriter, Topic
from nermo_control.controller import Controller
from nermo_control.gait.knowledge_base import GaitParameters
from nermo_control.nodes.conversions import robot_parameters_to_message
from nermo_control.types import ControlCommand, Posture
from nermo_description.robots import load_robot
from nermo_interfaces.msg import ControlCommand as ControlCommandMessage
from nermo_interfaces.msg import RobotParameters as RobotParametersMessage
from nermo_interfaces.msg import ServoCommand, ServoStates
from nermo_node.recording_reader import Recording
from nermo_node.time import to_message
from nermo_sim.twin import Twin

BEGIN = 20 * 10**9
TYPES = {
    "servo_command": ("nermo_interfaces/msg/ServoCommand", ServoCommand),
    "servo_states": ("nermo_interfaces/msg/ServoStates", ServoStates),
    "control_command": ("nermo_interfaces/msg/ControlCommand", ControlCommandMessage),
    "robot_parameters": ("nermo_interfaces/msg/RobotParameters", RobotParametersMessage),
    "truth/odom": ("nav_msgs/msg/Odometry", Odometry),
}


class Stage:
    """Writes messages by topic as the recorder would."""

    def __init__(self, directory: Path) -> None:
        self.bag = BagWriter(directory)
        self.topics = {name: Topic(f"/nermo/{name}", kind, ros2msg(kind)) for name, (kind, _) in TYPES.items()}

    def write(self, topic: str, stamp: int, /, **fields: object) -> None:
        message = TYPES[topic][1](**fields)
        message.header.stamp = to_message(stamp)
        self.bag.write(self.topics[topic], stamp, stamp, 0, serialize_message(message))


@pytest.fixture(scope="module")
def robot():
    return load_robot("nermo_lite")


@pytest.fixture(scope="module")
def walk(robot, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Half a second of trot, recorded with the operator's command, the servos' commands and states, and the truth."""
    directory = tmp_path_factory.mktemp("recordings") / "walk"
    stage = Stage(directory)
    parameters = robot_parameters_to_message(0, robot)
    stage.bag.write(stage.topics["robot_parameters"], 0, 0, 0, serialize_message(parameters))
    twin = Twin(robot)
    controller = Controller(robot, GaitParameters(), twin.period_ns)
    names = list(robot.servos)
    for tick in range(100):
        sensors, odometry, now = twin.sensors(), twin.odometry(), BEGIN + twin.time_ns
        wish = ControlCommand(twin.time_ns, 0.05, 0.0, Posture.WALK, gait="trot", gait_frequency=0.8)
        output = controller.step(twin.time_ns, wish, odometry, sensors.servo_positions)
        if tick % 10 == 0:
            stage.write("control_command", now, forward_velocity=0.05, gait="trot", gait_frequency=0.8)
        unknown = [math.nan] * len(names)
        stage.write(
            "servo_states",
            now,
            name=names,
            position=sensors.servo_positions,
            velocity=sensors.servo_velocities,
            torque=unknown,
            current=unknown,
        )
        truth = Odometry()
        pose = truth.pose.pose
        pose.position.x, pose.position.y = odometry.x, odometry.y
        pose.orientation.w, pose.orientation.z = math.cos(odometry.yaw / 2), math.sin(odometry.yaw / 2)
        stage.write("truth/odom", now, pose=truth.pose)
        # The servos are named in another order than the robot's.
        stage.write("servo_command", now, name=names[::-1], position=list(output.servo_positions)[::-1])
        twin.step(output.servo_positions)
    stage.bag.close()
    return directory


def nothing(done: int, total: int) -> None:
    """Progress that nobody watches."""


def test_replayed_servo_commands_give_the_recorded_run_again(walk: Path, robot) -> None:
    comparison = replay_servos(Recording(walk), robot, nothing)
    assert len(comparison.time) == 100
    np.testing.assert_array_equal(comparison.replayed_servos, comparison.recorded_servos)
    np.testing.assert_allclose(comparison.replayed_pose, comparison.recorded_pose, atol=1e-12)
    assert np.ptp(comparison.recorded_servos, axis=0).max() > 0.05


def test_replayed_control_commands_give_the_recorded_run_again(walk: Path, robot) -> None:
    comparison = replay_controls(Recording(walk), robot, GaitParameters(), nothing)
    # The operator's last command is older than the last servo command.
    assert len(comparison.time) == 91
    np.testing.assert_allclose(comparison.replayed_servos, comparison.recorded_servos, atol=1e-9)


def test_the_recording_tells_its_robot(walk: Path, tmp_path: Path) -> None:
    assert recorded_robot(Recording(walk)) == "nermo_lite"
    BagWriter(tmp_path / "empty").close()
    assert recorded_robot(Recording(tmp_path / "empty")) is None


def test_the_table_holds_both(walk: Path, tmp_path: Path) -> None:
    table = tmp_path / "table.csv"
    result = CliRunner().invoke(app, ["replay", str(walk), "--out", str(table), "--json", str(tmp_path / "r.json")])
    assert result.exit_code == 0, result.output
    with table.open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 100
    assert {"time_s", "front_left_hip_commanded_rad", "front_left_hip_recorded_rad", "base_x_replayed_m"} <= set(
        rows[0]
    )
    assert (tmp_path / "r.json").exists()


def test_commands_of_another_robot_are_refused(robot, tmp_path: Path) -> None:
    stage = Stage(tmp_path / "walk")
    stage.write("servo_command", 1, name=["wing"], position=[0.1])
    stage.bag.close()
    with pytest.raises(RecordingError, match="does not command front_left_hip, .* of nermo_lite"):
        replay_servos(Recording(tmp_path / "walk"), robot, nothing)
