"""Parameters that can be changed, of nodes that come and go."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
from graph_bench import GraphBench
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from nermo_web.nodes.live_parameters import LiveParameters


@pytest.fixture
def bench() -> Iterator[GraphBench]:
    made = GraphBench(namespace="nermo")
    try:
        yield made
    finally:
        made.close()


def rows(live: LiveParameters) -> dict[str, Any]:
    return {node["node"]: {row["name"]: row["value"] for row in node["parameters"]} for node in live.table()}


def test_a_node_that_comes_again_is_asked_again_and_takes_no_more_clients(bench: GraphBench) -> None:
    context = bench.node.context
    assert context is not None
    live = LiveParameters(bench.node, lambda: None)
    numbers = []
    answers: list[tuple[bool, str]] = []

    def heard(taken: bool, words: str) -> None:
        answers.append((taken, words))

    for value in (0.5, 0.75, 1.0):
        other = Node("gaits", namespace="nermo", context=context)
        other.declare_parameter("height", value)
        served = SingleThreadedExecutor(context=context)
        served.add_node(other)

        def told(wanted: dict[str, Any], served: SingleThreadedExecutor = served) -> bool:
            served.spin_once(timeout_sec=0.0)
            return rows(live) == wanted

        bench.until(lambda value=value: told({"gaits": {"height": value}}), "it is shown")
        numbers.append(len(list(bench.node.clients)))
        answers.clear()
        live.set("gaits", "height", 2.0, heard)
        bench.until(lambda: told({"gaits": {"height": 2.0}}) and answers, "it is set")
        assert answers == [(True, "gaits: height = 2.0")]
        served.shutdown()
        other.destroy_node()
        bench.until(lambda: rows(live) == {}, "it is gone")
        live.set("gaits", "height", 3.0, heard)
        assert answers[1] == (False, "gaits has no parameter 'height' that can be changed")
    assert len(set(numbers)) == 1, numbers
