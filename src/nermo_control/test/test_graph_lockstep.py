"""The two harnesses agree: the graph over rclpy in lockstep gives what the loop in one process gives."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator

import pytest
from control_graph import PERIOD, REPEAT_AFTER_S, ControlGraph, GraphRobot
from graph_bench import PATIENCE_S

from nermo_control.controller import Controller
from nermo_control.gait.knowledge_base import GaitParameters
from nermo_control.types import ControlCommand, Odometry, Posture, TrajectoryMode
from nermo_description.parameters import RobotParameters

SECONDS = 60
TICKS = round(SECONDS * 1e9 / PERIOD)
KILLED_AT = 1001
"""Tick at which the trajectory generator is killed; in lockstep the robot waits for the next."""


@pytest.fixture
def graph() -> Iterator[ControlGraph]:
    graph = ControlGraph()
    yield graph
    graph.close()


def script(tick: int, stamp: int) -> ControlCommand:
    """60 s of standing up, walking in all gaits, turning, holding a line, stopping and lying down."""
    second = tick * PERIOD * 1e-9
    walk = {"forward_velocity": 0.05 + 0.02 * math.sin(0.3 * second), "turn_rate": 0.15 * math.sin(0.5 * second)}
    for until, wish in (
        (2.0, {"posture": Posture.STAND}),
        (12.0, {**walk, "gait": "trot"}),
        (22.0, {**walk, "gait": "walking_trot", "gait_frequency": 1.1}),
        (32.0, {**walk, "gait": "lateral_walk", "gait_frequency": 0.7, "turning_strategy": "mix"}),
        (35.0, {}),
        (45.0, {"forward_velocity": -0.04, "gait": "trot", "gait_frequency": 0.9}),
        (55.0, {"forward_velocity": 0.06, "trajectory_mode": TrajectoryMode.STRAIGHT_LINE}),
        (58.0, {"posture": Posture.SIT}),
        (60.0, {"posture": Posture.CROUCH}),
    ):
        if second < until:
            return ControlCommand(stamp, **wish)  # type: ignore[arg-type]
    raise AssertionError(f"no command for {second} s")


def pose(tick: int, stamp: int) -> Odometry:
    """A mouse that wanders, so that holding the line has something to do."""
    second = tick * PERIOD * 1e-9
    return Odometry(stamp, 0.05 * second, 0.02 * math.sin(second), 0.1 * math.sin(0.7 * second))


def test_60_s_of_walking_are_the_same_in_process_and_through_the_graph(
    graph: ControlGraph, robot: RobotParameters
) -> None:
    mouse = GraphRobot(graph, "lockstep", robot)
    graph.start_all("lockstep", lockstep=True)
    controller = Controller(robot, GaitParameters(), PERIOD)
    largest, walked = 0.0, 0
    for tick in range(TICKS):
        mouse.stamp += PERIOD
        if tick == KILLED_AT:
            graph.kill("lockstep", "trajectory_generator")
            graph.start("lockstep", "trajectory_generator")
        command, odometry = script(tick, mouse.stamp), pose(tick, mouse.stamp)
        expected = controller.step(mouse.stamp, command, odometry, mouse.servos)
        deadline = time.monotonic() + PATIENCE_S
        while not mouse.answered():
            mouse.send(command)
            mouse.publish(odometry)
            repeat = time.monotonic() + REPEAT_AFTER_S
            while not mouse.answered() and time.monotonic() < repeat:
                graph.spin_once(0.05)
            assert time.monotonic() < deadline, f"no servo command for tick {tick}"
        largest = max(largest, *map(abs, map(float.__sub__, mouse.servos, expected.servo_positions)))
        walked += expected.leg_states.gait_frequency > 0.0
    assert largest <= 1e-9
    assert walked * PERIOD * 1e-9 > 45.0
