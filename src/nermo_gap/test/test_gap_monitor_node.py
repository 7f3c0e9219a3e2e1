"""The node in a graph with a twin: it sees that robot and twin agree, and the leg in which they do not."""

from __future__ import annotations

import math
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from graph_bench import GraphBench
from sensor_msgs.msg import Imu, JointState

from nermo_description.robots import load_robot
from nermo_interfaces.msg import ServoCommand, ServoStates
from nermo_node import qos
from nermo_node.time import to_message
from nermo_sim.twin import Twin

PATIENCE = 120.0


class Robot(GraphBench):
    """A robot of its own: sends commands and what it measures, hears what the monitor says."""

    def __init__(self, robot: str) -> None:
        super().__init__("robot")
        self._twin = Twin(load_robot(robot))
        self._servos = list(load_robot(robot).servos)
        self._neutral = [s.neutral for s in load_robot(robot).servos.values()]
        self._commands = self.node.create_publisher(ServoCommand, "servo_command", 200)
        self._states = self.node.create_publisher(ServoStates, "servo_states", qos.SENSOR)
        self._imu = self.node.create_publisher(Imu, "imu/data_raw", qos.SENSOR)
        self.diagnostics: list[DiagnosticArray] = []
        self.twins: dict[str, float] = {}
        """Angles [rad] of the monitor's twin by joint."""
        self.node.create_subscription(JointState, "twin/joint_states", self._on_twin, qos.BEST_EFFORT)
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self.diagnostics.append, 100)
        self._tick = 0

    def _on_twin(self, message: JointState) -> None:
        self.twins = dict(zip(message.name, message.position, strict=True))

    def step(self) -> None:
        """One tick."""
        stamp = to_message(self._twin.time_ns)
        told = [n + 0.15 * math.sin(0.03 * self._tick) for n in self._neutral]
        command = ServoCommand(name=self._servos, position=told)
        command.header.stamp = stamp
        self._commands.publish(command)
        sensors = self._twin.step(told)
        self._tick += 1
        states = ServoStates(name=self._servos, position=sensors.servo_positions)
        imu = Imu()
        states.header.stamp = imu.header.stamp = to_message(sensors.stamp)
        imu.angular_velocity.x, imu.angular_velocity.y, imu.angular_velocity.z = sensors.angular_velocity
        self._states.publish(states)
        self._imu.publish(imu)
        self.spin_once(0.004)

    def status(self) -> dict[str, Any]:
        """The newest of what the monitor says; empty before the first."""
        for array in reversed(self.diagnostics):
            for status in array.status:
                if status.name == "gap_monitor: gap":
                    return {"message": status.message, **{v.key: v.value for v in status.values}}
        return {}

    def walk_until(self, condition: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
        """Goes on until the monitor says what is waited for."""
        heard = (self._commands, self._states)
        self.until(lambda: all(publisher.get_subscription_count() > 0 for publisher in heard), "somebody listens")
        deadline = time.monotonic() + PATIENCE
        while not condition(self.status()):
            assert time.monotonic() < deadline, f"waited in vain; the last was {self.status()}"
            self.step()
        return self.status()


@pytest.fixture
def weak(tmp_path: Path) -> Path:
    """A parameter file of a mouse with a weak servo."""
    path = tmp_path / "weak.yaml"
    path.write_text(
        "name: weak\nbase: nermo_lite\n"
        "deviations: [{effect: servo_gain, sites: [rear_left_knee], values: {factor: 0.2}}]\n",
        encoding="utf-8",
    )
    return path


@pytest.fixture
def monitor() -> Iterator[subprocess.Popen[str]]:
    process = subprocess.Popen([sys.executable, "-m", "nermo_gap.nodes.gap_monitor"], text=True)
    yield process
    process.terminate()
    assert process.wait(timeout=PATIENCE) == 0


@pytest.mark.usefixtures("monitor")
def test_the_monitor_names_the_leg_in_which_the_robot_differs(weak: Path) -> None:
    own = Robot("nermo_lite")
    try:
        status = own.walk_until(lambda s: "agree" in s.get("message", ""))
        assert float(status["front_left_leg_gap"]) < 3.0 and "body_gap" in status
        own.walk_until(lambda _: "front_left_hip_joint" in own.twins)
        # A hip's joint is what its servo turns; all swing by 0.15 rad about their neutral angle.
        neutral = load_robot("nermo_lite").servos["front_left_hip"].neutral
        assert abs(own.twins["front_left_hip_joint"] - neutral) < 0.2
    finally:
        own.close()
    # The other robot begins at stamp 0 again, as after a restart of the graph.
    other = Robot(str(weak))
    try:
        other.walk_until(lambda s: "rear_left leg" in s.get("message", ""))
    finally:
        other.close()


ARM = """<mujoco model="arm"><option timestep="0.005" integrator="implicitfast"/><worldbody><body>
<joint name="shoulder" axis="0 1 0" damping="0.05" armature="0.01" frictionloss="0.1"/>
<geom type="capsule" fromto="0 0 0 0 0 -.3" size=".025" mass="1"/></body></worldbody>
<actuator><position name="servo" joint="shoulder" kp="30" kv="1" forcerange="-15 15"/></actuator></mujoco>"""
MAP = """
inputs: [{topic: told, field: position, index: 0, actuator: servo, kind: position, unit: rad}]
outputs: [{topic: measured, field: position, joint: shoulder, quantity: position, unit: rad}]
"""


class Arm(GraphBench):
    """Another robot: it says on two topics what it is told and what it measures, faster than real time."""

    def __init__(self) -> None:
        super().__init__("arm")
        self._told = self.node.create_publisher(JointState, "told", qos.SENSOR)
        self._measured = self.node.create_publisher(JointState, "measured", qos.SENSOR)
        self.diagnostics: list[DiagnosticArray] = []
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self.diagnostics.append, 100)
        self.model = mujoco.MjModel.from_xml_string(ARM)
        self._data, self._rng = mujoco.MjData(self.model), np.random.default_rng(0)

    def step(self) -> None:
        """One tick of 5 ms."""
        t = self._data.time
        command = 0.5 * math.sin(3.1 * t) + 0.3 * math.sin(7.3 * t + 1.0)
        stamp = to_message(10**9 + round(t * 1e9))
        told, measured = JointState(name=["shoulder"], position=[command]), JointState(name=["shoulder"])
        measured.position = [float(self._data.qpos[0] + 3e-4 * self._rng.standard_normal())]
        told.header.stamp = measured.header.stamp = stamp
        self._told.publish(told)
        self._measured.publish(measured)
        self._data.ctrl[0] = command
        mujoco.mj_step(self.model, self._data)
        self.spin_once(0.001)

    def move_until(self, condition: Callable[[str], bool]) -> DiagnosticStatus:
        """Moves until the monitor says what is waited for."""
        deadline = time.monotonic() + PATIENCE
        while not any(condition(s.message) for s in self.said()[-1:]):
            assert time.monotonic() < deadline, f"waited in vain; the last was {self.said()[-1:]}"
            self.step()
        return self.said()[-1]

    def said(self) -> list[DiagnosticStatus]:
        """What the monitor said of the gap."""
        return [s for array in self.diagnostics for s in array.status if s.name == "gap_monitor: gap"]


def test_the_monitor_knows_any_robot_by_its_map(tmp_path: Path) -> None:
    """Topics are found as they appear; what is usual is learned; friction that triples makes the model stale."""
    (tmp_path / "arm.xml").write_text(ARM, encoding="utf-8")
    (tmp_path / "map.yaml").write_text(MAP, encoding="utf-8")
    words = ["-p", f"model:={tmp_path / 'arm.xml'}", "-p", f"map:={tmp_path / 'map.yaml'}"]
    process = subprocess.Popen([sys.executable, "-m", "nermo_gap.nodes.gap_monitor", "--ros-args", *words], text=True)
    arm = Arm()
    try:
        healthy = arm.move_until(lambda message: "agree" in message)
        assert healthy.level == DiagnosticStatus.OK and healthy.hardware_id == "arm"
        assert {"shoulder_gap", "shoulder_usual"} <= {pair.key for pair in healthy.values}
        arm.model.dof_frictionloss[0] *= 3.0
        stale = arm.move_until(lambda message: "stale" in message)
        assert stale.level == DiagnosticStatus.WARN and "shoulder" in stale.message
    finally:
        arm.close()
        process.terminate()
        assert process.wait(timeout=PATIENCE) == 0
