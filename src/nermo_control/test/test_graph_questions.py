"""Questions between the controller's nodes: none is lost while a busy machine lets one of them wait."""

from __future__ import annotations

import signal
from collections.abc import Iterator

import pytest
from control_graph import PERIOD, ControlGraph

from nermo_interfaces import msg
from nermo_node import qos
from nermo_node.time import to_message, to_nanoseconds

NAMESPACE = "questions"
QUESTIONS = 60
"""A tick each: as long as a node may be silent while the mouse walks (0.3 s)."""


@pytest.fixture
def graph() -> Iterator[ControlGraph]:
    graph = ControlGraph()
    for name in ("gait_knowledge_base", "trajectory_generator"):
        graph.start(NAMESPACE, name, use_sim_time=False)
    yield graph
    graph.close()


def test_a_trajectory_generator_that_had_to_wait_answers_every_question(graph: ControlGraph) -> None:
    answered: set[int] = set()
    questions = graph.node.create_publisher(msg.LegStates, f"{NAMESPACE}/leg_states", qos.EVENT)
    graph.node.create_subscription(
        msg.FootTrajectories,
        f"{NAMESPACE}/foot_trajectories",
        lambda message: answered.add(to_nanoseconds(message.header.stamp)),
        qos.EVENT,
    )
    stamp = 0

    def ask() -> int:
        nonlocal stamp
        stamp += PERIOD
        question = msg.LegStates()
        question.header.stamp = to_message(stamp)
        questions.publish(question)
        return stamp

    graph.until(lambda: ask() > 0 and bool(answered), "questions are answered")
    last = ask()
    graph.until(lambda: last in answered, "no question is left")
    graph.send(NAMESPACE, "trajectory_generator", signal.SIGSTOP)
    asked = {ask() for _ in range(QUESTIONS)}
    graph.send(NAMESPACE, "trajectory_generator", signal.SIGCONT)
    graph.until(lambda: asked <= answered, "all questions are answered")
