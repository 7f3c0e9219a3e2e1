"""Command files and recorded commands."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml
from rclpy.serialization import serialize_message

from nermo_bringup.recording.errors import RecordingError
from nermo_bringup.recording.schema import ros2msg
from nermo_bringup.recording.writer import BagWriter, Topic
from nermo_bringup.teleop.script import SECOND, load_script
from nermo_control.types import ControlCommand, Posture, SpineModes, TrajectoryMode
from nermo_description.parameter_files import ParameterError
from nermo_interfaces.msg import ControlCommand as ControlCommandMessage
from nermo_interfaces.msg import ServoCommand
from nermo_node.recording_reader import Recording

WALK = """
description: stand, trot, sit
duration: 12
commands:
  - {at: 0.5, posture: stand}
  - {at: 2, posture: walk, forward_velocity: 0.06, gait: trot, gait_frequency: 0.8, trajectory_mode: straight_line}
  - {at: 4, turn_rate: 0.2, trajectory_mode: external, spine_modes: {turning: true}, turning_strategy: mix}
  - {at: 8, posture: lift_rear_left, spine_modes: {balance_compensation: true}}
  - {at: 10, posture: sit, forward_velocity: 0, turn_rate: 0}
"""


def write(directory: Path, text: str) -> Path:
    path = directory / "walk.yaml"
    path.write_text(text)
    return path


def test_a_file_gives_the_command_of_each_moment(tmp_path: Path) -> None:
    script = load_script(write(tmp_path, WALK))
    assert script.control_at(0, 7) is None
    assert script.control_at(SECOND // 2, 7) == ControlCommand(stamp=7, posture=Posture.STAND)
    walking = ControlCommand(9, 0.06, 0.0, Posture.WALK, TrajectoryMode.STRAIGHT_LINE, "trot", 0.8)
    assert script.control_at(2 * SECOND, 9) == script.control_at(4 * SECOND - 1, 9) == walking
    assert script.control_at(5 * SECOND, 1) == ControlCommand(
        1, 0.06, 0.2, Posture.WALK, TrajectoryMode.EXTERNAL, "trot", 0.8, "mix", SpineModes(turning=True)
    )
    assert script.control_at(9 * SECOND, 1).posture is Posture.LIFT_REAR_LEFT
    assert script.control_at(12 * SECOND, 1).posture is Posture.SIT
    assert script.control_at(12 * SECOND + 1, 1) is None


def test_a_file_of_servo_positions_keeps_what_is_not_named(tmp_path: Path) -> None:
    script = load_script(write(tmp_path, "commands: [{at: 0, servos: {a: 0.1, b: 0.2}}, {at: 1, servos: {b: 0.3}}]"))
    assert script.servos_at(0) == {"a": 0.1, "b": 0.2}
    assert script.servos_at(SECOND) == {"a": 0.1, "b": 0.3}
    assert script.control_at(SECOND, 7) == ControlCommand(stamp=7, posture=Posture.DIRECT)
    assert script.last(9) == ControlCommand(stamp=9, posture=Posture.STAND)


def test_a_file_may_take_turns_between_commands_and_servo_positions(tmp_path: Path) -> None:
    script = load_script(
        write(
            tmp_path,
            """
commands:
  - {at: 0, posture: stand, gait: trot}
  - {at: 1, servos: {a: 0.1, b: 0.2}}
  - {at: 2, posture: walk, forward_velocity: 0.05}
  - {at: 3, servos: {b: 0.3}}
  - {at: 4, turn_rate: 0.1}
