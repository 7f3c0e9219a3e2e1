"""The supervisor in front of the serial driver: what it decides is what the emulated device does."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from graph_bench import PATIENCE_S, GraphBench
from pwm_host import need_compiler
from sensor_msgs.msg import BatteryState, Imu
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from nermo_description.robots import load_robot
from nermo_hw.device.setup import EmulatorSettings, make_emulator
from nermo_interfaces.msg import ServoCommand, ServoStates
from nermo_node import qos

ROBOT = load_robot("nermo_lite")


@pytest.fixture
def bench() -> Iterator[GraphBench]:
    made = GraphBench()
    yield made
    made.close()


def spin_until(bench: GraphBench, condition: Callable[[], object], what: str, status: dict[str, str]) -> None:
    """As the bench does; in vain, what was heard last is told too."""
    try:
        bench.until(condition, what)
    except AssertionError as error:
        raise AssertionError(f"{error}; last heard: {status}") from None


def start(node: str, *arguments: str) -> subprocess.Popen[bytes]:
    code = f"import sys; from nermo_hw.nodes.{node} import main; sys.exit(main())"
    return subprocess.Popen([sys.executable, "-c", code, "--ros-args", *arguments])


@pytest.mark.parametrize("bus", ["servo_boards", "pwm_board"])
def test_release_stop_and_silence_reach_the_servos(bench: GraphBench, tmp_path: Path, bus: str) -> None:
    if bus == "pwm_board":
        need_compiler()
    emulator = make_emulator(EmulatorSettings(bus=bus, link=str(tmp_path / "device")))
    thread = threading.Thread(target=emulator.run)
    thread.start()
    processes = [
        start("serial_driver", "-p", f"port:={tmp_path / 'device'}", "-r", "servo_command:=safe_servo_command"),
        start("safety_supervisor", "-p", f"bus:={bus}"),
    ]
    walking = [True]
    status: dict[str, str] = {}
    commands = bench.node.create_publisher(ServoCommand, "servo_command", qos.COMMAND)
    stops = bench.node.create_publisher(Bool, "emergency_stop", qos.LATCHED)
    client = bench.node.create_client(Trigger, "safety_supervisor/release")

    def answer(states: ServoStates) -> None:
        if walking[0]:
            command = ServoCommand(name=list(ROBOT.servos), position=[s.neutral for s in ROBOT.servos.values()])
            command.header.stamp = states.header.stamp
            commands.publish(command)

    def note(message: DiagnosticArray) -> None:
        status.update({part.name: part.message for part in message.status})

    def safety() -> str:
        return status.get("safety_supervisor: safety", "")

    def energised() -> bool:
        return bool(emulator.device.state()["energised"])

    def until(condition: Callable[[], object], what: str) -> None:
        spin_until(bench, condition, what, status)

    def refusal() -> str:
        future = client.call_async(Trigger.Request())
        until(future.done, "the service answers")
        return str(future.result().message)

    bench.node.create_subscription(ServoStates, "servo_states", answer, qos.BEST_EFFORT)
    bench.node.create_subscription(DiagnosticArray, "/diagnostics", note, 10)
    try:
        until(lambda: safety().startswith("limp: start"), "it is limp")
        until(lambda: not energised(), "its servos are limp")
        until(client.service_is_ready, "the service is there")
        # On a busy machine the line may pause for 0.3 s, and then it takes another release.
        until(lambda: refusal() == "" and energised() and safety() == "follow", "it has power and follows")
        stops.publish(Bool(data=True))
        until(lambda: not energised(), "the stop has taken the power")
        says = "emergency_stop (/bench still says stop: end it there first)"
        until(lambda: refusal().startswith(says), "it says who, which ROS may know a little later")
        processes[1].send_signal(signal.SIGUSR1)
        stops.publish(Bool(data=False))
        until(lambda: "SIGUSR1" in safety(), "the signal has come")
        assert not energised()
        until(lambda: refusal() == "" and energised(), "a release has given the power back")
        walking[0] = False

        def crouches() -> bool:
            if not energised():
                refusal()
            return "command_lost" in safety() and energised()

        until(crouches, "it crouches")
    finally:
        for process in processes:
            process.terminate()
            process.wait(PATIENCE_S)
        emulator.stop()
        thread.join()


@pytest.mark.parametrize(("bus", "well"), [("servo_boards", True), ("pwm_board", True), ("pwm_board", False)])
def test_a_sensor_that_says_what_cannot_be_is_refused_in_words_and_has_no_reading(
    bench: GraphBench, bus: str, well: bool
) -> None:
    """Also of a robot that has sensors though its file says it has none, and where one was broken from the start."""
    process = start("safety_supervisor", "-p", f"bus:={bus}")
    status: dict[str, str] = {}
    servos = list(ROBOT.servos)
    states = ServoStates(name=servos, position=[s.neutral for s in ROBOT.servos.values()])
    states.velocity = states.current = [0.0] * len(servos)
    upright = Imu()
    upright.orientation.w, upright.linear_acceleration.z = 1.0, 9.81
    says: dict[str, Any] = {"imu/data_raw": upright, "battery": BatteryState(voltage=7.6), "servo_states": states}
    publishers = {topic: bench.node.create_publisher(type(said), topic, qos.SENSOR) for topic, said in says.items()}

    def say() -> None:
        stamp = bench.node.get_clock().now().to_msg()
        for topic, publisher in publishers.items():
            says[topic].header.stamp = stamp
            publisher.publish(says[topic])

    def note(message: DiagnosticArray) -> None:
        status.update({part.name: part.message for part in message.status})

    def until_it_says(safety: str, refused: str) -> None:
        spin_until(
            bench,
            lambda: (
                safety in status.get("safety_supervisor: safety", "")
                and refused in status.get("safety_supervisor: commands", "")
            ),
            f"it says {safety}",
            status,
        )

    bench.node.create_subscription(DiagnosticArray, "/diagnostics", note, 10)
    bench.node.create_timer(0.01, say)
    impossible = ServoStates(name=servos, position=[1e308, *states.position[1:]])
    broken = Imu()
    broken.orientation.w = 0.0
    if not well:
        says["imu/data_raw"] = broken
    try:
        if well:
            until_it_says("limp: start", "nothing refused")
        says["imu/data_raw"] = broken
        until_it_says("imu_invalid", "imu/data_raw refused: orientation")
        says["imu/data_raw"], says["battery"] = upright, BatteryState(voltage=1e6)
        until_it_says("battery_invalid", "battery refused: voltage")
        says["battery"], says["servo_states"] = BatteryState(voltage=7.6), impossible
        until_it_says("servo_invalid", "servo_states refused: position of front_left_hip")
    finally:
        process.terminate()
        process.wait(PATIENCE_S)
