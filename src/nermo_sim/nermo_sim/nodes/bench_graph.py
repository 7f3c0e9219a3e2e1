"""Measurement of the ROS graph: the real processes, at their real rate, walking."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import psutil
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.context import Context
from rclpy.node import Node

from nermo_description.results import CommandError
from nermo_interfaces.msg import ControlCommand, MotionCommand, ServoCommand, ServoStates
from nermo_node import qos
from nermo_node.network import loopback
from nermo_node.run import EventsExecutor

NODES = {
    "gait_knowledge_base": "nermo_control.nodes.gait_knowledge_base",
    "trajectory_generator": "nermo_control.nodes.trajectory_generator",
    "motion_module": "nermo_control.nodes.motion_module",
    "high_level_controller": "nermo_control.nodes.high_level_controller",
    "state_publisher": "nermo_control.nodes.state_publisher",
    "mujoco_sim": "nermo_sim.nodes.mujoco_sim",
}
Processes = dict[str, subprocess.Popen[bytes]]
WITH_ROBOT = ("motion_module", "high_level_controller", "state_publisher", "mujoco_sim", "leg_load_estimator")
DOMAIN = "97"
"""A ROS domain of its own, unless one is chosen: another graph on this machine shall not listen."""
PATIENCE = 60.0
"""Time that the graph gets to come up [s]."""
WARM_UP = 3.0
"""Walking before the measurement [s]."""


def bench_graph(robot: str, duration: float) -> dict[str, Any]:
    """Walks the graph for a time [s] and measures it.

    `latency_ms` is the way of a command: from a `motion_command` to the next `servo_command`, both as another process
    hears them; the wait for the next control tick is part of it. `tick_to_command_ms` is the answer to a tick: from the
    publication of its sensor data to the arrival of its servo command at the simulation.

    Raises CommandError where the graph does not come up.
    """
    with started(robot, NODES) as processes, contextlib.closing(Probe()) as probe:
        probe.walk(processes)
        meters = cpu_meters(processes)
        probe.clear()
        before = probe.sim_status()
        begin = time.monotonic()
        probe.spin(duration)
        wall = time.monotonic() - begin
        cpu = {name: meter.cpu_percent() for name, meter in meters.items()}
        answers, latencies = len(probe.answers), np.array(probe.latencies) * 1e-6
        probe.spin(1.5)  # the next diagnostics cover what was measured
        after = probe.sim_status()
    if len(latencies) == 0:
        raise CommandError("no motion_command was heard: nothing to measure")
    p50, p99 = np.percentile(latencies, [50.0, 99.0])
    return {
        "latency_ms": {"p50": float(p50), "p99": float(p99), "max": float(latencies.max())},
        "tick_to_command_ms": {key: float(after.get(f"command_age_{key}_ms", "nan")) for key in ("p50", "p99", "max")},
        "rate_hz": answers / wall,
        "ticks_missed": int(after.get("ticks_missed", 0)) - int(before.get("ticks_missed", 0)),
        "real_time_factor": float(after.get("real_time_factor", "nan")),
        "cpu_percent": cpu,
        "duration_s": wall,
    }


@contextlib.contextmanager
def started(
    robot: str, nodes: Mapping[str, str], parameters: Mapping[str, Sequence[str]] | None = None
) -> Iterator[Processes]:
    """Runs nodes, name and module each, in a ROS domain of their own, and ends them.

    parameters: Of nodes, by name, that are not the usual ones, each as `name:=value`.
    """
    os.environ.setdefault("ROS_DOMAIN_ID", DOMAIN)
    os.environ.update(loopback(os.environ))
    own = parameters or {}
    processes = {name: _start(name, module, robot, own.get(name, ())) for name, module in nodes.items()}
    try:
        yield processes
    finally:
        for process in processes.values():
            process.terminate()
        for process in processes.values():
            try:
                process.wait(10.0)
            except subprocess.TimeoutExpired:
                process.kill()


def cpu_meters(processes: Processes) -> dict[str, psutil.Process]:
    """Meters whose `cpu_percent` counts from now on."""
    meters = {name: psutil.Process(process.pid) for name, process in processes.items()}
    for meter in meters.values():
        meter.cpu_percent()
    return meters


def _start(name: str, module: str, robot: str, own: Sequence[str]) -> subprocess.Popen[bytes]:
    values = ["use_sim_time:=true", *([f"robot:={robot}"] if name in WITH_ROBOT else []), *own]
    parameters = [word for value in values for word in ("-p", value)]
    code = f"import sys; from {module} import main; sys.exit(main())"
    return subprocess.Popen(
        [sys.executable, "-c", code, "--ros-args", *parameters],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )


def _ended(processes: Processes) -> str | None:
    return next((name for name, process in processes.items() if process.poll() is not None), None)


class Probe:
    """Asks for a walk and takes the times of what it hears."""

    def __init__(self) -> None:
        self._context = Context()
        rclpy.init(context=self._context)
        self._node = Node("bench", context=self._context)
        self._executor = EventsExecutor(context=self._context)  # light: it shares the processor with what it measures
        self._executor.add_node(self._node)
        self._commands = self._node.create_publisher(ControlCommand, "control_command", qos.COMMAND)
        self._node.create_subscription(MotionCommand, "motion_command", self._on_motion_command, qos.EVENT)
        self._node.create_subscription(ServoCommand, "servo_command", self._on_servo_command, qos.EVENT)
        self._node.create_subscription(ServoStates, "servo_states", self._on_servo_states, qos.SENSOR)
        self._node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, qos.EVENT)
        self._unanswered: int | None = None
        self._ticks = 0
        self._status: dict[str, str] = {}
        self.clear()

    def walk(self, processes: Processes) -> None:
        """Waits until the mouse walks. Raises CommandError where it never does."""
        self.spin(PATIENCE, until=lambda: len(self.answers) > 0 or _ended(processes))
        if dead := _ended(processes):
            raise CommandError(f"the node {dead} has ended: run `nermo run` with it to see why")
        if not self.answers:
            raise CommandError(f"no servo_command within {PATIENCE} s")
        self.spin(WARM_UP)

    def hear(self, message: Any, topic: str, callback: Callable[[Any], None]) -> None:
        """Subscribes to one more topic of sensor data."""
        self._node.create_subscription(message, topic, callback, qos.SENSOR)

    def clear(self) -> None:
        """Forgets what was measured."""
        self.answers: list[int] = []
        self.latencies: list[int] = []

    def spin(self, duration: float, until: Callable[[], Any] | None = None) -> None:
        """Listens for a time [s], or until something holds."""
        end = time.monotonic() + duration
        while time.monotonic() < end and not (until is not None and until()):
            self._executor.spin_once(timeout_sec=0.1)

    def sim_status(self) -> dict[str, str]:
        """Newest diagnostics of the simulation."""
        return self._status

    def close(self) -> None:
        """Leaves the graph."""
        self._executor.shutdown()
        self._node.destroy_node()
        rclpy.shutdown(context=self._context)

    def _on_motion_command(self, message: MotionCommand) -> None:
        if self._unanswered is None:
            self._unanswered = time.monotonic_ns()

    def _on_servo_command(self, message: ServoCommand) -> None:
        now = time.monotonic_ns()
        self.answers.append(now)
        if self._unanswered is not None:
            self.latencies.append(now - self._unanswered)
            self._unanswered = None

    def _on_servo_states(self, message: ServoStates) -> None:
        self._ticks += 1
        if self._ticks % 10 == 0:
            command = ControlCommand(forward_velocity=0.08, trajectory_mode=ControlCommand.TRAJECTORY_STRAIGHT_LINE)
            command.header.stamp = message.header.stamp
            self._commands.publish(command)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == "mujoco_sim: twin":
                self._status = {pair.key: pair.value for pair in status.values}
