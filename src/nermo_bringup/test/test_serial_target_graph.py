"""The graph walks the twin through the real driver and a real serial line, and what breaks the line does not last."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry
from sensor_msgs.msg import BatteryState, Imu, JointState
from terminal import PATIENCE_S

from nermo_description.feet import readings_by_cell
from nermo_description.parameters import LEGS
from nermo_description.robots import load_robot
from nermo_hw.device.emulator import Control, control_path
from nermo_hw.nodes.serial_driver import SerialDriverParameters
from nermo_interfaces.msg import ControlCommand, ServoCommand, ServoStates, Tactile
from nermo_node import qos

ROBOT = load_robot("nermo_lite")
CONTROL = ("gait_knowledge_base", "high_level_controller", "motion_module", "trajectory_generator", "state_publisher")


class Mouse:
    """The nodes of `nermo up --target serial`, and what they publish."""

    def __init__(self, graph, link: Path) -> None:
        self._graph = graph
        self.truth: list[Odometry] = []
        self.servos: list[ServoStates] = []
        self.status: dict[str, tuple[str, dict[str, str]]] = {}
        graph.node.create_subscription(Odometry, "truth/odom", self.truth.append, 10)
        graph.node.create_subscription(ServoStates, "servo_states", self.servos.append, 10)
        graph.node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)
        self._commands = graph.node.create_publisher(ControlCommand, "control_command", qos.COMMAND)
        self._link = str(link)
        self.driver = graph.start("nermo_hw.nodes.serial_driver", *graph.parameters(port=self._link))

    def plug_in(self, **settings: str) -> None:
        self._graph.start("nermo_bringup.nodes.twin_device", *self._graph.parameters(link=self._link, **settings))

    def start_controller(self) -> None:
        for name in CONTROL:
            parameters = {"use_truth": False} if name == "state_publisher" else {}
            self._graph.start(f"nermo_control.nodes.{name}", *self._graph.parameters(**parameters))

    def walk(self) -> None:
        command = ControlCommand(forward_velocity=0.08, trajectory_mode=ControlCommand.TRAJECTORY_STRAIGHT_LINE)
        command.header.stamp = self._graph.node.get_clock().now().to_msg()
        self._commands.publish(command)

    @property
    def x(self) -> float:
        """How far the twin is [m]."""
        return self.truth[-1].pose.pose.position.x if self.truth else math.nan

    def line(self, key: str) -> str:
        return self.status.get("serial_driver: line", ("", {}))[1].get(key, "")

    def _on_diagnostics(self, array: DiagnosticArray) -> None:
        for status in array.status:
            self.status[status.name] = (status.message, {pair.key: pair.value for pair in status.values})


def test_the_twin_walks_through_driver_and_line_and_again_after_the_cable_was_pulled(graph, tmp_path):
    link = tmp_path / "device"
    mouse = Mouse(graph, link)
    mouse.plug_in()
    mouse.start_controller()

    def gone(start: float) -> bool:
        mouse.walk()
        # Each topic is discovered on its own: on a busy machine the mouse may walk before the bench hears its servos.
        return mouse.x > start + 0.03 and bool(mouse.servos) and max(mouse.servos[-1].current) > 0.0

    graph.until(lambda: gone(0.0), "the mouse has walked 3 cm", patience=90.0)
    control = Control(control_path(link))
    control.do("unplug", seconds=0.7)
    graph.until(lambda: mouse.line("reconnects") == "1", "the driver has noticed")
    start = mouse.x
    graph.until(lambda: gone(start), "the mouse walks on", patience=90.0)
    control.close()
    servos = mouse.servos[-1]
    assert list(servos.name) == list(ROBOT.servos)
    assert all(math.isnan(torque) for torque in servos.torque)
    assert min(servos.current) >= 0.0
    assert int(mouse.line("exchanges")) > 0


def test_the_twin_walks_on_the_board_of_nermo_lite_which_feels_nothing(graph, tmp_path):
    felt: list[Imu] = []
    graph.node.create_subscription(Imu, "imu/data_raw", felt.append, 10)
    mouse = Mouse(graph, tmp_path / "device")
    mouse.plug_in(bus="pwm_board")
    mouse.start_controller()

    def gone() -> bool:
        mouse.walk()
        return mouse.x > 0.03 and bool(mouse.servos)

    graph.until(gone, "the mouse has walked 3 cm, and its servos are heard", patience=90.0)
    assert all(math.isnan(angle) for angle in mouse.servos[-1].position)
    assert felt == []


def test_the_driver_waits_for_its_device_and_is_then_as_the_twin_is(graph, tmp_path):
    heard: dict[str, list] = {"imu/data_raw": [], "tactile": [], "joint_states": [], "battery": []}
    for (topic, messages), kind in zip(heard.items(), (Imu, Tactile, JointState, BatteryState), strict=True):
        graph.node.create_subscription(kind, topic, messages.append, 10)
    link = tmp_path / "device"
    mouse = Mouse(graph, link)
    graph.until(
        lambda: "is not there (yet)" in str(mouse.status.get("serial_driver: line", "")), "the missing device is told"
    )
    mouse.plug_in()
    graph.until(lambda: all(heard.values()) and mouse.servos, "every topic has come")
    assert heard["imu/data_raw"][-1].header.frame_id == "imu_link"
    # It comes to rest first.
    graph.until(lambda: abs(heard["imu/data_raw"][-1].linear_acceleration.z - 9.81) < 1.0, "the IMU feels gravity")
    assert list(heard["joint_states"][-1].name) == [f"{leg}_knee_joint" for leg in LEGS]
    for leg, angle in zip(LEGS, heard["joint_states"][-1].position, strict=True):
        dynamics = ROBOT.front_leg_dynamics if leg.startswith("front") else ROBOT.rear_leg_dynamics
        assert dynamics.knee.lower - 0.1 < angle < dynamics.knee.upper + 0.1
    assert 6.0 < heard["battery"][-1].voltage < 8.5
    felt = readings_by_cell(heard["tactile"][-1].name, heard["tactile"][-1].voltage)
    assert set(felt) == {"piezoresistive", "piezoelectric"}
    assert 0.0 <= min(felt["piezoresistive"]) <= max(felt["piezoresistive"]) <= 5.0

    commands = graph.node.create_publisher(ServoCommand, "servo_command", qos.COMMAND)

    def refused() -> bool:
        message = ServoCommand(name=["front_left_toe"], position=[0.0])
        message.header.stamp = mouse.servos[-1].header.stamp
        commands.publish(message)
        return "front_left_toe" in str(mouse.status.get("serial_driver: messages", ""))

    graph.until(refused, "an unusable command is refused")

    def followed() -> bool:
        """The last posture with the tail bent."""
        states = mouse.servos[-1]
        stand = ROBOT.posture("crouch") | {"tail": 0.5}
        message = ServoCommand(name=list(stand), position=list(stand.values()))
        message.header.stamp = states.header.stamp
        commands.publish(message)
        return abs(states.position[list(states.name).index("tail")] - 0.5) < 0.1

    graph.until(followed, "the tail has bent")
    graph.until(lambda: "crouching" in mouse.status["serial_driver: device"][1]["following"], "silence makes it crouch")
    code, output = graph.stop(mouse.driver)
    assert code == 0, output
    assert "Traceback" not in output


def test_a_calibration_that_cannot_be_read_ends_the_driver_with_a_sentence(graph):
    process = graph.start("nermo_hw.nodes.serial_driver", *graph.parameters(calibration="/no/such/file.yaml"))
    output, _ = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 2
    assert "/no/such/file.yaml" in output
    assert "Traceback" not in output


@pytest.mark.parametrize(
    ("parameters", "text"),
    [
        ({"cycle_rate": 300.0}, "cycle_rate = 300.0 Hz does not go with control_rate"),
        ({"cycle_rate": 100.0}, "cycle_rate"),
        ({"joint_rate": 30.0}, "joint_rate = 30.0 Hz"),
        ({"control_rate": 190.0}, "whole milliseconds"),
    ],
)
def test_rates_that_do_not_go_together_are_refused(parameters, text):
    with pytest.raises(ValueError, match=text):
        SerialDriverParameters(**parameters)
