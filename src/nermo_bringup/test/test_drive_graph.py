"""`nermo drive` as a person uses it: one terminal, and keys."""

from __future__ import annotations

import os
import re
import signal
import sys
from pathlib import Path

import numpy as np
import pytest
from terminal import Terminal, left_running

from nermo_node.recording_reader import Recording

DRIVE = [sys.executable, "-m", "nermo_bringup", "drive"]
LIMP = "EMERGENCY STOP, limp: emergency_stop"
"""Who says so is a name only once the twin knows its publisher."""


@pytest.fixture
def at(tmp_path: Path):
    terminals = []

    def start(*options: str) -> Terminal:
        terminals.append(Terminal([*DRIVE, *options], tmp_path, NERMO_COMMAND="./nermo"))
        return terminals[-1]

    yield start
    for terminal in terminals:
        terminal.close()
    assert not left_running(os.environ["ROS_DOMAIN_ID"])


def walked(terminal: Terminal) -> float:
    return float(re.findall(r"walked (\d+\.\d\d) m", terminal.read())[-1])


def test_the_keys_of_one_terminal_walk_the_mouse_stop_it_and_end(at, tmp_path: Path) -> None:
    terminal = at()
    terminal.type("+x")
    terminal.until(lambda: terminal.shows("speed 6/10"), "the screen shows what was typed before it")
    terminal.until(lambda: terminal.shows(LIMP), "the stop that was typed before has stopped it")
    terminal.type("1")
    terminal.until(lambda: not terminal.shows(LIMP) and terminal.shows("servos following"), "it has power again")
    terminal.until(lambda: walked(terminal) >= 0.1, "it walks", lambda: terminal.type("w"))
    terminal.type("x")
    terminal.until(lambda: terminal.shows(LIMP), "it is limp")
    terminal.type("1")
    terminal.until(lambda: not terminal.shows(LIMP), "it is released")
    terminal.type("q")
    assert terminal.end() == 0
    told = re.search(r"walked (\d\.\d\d) m in (\d+) s\nrecording: (recordings/\S+)\n", terminal.text)
    assert told is not None, terminal.text[-1000:]
    assert f"./nermo replay {told[3]} " in terminal.text
    assert f"./nermo gap diagnose {told[3]} " in terminal.text

    topics = [f"/nermo/{name}" for name in ("truth/odom", "control_command", "emergency_stop")]
    data = Recording(tmp_path / told[3]).read(topics)
    odometry, commands = data["/nermo/truth/odom"], data["/nermo/control_command"]
    track = np.column_stack([odometry[f"pose.pose.position.{axis}"] for axis in "xy"])
    walking = commands.stamp[commands["forward_velocity"] > 0.0]
    begin, end = np.searchsorted(odometry.stamp, [walking[0], walking[-1]])
    # What it moves while it falls limp within the second after is told too.
    assert float(np.linalg.norm(track[end] - track[begin])) == pytest.approx(float(told[1]), abs=0.03)
    assert data["/nermo/emergency_stop"]["data"].tolist()[-3:] == [False, True, False]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_while_the_graph_comes_up_leaves_nothing_behind(at, number: int) -> None:
    terminal = at("--no-record")
    terminal.until(lambda: terminal.says("bringing up"), "the graph is on its way")
    terminal.process.send_signal(number)
    assert terminal.end() == (0 if number == signal.SIGINT else 128 + number)
    assert "Traceback" not in terminal.text


def test_nothing_survives_a_drive_that_is_killed_outright(at) -> None:
    terminal = at("--no-record")
    domain = os.environ["ROS_DOMAIN_ID"]
    terminal.until(lambda: bool(left_running(domain)), "the first node is there")
    terminal.process.kill()
    while left_running(domain):
        terminal.read()


def test_a_scene_that_does_not_exist_is_said_in_one_sentence(at) -> None:
    terminal = at("--scene", "moon", "--no-record")
    assert terminal.end() == 2
    (sentence,) = [line for line in terminal.text.splitlines() if line.startswith("nermo: ")]
    assert "mujoco_sim refused what it was given: scene 'moon' does not exist; known are flat" in sentence
