"""A test robot that plays the clock, and the controller's nodes as processes beside it."""

from __future__ import annotations

import math
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace

from graph_bench import PATIENCE_S, GraphBench
from nav_msgs.msg import Odometry
from rosgraph_msgs.msg import Clock

from nermo_control import types
from nermo_control.legs.kinematics import LegKinematics
from nermo_control.nodes import conversions
from nermo_control.types import ControlCommand
from nermo_description.parameters import LEGS, RobotParameters
from nermo_interfaces import msg
from nermo_node import qos
from nermo_node.run import EventsExecutor
from nermo_node.time import to_message, to_nanoseconds

PERIOD = 5_000_000
REPEAT_AFTER_S = 0.5
CLOCK_EVERY = 4
"""Ticks for one /clock: only the knowledge-base's stamps and its sign of life go by it."""
ANSWER_WITHIN_S = 1.0
"""Outside lockstep a tick waits so long for its command, so that a busy machine slows the simulated time down."""
UNANSWERED_S = 0.02
"""The same after a tick without a command: nobody may be there to send one."""

NODES = ("gait_knowledge_base", "high_level_controller", "motion_module", "trajectory_generator", "state_publisher")
LOCKSTEP_NODES = ("high_level_controller", "motion_module", "state_publisher")


class ControlGraph(GraphBench):
    """Node processes of one test and the test's own place in the graph."""

    def __init__(self) -> None:
        super().__init__(executor=EventsExecutor, start_parameter_services=False)
        self._nodes: dict[tuple[str, str], subprocess.Popen[str]] = {}

    def start(self, namespace: str, name: str, **parameters: object) -> None:
        """Starts a node; parameters are given as ROS arguments."""
        arguments = ["-r", f"__ns:=/{namespace}"]
        for key, value in {"use_sim_time": True, **parameters}.items():
            arguments += ["-p", f"{key.replace('__', '.')}:={str(value).lower() if isinstance(value, bool) else value}"]
        command = [sys.executable, "-m", f"nermo_control.nodes.{name}", "--ros-args", *arguments]
        self._nodes[namespace, name] = self.begin(command)

    def start_all(self, namespace: str, lockstep: bool = False) -> None:
        """Starts all nodes of the controller."""
        for name in NODES:
            self.start(namespace, name, **({"lockstep": True} if lockstep and name in LOCKSTEP_NODES else {}))

    def kill(self, namespace: str, name: str) -> None:
        """SIGKILL: no time for a last word."""
        self.stop(self._nodes.pop((namespace, name)), signal.SIGKILL)

    def send(self, namespace: str, name: str, number: signal.Signals) -> None:
        """Sends a node a signal."""
        self._nodes[namespace, name].send_signal(number)


