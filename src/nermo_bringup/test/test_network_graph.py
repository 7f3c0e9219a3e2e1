"""Who takes part in a graph: two machines, as two network namespaces that are joined by a wire."""

from __future__ import annotations

import os
import signal
import sys
import time

import pytest

from nermo_hw.bench.network import Network
from nermo_node.network import RANGE, loopback, subnet

PATIENCE_S = 90.0
NODE = ("nermo_control", "gait_knowledge_base", "--ros-args", "-r", "__ns:=/nermo", "-r")

ONLOOKER = """
import os, sys, rclpy
from nermo_interfaces.msg import GaitParameters
from nermo_node import qos
os.environ.update(eval(sys.argv[1]))
rclpy.init()
node = rclpy.create_node("onlooker")
heard = []
node.create_subscription(GaitParameters, "/nermo/gait_parameters", heard.append, qos.LATCHED)
for line in sys.stdin:
    rclpy.spin_once(node, timeout_sec=0.2)
    print(*sorted({*node.get_node_names()} - {"onlooker"}), "heard" if heard else "", flush=True)
"""


@pytest.fixture
def wire(monkeypatch):
    """Two machines and the wire between them. Whoever works there has chosen nothing."""
    opened = subnet(os.environ)
    for name in {name for name, value in os.environ.items() if opened.get(name) != value} | {RANGE}:
        monkeypatch.delenv(name)
    network = Network()
    yield network
    network.close()


def start(wire: Network, name: str, *options: str) -> None:
    """A node of the graph on the robot, started as a user does."""
    command = [sys.executable, "-m", "nermo_bringup", "run", *options, *NODE, f"__node:={name}"]
    wire.do("start", name=name, side="robot", command=command)


def look_from(wire: Network, side: str, environment: dict[str, str], name: str = "") -> None:
    wire.do(
        "start", name=name or side, side=side, command=[sys.executable, "-c", ONLOOKER, repr(environment)], talks=True
    )


def seen(wire: Network, name: str, words: str) -> str:
    """What is seen of the graph as soon as it has these words: the names of its nodes, and whether one is heard."""
    deadline = time.monotonic() + PATIENCE_S
    while words not in (view := wire.do("tell", name=name, line="look\n").strip()):
        assert time.monotonic() < deadline, f"sees {view!r}, never {words!r}"
    return view


def test_another_machine_sees_a_graph_only_where_it_was_opened(wire: Network) -> None:
    start(wire, "closed")
    look_from(wire, "robot", loopback({}))
    assert seen(wire, "robot", "closed heard") == "closed heard", "its own machine sees it"
    look_from(wire, "workstation", {})
    look_from(wire, "robot", {}, "ros")
    assert seen(wire, "ros", "closed heard") == "closed heard", "who uses ROS on the same machine needs no setting"
    start(wire, "opened", "--network", "subnet")
    # What was opened later is seen by everybody, so there was time enough to see what was not.
    assert seen(wire, "workstation", "opened heard") == "opened heard"
    assert seen(wire, "robot", "closed opened heard") == "closed opened heard"
    for name in ("opened", "closed"):
        assert wire.do("signal", name=name, number=int(signal.SIGINT)) == 0
