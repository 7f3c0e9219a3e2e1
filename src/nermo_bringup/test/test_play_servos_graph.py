"""`nermo play` with servo positions into a plain `nermo up`, on the twin and at an emulated cable."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from nermo_bringup.launch.running_graph import running_graph
from nermo_interfaces.msg import ServoCommand, ServoStates
from nermo_node import qos

pytestmark = pytest.mark.long  # a whole graph

PATIENCE_S = 240.0
TOLD, BENT, UP = -0.4, -0.1, 0.0
"""[rad] Where the knee is told to be, where it counts as being there (a servo lags by up to 0.1 rad under load), and
where it is again in the stand (0.13)."""
SQUAT = f"""
duration: 600
commands:
  - {{at: 0, posture: stand}}
  - {{at: 1, servos: {{front_left_knee: {TOLD}}}}}
"""


@pytest.mark.parametrize("target", ["sim", "serial"])
def test_played_servo_positions_move_the_knee_and_when_they_end_the_mouse_stands(
    graph, tmp_path: Path, target: str
) -> None:
    file = tmp_path / "squat.yaml"
    file.write_text(SQUAT)
    knees: list[float] = []
    targets: list[ServoCommand] = []

    def heard(states: ServoStates) -> None:
        knees.append(states.position[list(states.name).index("front_left_knee")])

    graph.node.create_subscription(ServoStates, "/nermo/servo_states", heard, qos.BEST_EFFORT)
    graph.node.create_subscription(ServoCommand, "/nermo/servo_targets", targets.append, qos.COMMAND)
    with running_graph({"target": target, "teleop": "none"}, tmp_path / "graph.log") as running:
        graph.until(lambda: bool(knees), "the graph is up", PATIENCE_S)
        player = subprocess.Popen([sys.executable, "-m", "nermo_bringup", "play", str(file)])
        try:
            # A mouse without power lies as it fell, with a bent knee now and then.
            graph.until(lambda: bool(targets), "servo positions are played", PATIENCE_S)
            graph.until(lambda: knees[-1] < BENT, "the knee is where it was told to be", PATIENCE_S)
            running.check()
            assert player.poll() is None
        finally:
            player.terminate()
            player.wait(PATIENCE_S)
        graph.until(lambda: knees[-1] > UP, "the mouse stands", PATIENCE_S)
