"""Walks of C in the graph: Cheetah-Cub on its one controller, and the mouse on the loads that its feet feel."""

from __future__ import annotations

import math

import pytest
from nav_msgs.msg import Odometry
from rosgraph_msgs.msg import Clock

from nermo_interfaces.msg import ControlCommand, LegLoads, LegStates, MotionCommand
from nermo_node import qos

pytestmark = pytest.mark.long  # a whole graph

MOUSE = (
    "nermo_control.nodes.gait_knowledge_base",
    "nermo_control.nodes.trajectory_generator",
    "nermo_sensors.nodes.leg_load_estimator",
)
PATIENCE_S = 240.0
"""Seven processes start; on an idle machine the robot is there within 15 s."""


class Walk:
    """An operator who goes by the simulation's clock, and what he sees of the robot."""

    def __init__(self, graph, topic: str, command: ControlCommand | MotionCommand) -> None:
        self._command = command
        self._clock: list[Clock] = []
        self.truth: list[Odometry] = []
        self.legs: list[LegStates] = []
        self.loads: list[LegLoads] = []
        heard = (
            (Clock, "/clock", self._clock),
            (Odometry, "truth/odom", self.truth),
            (LegStates, "leg_states", self.legs),
            (LegLoads, "leg_loads", self.loads),
        )
        for kind, name, messages in heard:
            graph.node.create_subscription(kind, name, messages.append, 10)
        self._publisher = graph.node.create_publisher(type(command), topic, qos.COMMAND)

    def say(self, **changes: object) -> None:
        for field, value in changes.items():
            setattr(self._command, field, value)
        if self._clock:
            self._command.header.stamp = self._clock[-1].clock
            self._publisher.publish(self._command)

    def gone(self, distance: float) -> bool:
        self.say()
        return bool(self.truth) and self.truth[-1].pose.pose.position.x - self.truth[0].pose.pose.position.x > distance

    def apart(self) -> float:
        """How far legs of a diagonal were from each other, as a share of the swing or stance that both were in."""
        pairs = [
            (states.phase_fractions[one], states.phase_fractions[two])
            for states in self.legs
            for one, two in ((0, 3), (1, 2))
            if states.gait_frequency > 0.0 and states.phases[one] == states.phases[two]
        ]
        return max((abs(one - two) for one, two in pairs), default=0.0)

    @property
    def tilt(self) -> float:
        """Angle of the body from the vertical [rad]."""
        q = self.truth[-1].pose.pose.orientation
        return math.acos(1.0 - 2.0 * (q.x**2 + q.y**2))


def test_cheetah_cub_trots_over_topics_and_stands_when_nobody_speaks(graph):
    walk = Walk(graph, "control_command", ControlCommand(forward_velocity=0.4, gait="trot"))
    graph.start("nermo_sim.nodes.mujoco_sim", *graph.parameters(robot="cheetah_cub", stepped=True))
    graph.start("nermo_control.nodes.pantograph_controller", *graph.parameters(lockstep=True, use_sim_time=True))
    # Each topic is discovered on its own: what the legs say may be heard later than where the robot is.
    graph.until(
        lambda: walk.gone(0.25) and bool(walk.legs) and walk.legs[-1].gait_frequency > 2.0,
        "Cheetah-Cub has gone 25 cm, and trots",
        PATIENCE_S,
    )
    assert walk.tilt < 0.5
    # A gait of the mouse alone is refused, and what was said before no longer counts after a while.
    graph.until(lambda: walk.say(gait="walking_trot") or walk.legs[-1].gait_frequency == 0.0, "it stands", PATIENCE_S)


def test_the_mouse_walks_on_the_loads_that_its_feet_feel(graph):
    command = MotionCommand(forward_velocity=0.08, gait="trot", gait_frequency=0.8, turning_strategy="leg")
    walk = Walk(graph, "motion_command", command)
    graph.start("nermo_sim.nodes.mujoco_sim", *graph.parameters(real_time_factor=1.0))
    for module in MOUSE:
        graph.start(module, *graph.parameters(use_sim_time=True))
    graph.start(
        "nermo_control.nodes.motion_module",
        *graph.parameters(coordination="tegotae", use_sim_time=True),
        "-p",
        "oscillators.feedback:=3.0",
        "-p",
        "oscillators.fixed_point_compensation:=false",
    )
    graph.until(lambda: bool(walk.loads), "loads are felt", PATIENCE_S)
    graph.until(lambda: walk.gone(0.05), "the mouse has gone 5 cm", PATIENCE_S)
    assert walk.tilt < 0.5
    assert max(walk.loads[-1].load) > 0.2
    # The loads were heard: by the clock alone, legs of a diagonal swing and stand as one.
    graph.until(lambda: walk.say() or walk.apart() > 0.02, "a diagonal's legs part", PATIENCE_S)
