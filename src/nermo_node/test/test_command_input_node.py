"""Command topics with real publishers: one owner, named; stamps of this graph's clock."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from itertools import cycle

import pytest
import rclpy
from geometry_msgs.msg import TwistStamped
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher

from nermo_node import command_input, qos
from nermo_node.command_input import CommandInput
from nermo_node.run import EventsExecutor
from nermo_node.time import to_message, to_nanoseconds

PATIENCE_S = 90.0
NOW = 42 * 10**9


class Robot:
    """A node that is commanded over two topics, and notes what reaches it."""

    def __init__(self, executor_type: type, oldest: float | None) -> None:
        self.node = Node("robot")
        self.executor = executor_type()
        self.executor.add_node(self.node)
        self.taken: list[tuple[float, int]] = []
        self.refused: list[str] = []
        self.commands = CommandInput(self.node, self.refused.append, lambda: NOW, oldest)
        for topic in ("cmd_vel", "other_vel"):
            self.commands.subscribe(TwistStamped, topic, self._take)
        self._senders: list[Node] = []

    def sender(self, name: str, topic: str = "cmd_vel") -> Publisher:
        """The publisher of another node."""
        self._senders.append(Node(name))
        return self._senders[-1].create_publisher(TwistStamped, topic, qos.COMMAND)

    def close(self) -> None:
        self.executor.shutdown()
        for node in (self.node, *self._senders):
            node.destroy_node()

    def _take(self, message: TwistStamped) -> None:
        if message.twist.linear.x > 1.0:
            raise ValueError("too fast")
        self.taken.append((message.twist.linear.x, to_nanoseconds(message.header.stamp)))

    def until(self, condition: Callable[[], bool], what: str, act: Callable[[], None] = lambda: None) -> None:
        deadline = time.monotonic() + PATIENCE_S
        while not condition():
            assert time.monotonic() < deadline, f"waited in vain until {what}"
            act()
            self.executor.spin_once(timeout_sec=0.02)


@pytest.fixture(params=[EventsExecutor, SingleThreadedExecutor])
def robot(request: pytest.FixtureRequest) -> Iterator[Robot]:
    rclpy.init()
    made = Robot(request.param, oldest=0.3)
    yield made
    made.close()
    rclpy.shutdown()


def command(velocity: float, stamp: int = 0) -> TwistStamped:
    message = TwistStamped()
    message.header.stamp = to_message(stamp)
    message.twist.linear.x = velocity
    return message


def test_a_second_publisher_waits_until_the_first_is_silent(robot: Robot) -> None:
    first, second = robot.sender("keyboard"), robot.sender("pad", "other_vel")
    robot.until(lambda: bool(robot.taken), "the first is obeyed", lambda: first.publish(command(0.1)))

    def both() -> None:
        first.publish(command(0.1))
        second.publish(command(0.2))

    robot.until(lambda: bool(robot.refused), "the second is refused", both)
    assert {velocity for velocity, _ in robot.taken} == {0.1}
    assert "other_vel refused: /pad has to wait, /keyboard commands until it is silent for 0.5 s" in robot.refused
    assert robot.commands.status()[1] == "/keyboard commands"
    robot.until(lambda: robot.taken[-1][0] == 0.2, "the second is obeyed at last", lambda: second.publish(command(0.2)))
    assert robot.commands.status()[1] == "/pad commands"


def test_who_is_not_usable_keeps_nobody_out(robot: Robot) -> None:
    noise, late, good = robot.sender("noise"), robot.sender("late"), robot.sender("good")

    everyone = cycle([(noise, command(2.0)), (late, command(0.1, stamp=1_800_000_000 * 10**9)), (good, command(0.3))])

    def one_after_the_other() -> None:
        publisher, message = next(everyone)
        publisher.publish(message)

    robot.until(
        lambda: len(robot.taken) > 5 and len(robot.refused) > 5, "the good one gets through", one_after_the_other
    )
    assert {velocity for velocity, _ in robot.taken} == {0.3}
    assert "cmd_vel refused: too fast" in robot.refused
    assert any("use_sim_time:=true" in text for text in robot.refused)


def test_a_flood_of_stamps_from_the_future_does_not_push_the_good_commands_out(robot: Robot) -> None:
    good, flood = robot.sender("good"), robot.sender("flood")
    robot.until(lambda: bool(robot.taken), "the good one is heard", lambda: good.publish(command(0.3)))
    robot.until(lambda: bool(robot.refused), "the flood is heard", lambda: flood.publish(command(0.1, NOW + 10**12)))
    robot.taken.clear()

    def flooded() -> None:
        good.publish(command(0.3))
        for _ in range(10):
            flood.publish(command(0.1, NOW + 10**12))
        for _ in range(15):  # an executor takes one message a turn
            robot.executor.spin_once(timeout_sec=0.01)

    robot.until(lambda: len(robot.taken) > 5, "the good one gets through", flooded)
    assert {velocity for velocity, _ in robot.taken} == {0.3}
    assert any("in the future" in text or "/flood has to wait, /good commands" in text for text in robot.refused)


def test_a_command_without_a_stamp_counts_as_now(robot: Robot) -> None:
    publisher = robot.sender("typed_by_hand")
    robot.until(lambda: bool(robot.taken), "it is obeyed", lambda: publisher.publish(command(0.1)))
    assert robot.taken[0] == (0.1, NOW)


def test_where_ros_does_not_say_who_sent_several_publishers_are_refused(
    robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(command_input, "sender_of", lambda info: b"")
    first = robot.sender("keyboard")
    robot.until(lambda: bool(robot.taken), "one alone is obeyed", lambda: first.publish(command(0.1)))
    second = robot.sender("pad", "other_vel")
    robot.until(lambda: bool(robot.refused), "both are refused", lambda: second.publish(command(0.2)))
    assert "/keyboard, /pad publish commands" in robot.refused[-1]
    assert {velocity for velocity, _ in robot.taken} == {0.1}


def test_lockstep_leaves_stamps_as_they_are() -> None:
    rclpy.init()
    robot = Robot(EventsExecutor, oldest=None)
    publisher = robot.sender("controller")
    robot.until(lambda: bool(robot.taken), "it is obeyed", lambda: publisher.publish(command(0.1, stamp=5)))
    assert robot.taken[0] == (0.1, 5)
    robot.close()
    rclpy.shutdown()
