"""The README followed word by word, and what the commands print for people to type: is the mouse driven by it?"""

from __future__ import annotations

import math
import os
import re
import signal
import subprocess
from pathlib import Path

import pytest
import typer
from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from terminal import Terminal, left_running

from nermo_bringup import cli
from nermo_description import invocation
from nermo_node import qos

ROOT = Path(__file__).parents[3]
BLOCKS = re.findall(r"(?:^    .+\n)+", (ROOT / "README.md").read_text(encoding="utf-8"), re.MULTILINE)
LINES = [line.partition("  #")[0].strip() for block in BLOCKS for line in block.splitlines()]

DRIVEN = "./nermo drive"  # test_drive_graph.py types its keys
LIVE = [
    "./nermo up --record DIR",
    "./nermo run nermo_bringup keyboard_teleop --ros-args -r __ns:=/nermo",
    "./nermo replay RECORDING",
]
"""Run by `test_who_does_as_the_readme_says_moves_the_mouse`."""
READ_ONLY = [
    "./nermo demo",  # run with --quick by test_demo.py
    "./nermo demo --gap",  # run by test_mice.py
    "./nermo test",  # that is us
    "./nermo up --web",  # test_web_graph.py
    "./nermo up",  # the live one without a recording
    "./nermo experiment straight-line --quick",  # minutes
    "./nermo calibrate --quick",  # many minutes
    "./nermo optimize --cost speed --quick",  # minutes
    "./nermo gap diagnose RECORDING",  # minutes
    "./nermo --help",
]
"""Only read by the command's own parser, which refuses words and options that it does not know."""
BY_HAND = [line for line in LINES if not line.startswith("./nermo")]


def test_every_line_of_the_readme_is_tried() -> None:
    assert sorted(line for line in LINES if line.startswith("./nermo")) == sorted([DRIVEN, *LIVE, *READ_ONLY])


@pytest.mark.parametrize("line", [DRIVEN, *READ_ONLY])
def test_commands_that_take_long_are_at_least_understood(line: str, monkeypatch) -> None:
    read: list[list[str]] = []
    monkeypatch.setattr(cli, "_as_called", lambda part: lambda args, prog_name: read.append(parse(part, args)))
    words = line.split()[1:]
    command = typer.main.get_command(cli.app)
    if words[0] in cli._WORDS or words == ["--help"]:
        with pytest.raises(SystemExit) as end:
            command(words)
        assert end.value.code == 0
    else:
        read.append(parse(cli.app, words))
    assert read or words == ["--help"]


def parse(app: typer.Typer, words: list[str]) -> list[str]:
    """The words, read down to the innermost command. Raises a usage error."""
    command = typer.main.get_command(app)
    context = command.make_context("nermo", list(words))
    while hasattr(command, "commands"):
        name, command, words = command.resolve_command(context, [*context._protected_args, *context.args])
        context = command.make_context(name, list(words), parent=context)
    return words


def test_what_is_typed_by_hand_names_what_is_there() -> None:
    assert len(BY_HAND) == 6, "python3 -m venv to python -m nermo_bringup"
    for line in BY_HAND:
        subprocess.run(["bash", "-nc", line], check=True)
    named = {"requirements.lock", "src", "vendor/tf2_msgs", "install/local_setup.bash", ".venv/bin/colcon"}
    assert all(any(name in line.split() for line in BY_HAND) and (ROOT / name).exists() for name in named)
    by_hand = {name: value for name, value in os.environ.items() if name != invocation.VARIABLE}
    done = subprocess.run(BY_HAND[-1].split(), cwd=ROOT, env=by_hand, capture_output=True, text=True)
    assert done.returncode == 0
    assert "python -m nermo_bringup" in done.stdout


class Watched:
    """Where the mouse is, seen by a node of our own."""

    def __init__(self, graph) -> None:
        self._graph = graph
        self.place = self._from = (0.0, 0.0)
        graph.node.create_subscription(Odometry, "/nermo/truth/odom", self._on_odometry, qos.BEST_EFFORT)

    def _on_odometry(self, message: Odometry) -> None:
        self.place = (message.pose.pose.position.x, message.pose.pose.position.y)

    def moves(self, what: str, meanwhile) -> None:
        """Waits until it has moved by 4 cm, doing something meanwhile."""
        self._from = self.place

        def moved() -> bool:
            meanwhile()
            return math.dist(self._from, self.place) > 0.04

        self._graph.until(moved, what, patience=90.0)


@pytest.fixture
def terminals():
    """Commands typed into terminals that stand in the checkout."""
    opened: list[Terminal] = []

    def type_line(line: str) -> Terminal:
        opened.append(Terminal(line.split(), ROOT))
        return opened[-1]

    yield type_line
    for terminal in opened:
        terminal.close()
    assert not left_running(os.environ["ROS_DOMAIN_ID"])


def test_who_does_as_the_readme_says_moves_the_mouse(graph, terminals, tmp_path: Path) -> None:
    up_line, keyboard_line, replay_line = LIVE
    recording = tmp_path / "recording"
    up = terminals(up_line.replace("DIR", str(recording)))
    up.until(lambda: up.says("Ctrl-C ends all."), "it says how to go on")
    assert keyboard_line in up.text.replace("\n", " "), "what is printed is what the README says"

    mouse = Watched(graph)
    graph.until(lambda: mouse.place != (0.0, 0.0), "the twin is there", patience=90.0)
    keyboard = terminals(keyboard_line)
    mouse.moves("the keys drive", lambda: (up.read(), keyboard.read(), keyboard.type("w")))
    keyboard.type("q")
    assert keyboard.end() == 0

    # The first try of somebody who knows ROS: no stamp, no use_sim_time.
    twists = graph.node.create_publisher(TwistStamped, "/nermo/cmd_vel", 10)
    twist = TwistStamped()
    twist.twist.linear.x = 0.06
    mouse.moves("a twist without a stamp drives", lambda: (up.read(), twists.publish(twist)))
    twist.header.stamp = graph.node.get_clock().now().to_msg()
    words = "its stamp is the wall clock's, but this graph follows a simulation's /clock: start the sender with"
    graph.until(
        lambda: (twists.publish(twist), words in up.read())[1], "a stamp of the wall clock is refused", patience=90.0
    )

    script = tmp_path / "walk.yaml"
    # On two cores that also carry the graph and this test, 3 s of walking took it 4 to 16 cm far.
    script.write_text("duration: 10\ncommands: [{at: 0, posture: walk, forward_velocity: 0.06}]", encoding="utf-8")
    player = terminals(f"./nermo play {script}")
    mouse.moves("a command file drives", lambda: (up.read(), player.read()))
    assert player.end() == 0, player.text
    up.process.send_signal(signal.SIGINT)
    assert up.end() == 0
    assert "Traceback" not in up.text

    replay = terminals(replay_line.replace("RECORDING", str(recording)))
    assert replay.end() == 0
    assert "base_link at the end, replayed less recorded" in replay.text