class GraphRobot:
    """A robot whose servos do exactly what they are told. It publishes each tick of 5 ms, and the clock."""

    def __init__(self, graph: ControlGraph, namespace: str, robot: RobotParameters, clock: bool = True) -> None:
        node = graph.node
        self._graph, self._robot, self.namespace = graph, robot, namespace
        self.stamp = 1_000_000_000
        self.servos = [servo.neutral for servo in robot.servos.values()]
        self.command: ControlCommand | None = None
        """Sent with each tenth tick, stamped then; None: silence."""
        self.answers: list[tuple[int, list[float]]] = []
        """Servo commands with their stamps."""
        self.walking = False
        self._within = UNANSWERED_S
        self._arrays = conversions.ServoArrays(robot)
        self._clock = node.create_publisher(Clock, "/clock", qos.SENSOR) if clock else None
        self._servo_states = node.create_publisher(msg.ServoStates, f"{namespace}/servo_states", qos.SENSOR)
        self._odometry = node.create_publisher(Odometry, f"{namespace}/truth/odom", qos.SENSOR)
        self.control = node.create_publisher(msg.ControlCommand, f"{namespace}/control_command", qos.COMMAND)
        self._subscriptions = [
            node.create_subscription(msg.ServoCommand, f"{namespace}/servo_command", self._on_command, qos.EVENT),
            node.create_subscription(msg.LegStates, f"{namespace}/leg_states", self._on_leg_states, qos.EVENT),
        ]

    def send(self, command: ControlCommand) -> None:
        """Sends a command at once."""
        self.control.publish(conversions.control_command_to_message(command))

    def publish(self, odometry: types.Odometry | None = None) -> None:
        """Publishes the sensor data of the present tick."""
        if self._clock is not None and self.stamp // PERIOD % CLOCK_EVERY == 0:
            self._clock.publish(Clock(clock=to_message(self.stamp)))
        pose = odometry or types.Odometry(self.stamp, 0.0, 0.0, 0.0)
        self._odometry.publish(conversions.odometry_to_message(pose))
        self._servo_states.publish(
            msg.ServoStates(header=conversions.header(self.stamp), name=self._arrays.names, position=self.servos)
        )

    def answered(self) -> bool:
        """Whether the command of the present tick has come."""
        return bool(self.answers) and self.answers[-1][0] == self.stamp

    def tick(self) -> None:
        """One tick in real time, or slower where the graph is slower."""
        began = time.monotonic()
        self.stamp += PERIOD
        if self.command is not None and self.stamp // PERIOD % 10 == 0:
            self.send(replace(self.command, stamp=self.stamp))
        self.publish()
        while (elapsed := time.monotonic() - began) < (PERIOD * 1e-9 if self.answered() else self._within):
            self._graph.spin_once(min(0.002, max(0.0, PERIOD * 1e-9 - elapsed)))
        self._within = ANSWER_WITHIN_S if self.answered() else UNANSWERED_S

    def run(self, seconds: float) -> None:
        """Ticks for a while of simulated time."""
        for _ in range(round(seconds * 1e9 / PERIOD)):
            self.tick()

    def run_until(self, condition: Callable[[], bool], what: str) -> None:
        """Ticks until something holds."""
        deadline = time.monotonic() + PATIENCE_S
        while not condition():
            self._graph.alive(what)
            assert time.monotonic() < deadline, f"waited {PATIENCE_S:g} s in vain until {what}"
            self.tick()

    def moves(self, seconds: float) -> float:
        """Largest move of a servo in the last while of simulated time [rad]; 0 without any commands."""
        recent = [positions for stamp, positions in self.answers if stamp > self.stamp - seconds * 1e9]
        return max((max(column) - min(column) for column in zip(*recent, strict=True)), default=0.0)

    def foot_heights(self) -> list[float]:
        """z of the feet in the leg planes [m], of the last command."""
        place = {name: number for number, name in enumerate(self._robot.servos)}
        heights = []
        for leg in LEGS:
            pair = "front" if leg.startswith("front") else "rear"
            kinematics = LegKinematics(self._robot.front_leg if pair == "front" else self._robot.rear_leg, pair)
            heights.append(kinematics.forward(self.servos[place[f"{leg}_hip"]], self.servos[place[f"{leg}_knee"]])[1])
        return heights

    def largest_jump(self) -> float:
        """Largest change of a servo between two commands that came, over what it can do in the time between them.

        A busy machine loses commands: each supersedes the one before.
        """
        jump = 0.0
        fastest = [servo.max_velocity for servo in self._robot.servos.values()]
        for (earlier, before), (later, after) in zip(self.answers, self.answers[1:], strict=False):
            time = max(later - earlier, PERIOD) * 1e-9
            jump = max(jump, *(abs(b - a) / (v * time) for a, b, v in zip(before, after, fastest, strict=True)))
        return jump

    def _on_command(self, message: msg.ServoCommand) -> None:
        positions = self._arrays.positions(message)
        assert all(map(math.isfinite, positions)), f"a command that is not finite: {positions}"
        self.servos = positions
        self.answers.append((to_nanoseconds(message.header.stamp), positions))

    def _on_leg_states(self, message: msg.LegStates) -> None:
        self.walking = message.gait_frequency > 0.0