""",
        )
    )
    assert [script.servos_at(second * SECOND) for second in range(5)] == [
        None,
        {"a": 0.1, "b": 0.2},
        None,
        {"b": 0.3},
        None,
    ]
    postures = [script.control_at(second * SECOND, 0).posture for second in range(5)]
    assert postures == [Posture.STAND, Posture.DIRECT, Posture.WALK, Posture.DIRECT, Posture.WALK]
    assert script.control_at(4 * SECOND, 5) == ControlCommand(5, 0.05, 0.1, Posture.WALK, gait="trot")
    assert script.last(6) == ControlCommand(6, posture=Posture.WALK, gait="trot")


@pytest.mark.parametrize(
    ("entry", "complaint"),
    [
        (
            {"at": 1, "gait_frequency": 50},
            "commands.1.gait_frequency: is 50; must be 0 (the knowledge-base's default) or 0.1",
        ),
        (
            {"at": 1, "forward_velocity": float("nan")},
            "commands.1.forward_velocity: is nan; input should be a finite number",
        ),
        (
            {"at": 1, "forward_velocity": 3},
            "commands.1.forward_velocity: is 3; input should be less than or equal to 1",
        ),
        (
            {"at": 1, "forward_velocty": 0.1},
            "commands.1.forward_velocty: no such field; did you mean 'forward_velocity'",
        ),
        (
            {"at": 1, "posture": "lie"},
            "commands.1.posture: is 'lie'; input should be 'walk', 'stand', 'sit', 'crouch', 'stop', 'lift_front_left'",
        ),
        (
            {"at": 1, "spine_modes": {"turn": True}},
            "commands.1.spine_modes.turn: no such field; did you mean 'turning'",
        ),
        ({"at": 0}, "commands.1.at: 0 s does not come after 0 s"),
        ({"forward_velocity": 0.1}, "commands.1.at: is missing"),
        (
            {"at": 1, "servos": {"tail": 0.0}, "gait": "trot"},
            "commands.1: has servos and gait; an entry with servos has no other field than `at`",
        ),
        ({"at": 1, "servos": {}}, "commands.1.servos: names no servo"),
        ({"at": 1, "posture": "direct"}, "commands.1.posture: is 'direct'; input should be 'walk'"),
    ],
)
def test_a_wrong_file_names_entry_field_value_and_range(tmp_path: Path, entry: dict, complaint: str) -> None:
    path = write(tmp_path, yaml.safe_dump({"commands": [{"at": 0, "posture": "stand"}, entry]}))
    with pytest.raises(ParameterError) as error:
        load_script(path)
    assert str(path) in str(error.value)
    assert complaint in str(error.value)


@pytest.mark.parametrize("text", ["commands: []", "duration: 5", "duration: 1\ncommands: [{at: 2, posture: sit}]", ""])
def test_a_file_that_holds_nothing_to_play_is_refused(tmp_path: Path, text: str) -> None:
    with pytest.raises(ParameterError, match="walk.yaml"):
        load_script(write(tmp_path, text))


def record(directory: Path, schema: str = ros2msg("nermo_interfaces/msg/ControlCommand"), cut: int = 0) -> Path:
    """``cut``: bytes at the end of a control command that the schema does not have."""
    bag = BagWriter(directory / "walk")
    controls = Topic("/nermo/control_command", "nermo_interfaces/msg/ControlCommand", schema)
    servos = Topic(
        "/nermo/servo_command", "nermo_interfaces/msg/ServoCommand", ros2msg("nermo_interfaces/msg/ServoCommand")
    )
    for second in range(3):
        control = ControlCommandMessage(forward_velocity=0.01 * second, posture=0, gait="trot")
        control.spine_modes.turning = True
        control.header.stamp.sec = 100 + second
        data = serialize_message(control)
        bag.write(controls, second, second, second, data[: len(data) - cut])
        servo = ServoCommand(name=["a", "b"], position=[0.1 * second, 0.2])
        servo.header.stamp.sec = 100 + second
        bag.write(servos, second, second, second, serialize_message(servo))
    bag.close()
    return directory / "walk"


def test_the_commands_of_a_recording_are_timed_by_their_stamps(tmp_path: Path) -> None:
    path = record(tmp_path)
    script = load_script(path)
    assert script.duration == 2 * SECOND
    assert script.control_at(SECOND, 5) == ControlCommand(5, 0.01, gait="trot", spine_modes=SpineModes(turning=True))
    servos = load_script(path, "servo")
    assert servos.servos_at(2 * SECOND) == {"a": pytest.approx(0.2), "b": 0.2}


def test_a_recording_from_before_a_spine_function_existed_plays_without_it(tmp_path: Path) -> None:
    today = ros2msg("nermo_interfaces/msg/ControlCommand")
    before = "\n".join(line for line in today.splitlines() if not line.startswith("bool balance_compensation"))
    assert before != today
    path = record(tmp_path, before, cut=1)
    columns = Recording(path).read()["/nermo/control_command"].columns
    assert "spine_modes.turning" in columns and "spine_modes.balance_compensation" not in columns
    assert load_script(path).control_at(SECOND, 5).spine_modes == SpineModes(turning=True)


def test_a_recording_without_commands_says_so(tmp_path: Path) -> None:
    BagWriter(tmp_path / "walk").close()
    with pytest.raises(RecordingError, match="has no topic control_command"):
        load_script(tmp_path / "walk")
