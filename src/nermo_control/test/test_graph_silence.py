"""Who goes missing while the mouse walks, and what comes in that makes no sense: it stops, and it walks again."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import pytest
from control_graph import NODES, PERIOD, ControlGraph, GraphRobot
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, TwistStamped
from nav_msgs.msg import Path

from nermo_control.nodes.conversions import header
from nermo_control.types import ControlCommand, Posture, TrajectoryMode
from nermo_description.parameters import RobotParameters
from nermo_interfaces import msg
from nermo_node import qos

WALK = ControlCommand(0, forward_velocity=0.08)
NAMESPACE = "silence"
STOPPED_AFTER = 0.5
STANCE_HEIGHTS = (-0.045, -0.045, -0.05, -0.05)
"""N table A.7 [m]."""


@pytest.fixture(scope="module")
def graph() -> Iterator[ControlGraph]:
    graph = ControlGraph()
    for name in NODES:
        graph.start(NAMESPACE, name)
    yield graph
    graph.close()


@pytest.fixture(scope="module")
def robot_in_graph(graph: ControlGraph, robot: RobotParameters) -> GraphRobot:
    return GraphRobot(graph, NAMESPACE, robot)


@pytest.fixture
def mouse(robot_in_graph: GraphRobot) -> GraphRobot:
    """A mouse that walks."""
    mouse = robot_in_graph
    mouse.command = WALK
    mouse.run_until(lambda: mouse.walking and mouse.moves(0.5) > 0.1, "the mouse walks")
    del mouse.answers[:-1]
    return mouse


def assert_stands(mouse: GraphRobot) -> None:
    """After what has just been done to it."""
    mouse.run(STOPPED_AFTER)
    mouse.run(0.2)
    assert mouse.moves(0.2) == 0.0
    assert mouse.largest_jump() <= 1.0 + 1e-9


def assert_on_four_feet(mouse: GraphRobot) -> None:
    assert mouse.foot_heights() == pytest.approx(STANCE_HEIGHTS, abs=1e-6)


def assert_walks_again(mouse: GraphRobot) -> None:
    mouse.run_until(lambda: mouse.walking and mouse.moves(0.5) > 0.1, "the mouse walks again")
    assert mouse.largest_jump() <= 1.0 + 1e-9


@pytest.mark.parametrize("name", NODES)
def test_a_killed_node_stops_the_mouse_and_it_walks_again_when_the_node_is_back(
    graph: ControlGraph, mouse: GraphRobot, name: str
) -> None:
    graph.kill(NAMESPACE, name)
    killed = mouse.stamp
    mouse.walking = False
    assert_stands(mouse)
    if name == "motion_module":
        assert mouse.answers[-1][0] <= killed, "a dead node sends no command, and the robot holds"
    else:
        assert_on_four_feet(mouse)
        mouse.run_until(mouse.answered, "a living one sends commands")
    graph.start(NAMESPACE, name)
    assert_walks_again(mouse)


def test_silence_of_the_operator_stops_the_mouse(mouse: GraphRobot) -> None:
    mouse.command = None
    assert_stands(mouse)
    assert_on_four_feet(mouse)
    mouse.command = WALK
    assert_walks_again(mouse)


@pytest.mark.parametrize(
    ("bad", "words"),
    [
        ({"forward_velocity": math.nan}, "forward_velocity = nan"),
        ({"forward_velocity": math.inf}, "forward_velocity = inf"),
        ({"turn_rate": -math.inf}, "turn_rate = -inf"),
        ({"gait": "gallop"}, "gait = 'gallop' is unknown"),
        ({"gait_frequency": -0.0001}, "gait_frequency"),
        ({"gait_frequency": 50.0}, "gait_frequency = 50.0 Hz: allowed 0.1 to 3.0 Hz"),
        ({"posture": 77}, "posture = 77 is unknown"),
    ],
)
def test_a_bad_command_is_refused_in_words_and_the_mouse_stops(
    graph: ControlGraph, mouse: GraphRobot, bad: dict[str, object], words: str
) -> None:
    told: list[str] = []

    def listen(message: DiagnosticArray) -> None:
        for status in message.status:
            told.append(status.message)
            told.extend(pair.value for pair in status.values)

    subscription = graph.node.create_subscription(DiagnosticArray, "/diagnostics", listen, 10)
    mouse.command = replace(WALK, **bad)  # type: ignore[arg-type]
    assert_stands(mouse)
    assert_on_four_feet(mouse)
    mouse.run_until(lambda: any(words in text for text in told), f"{words} is told")
    graph.node.destroy_subscription(subscription)
    mouse.command = WALK
    assert_walks_again(mouse)


def test_frequency_0_stands_for_the_default(mouse: GraphRobot) -> None:
    mouse.command = replace(WALK, gait_frequency=0.0)
    mouse.run(1.0)
    # Refused, it would have made the mouse stand by now, for good.
    assert_walks_again(mouse)


def test_a_servo_that_does_not_exist_is_refused_by_name(graph: ControlGraph, mouse: GraphRobot) -> None:
    told: list[str] = []
    subscription = graph.node.create_subscription(
        DiagnosticArray, "/diagnostics", lambda array: told.extend(status.message for status in array.status), 10
    )
    publisher = graph.node.create_publisher(msg.ServoStates, f"{NAMESPACE}/servo_states", qos.SENSOR)
    bad = msg.ServoStates(header=header(mouse.stamp), name=["front_left_wing"], position=[0.0])

    def heard() -> bool:
        publisher.publish(bad)
        return any("unknown servo front_left_wing" in text for text in told)

    mouse.run_until(heard, "the servo is named")
    # It may be named at once, when the fixture has just forgotten how the mouse moved.
    assert_walks_again(mouse)
    graph.node.destroy_publisher(publisher)
    graph.node.destroy_subscription(subscription)


def test_cmd_vel_walks_and_times_out(graph: ControlGraph, mouse: GraphRobot) -> None:
    mouse.command = None
    assert_stands(mouse)
    publisher = graph.node.create_publisher(TwistStamped, f"{NAMESPACE}/cmd_vel", qos.COMMAND)
    twist = TwistStamped()
    twist.twist.linear.x = 0.05

    def walks() -> bool:
        if mouse.stamp // PERIOD % 10 == 0:
            twist.header = header(mouse.stamp)
            publisher.publish(twist)
        return mouse.walking and mouse.moves(0.5) > 0.1

    mouse.run_until(walks, "the mouse walks")
    assert_stands(mouse)
    assert_on_four_feet(mouse)
    graph.node.destroy_publisher(publisher)


def test_a_path_is_walked_once_it_is_given_and_until_it_is_taken_away(graph: ControlGraph, mouse: GraphRobot) -> None:
    mouse.command = replace(WALK, trajectory_mode=TrajectoryMode.PATH)
    assert_stands(mouse)
    publisher = graph.node.create_publisher(Path, f"{NAMESPACE}/path", qos.COMMAND)
    path = Path(header=header(0, "odom"), poses=[PoseStamped(), PoseStamped()])
    path.poses[1].pose.position.x = 5.0

    def walks() -> bool:
        if mouse.stamp // PERIOD % 40 == 0 and not mouse.walking:
            publisher.publish(path)
        return mouse.walking and mouse.moves(0.5) > 0.1

    mouse.run_until(walks, "the mouse walks along the path")
    publisher.publish(Path())
    mouse.run_until(lambda: mouse.moves(0.2) == 0.0, "the mouse stands without a path")
    graph.node.destroy_publisher(publisher)


@pytest.mark.parametrize("posture", [Posture.SIT, Posture.CROUCH, Posture.STAND])
def test_postures(mouse: GraphRobot, robot: RobotParameters, posture: Posture) -> None:
    mouse.command = ControlCommand(0, posture=posture)
    wanted = list(robot.posture(posture.name.lower()).values())
    mouse.run_until(lambda: mouse.servos == pytest.approx(wanted, abs=1e-3), f"the mouse is in {posture.name}")
    assert mouse.largest_jump() <= 1.0 + 1e-9
