"""The supervisor in front of the serial driver: what it decides is what the emulated device does."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from nermo_description.robots import load_robot
from nermo_hw.device.setup import EmulatorSettings, make_emulator
from nermo_interfaces.msg import ServoCommand, ServoStates
from nermo_node import qos

PATIENCE_S = 60.0
ROBOT = load_robot("nermo_lite")


@pytest.fixture
def bench() -> Iterator[Node]:
    rclpy.init()
    node = Node("bench")
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    yield node
    node.destroy_node()
    rclpy.shutdown()


def spin_until(node: Node, condition: Callable[[], object], what: str) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline, f"waited in vain until {what}"
        node.executor.spin_once(timeout_sec=0.05)


def start(node: str, *arguments: str) -> subprocess.Popen[bytes]:
    code = f"import sys; from nermo_hw.nodes.{node} import main; sys.exit(main())"
    return subprocess.Popen([sys.executable, "-c", code, "--ros-args", *arguments])


def test_release_stop_and_silence_reach_the_servos(bench: Node, tmp_path: Path) -> None:
    emulator = make_emulator(EmulatorSettings(link=str(tmp_path / "device")))
    thread = threading.Thread(target=emulator.run)
    thread.start()
    processes = [
        start("serial_driver", "-p", f"port:={tmp_path / 'device'}", "-r", "servo_command:=safe_servo_command"),
        start("safety_supervisor"),
    ]
    walking = [True]
    status: dict[str, str] = {}
    commands = bench.create_publisher(ServoCommand, "servo_command", qos.COMMAND)
    stops = bench.create_publisher(Bool, "emergency_stop", qos.LATCHED)
    client = bench.create_client(Trigger, "safety_supervisor/release")

    def answer(states: ServoStates) -> None:
        if walking[0]:
            command = ServoCommand(name=list(ROBOT.servos), position=[s.neutral for s in ROBOT.servos.values()])
            command.header.stamp = states.header.stamp
            commands.publish(command)

    def note(message: DiagnosticArray) -> None:
        status.update({part.name: part.message for part in message.status})

    def energised() -> bool:
        return bool(emulator.device.state()["energised"])

    def refusal() -> str:
        future = client.call_async(Trigger.Request())
        spin_until(bench, future.done, "the service answers")
        return str(future.result().message)

    bench.create_subscription(ServoStates, "servo_states", answer, qos.BEST_EFFORT)
    bench.create_subscription(DiagnosticArray, "/diagnostics", note, 10)
    try:
        spin_until(bench, lambda: status.get("safety_supervisor: safety", "").startswith("limp: start"), "it is limp")
        spin_until(bench, lambda: not energised(), "its servos are limp")
        spin_until(bench, client.service_is_ready, "the service is there")
        spin_until(bench, lambda: refusal() == "" and energised(), "the servos have power")
        spin_until(bench, lambda: status["safety_supervisor: safety"] == "follow", "it follows")
        stops.publish(Bool(data=True))
        spin_until(bench, lambda: not energised(), "the stop has taken the power")
        assert refusal() == "emergency_stop (/bench still says stop: end it there first)"
        processes[1].send_signal(signal.SIGUSR1)
        stops.publish(Bool(data=False))
        spin_until(bench, lambda: "SIGUSR1" in status["safety_supervisor: safety"], "the signal has come")
        assert not energised()
        spin_until(bench, lambda: refusal() == "" and energised(), "a release has given the power back")
        walking[0] = False
        spin_until(bench, lambda: "command_lost" in status["safety_supervisor: safety"], "it crouches")
        assert energised()
    finally:
        for process in processes:
            process.terminate()
            process.wait(PATIENCE_S)
        emulator.stop()
        thread.join()
