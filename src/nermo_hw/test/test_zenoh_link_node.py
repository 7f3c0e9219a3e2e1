"""The node at the workstation's end: sensor data into the graph, commands out of it, and the release."""

from __future__ import annotations

import math
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from graph_bench import GraphBench
from link_rig import PATIENCE_S, ROBOT, SERVOS, Rig
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import BatteryState, Imu, JointState
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from nermo_hw.link.messages import DEFINITIONS, decode_command, encode_command
from nermo_interfaces import msg
from nermo_interfaces.msg import ServoCommand, ServoStates, Tactile
from nermo_node import qos


@pytest.fixture
def bench() -> Iterator[GraphBench]:
    made = GraphBench(namespace="nermo")
    yield made
    made.close()


def test_the_graph_moves_the_robot_at_the_far_end(bench: GraphBench, tmp_path: Path) -> None:
    rig = Rig(tmp_path, workstation=False)
    code = "import sys; from nermo_hw.nodes.zenoh_link import main; sys.exit(main())"
    arguments = ["--ros-args", "-r", "__ns:=/nermo", "-p", f"link:={rig.link}"]
    node = subprocess.Popen([sys.executable, "-c", code, *arguments])
    try:
        seen: dict[str, object] = {}
        for name, kind in (
            ("servo_states", ServoStates),
            ("imu/data_raw", Imu),
            ("tactile", Tactile),
            ("joint_states", JointState),
            ("battery", BatteryState),
        ):
            bench.node.create_subscription(
                kind, name, lambda message, name=name: seen.update({name: message}), qos.BEST_EFFORT
            )
        statuses: dict[str, str] = {}
        bench.node.create_subscription(
            DiagnosticArray,
            "/diagnostics",
            lambda message: statuses.update({status.name: status.message for status in message.status}),
            10,
        )
        commands = bench.node.create_publisher(ServoCommand, "servo_command", qos.COMMAND)
        bench.until(lambda: len(seen) == 5, "all sensor data has come")
        assert list(seen["servo_states"].name) == SERVOS
        assert seen["battery"].voltage > 6.0
        assert seen["imu/data_raw"].orientation.w == pytest.approx(1.0, abs=1e-3)
        bench.until(lambda: "robot_end: safety" in statuses, "the robot's diagnostics have come")
        assert statuses["robot_end: safety"].startswith("limp: start")

        client = bench.node.create_client(Trigger, "zenoh_link/release")
        bench.until(client.service_is_ready, "the service is there")

        def refusal() -> str:
            future = client.call_async(Trigger.Request())
            bench.until(future.done, "the service answers")
            return str(future.result().message)

        bench.until(lambda: refusal() == "", "the robot is released")
        tail = SERVOS.index("tail")

        def there() -> bool:
            command = ServoCommand(name=SERVOS, position=[servo.neutral for servo in ROBOT.servos.values()])
            command.position[tail] = 0.5
            command.header.stamp = seen["servo_states"].header.stamp
            commands.publish(command)
            return abs(seen["servo_states"].position[tail] - 0.5) < 0.02

        def there_at_last() -> bool:
            # A busy machine may hold up the emulated line, which makes the robot limp: then it takes another release.
            if not rig.energised():
                refusal()
            return there()

        bench.until(there_at_last, "the tail is there")

        stops = bench.node.create_publisher(Bool, "emergency_stop", qos.LATCHED)
        refused = "emergency_stop (/nermo/bench still says stop: end it there first)"
        for _ in range(2):
            stops.publish(Bool(data=True))
            bench.until(lambda: not rig.energised(), "the stop has taken the power")
            bench.until(lambda: refusal() == refused, "the release is refused in words")
            stops.publish(Bool(data=False))
            assert not rig.energised(), "the end of the stop is no release"
        node.send_signal(signal.SIGUSR1)
        waits = "limp: emergency_stop (/nermo/bench and SIGUSR1 have said stop and wait for a release)"
        bench.until(lambda: statuses["robot_end: safety"].startswith(waits), "a signal to the node is a stop too")
        bench.until(lambda: refusal() == "" and there(), "a release has given the power back")
        node.send_signal(signal.SIGINT)
        assert node.wait(PATIENCE_S) == 0
    finally:
        node.kill()
        node.wait()
        rig.close()


@pytest.mark.parametrize(
    ("parameter", "words"), [("link:=/nowhere.yaml", "/nowhere.yaml"), ("endpoint:=tcp/1:2", "quic/ or tls/")]
)
def test_a_bad_parameter_ends_it_with_a_sentence(parameter: str, words: str) -> None:
    code = "import sys; from nermo_hw.nodes.zenoh_link import main; sys.exit(main())"
    command = [sys.executable, "-c", code, "--ros-args", "-p", parameter]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.returncode == 2
    assert words in done.stdout + done.stderr


def test_what_the_robot_writes_without_ros_is_what_ros_writes() -> None:
    message = ServoCommand(name=["tail", "head_pan"], position=[0.25, -math.pi])
    message.header.stamp.sec, message.header.stamp.nanosec = 12, 345
    ours = encode_command(12_000_000_345, ["tail", "head_pan"], [0.25, -math.pi])
    assert deserialize_message(ours, ServoCommand) == message
    assert decode_command(serialize_message(message)) == (12_000_000_345, ["tail", "head_pan"], [0.25, -math.pi])


def test_the_definitions_are_those_of_the_interfaces() -> None:
    for name, text in DEFINITIONS.items():
        kind = getattr(msg, name.split("/")[-1])
        ours = {field: spelled for spelled, field in (line.split() for line in text.splitlines())}
        theirs = {
            field: spelled.replace("sequence<double>", "float64[]")
            .replace("sequence<string>", "string[]")
            .replace("double[4]", "float64[4]")
            for field, spelled in kind.get_fields_and_field_types().items()
        }
        assert ours == theirs
