"""A protocol recorded through the graph: like in process, and only while somebody lets the mouse move."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from numpy.typing import NDArray
from std_msgs.msg import Bool
from terminal import Terminal, left_running

from nermo_bringup.launch.runner import lead_own_life
from nermo_bringup.nodes.conductor import in_graph
from nermo_description.robots import load_robot
from nermo_description.stand import Stand
from nermo_gap.protocol.play import Body
from nermo_gap.protocol.record import record
from nermo_gap.protocol.recorded import Recorded, read
from nermo_gap.protocol.scene import scene_of, segments
from nermo_gap.robots.channels import TRACKER
from nermo_node import qos

pytestmark = pytest.mark.long  # whole graphs, one after another

ROBOT = load_robot("nermo_lite")
SHORT = """
import sys
from nermo_control.types import ControlCommand
from nermo_gap.protocol import standard
from nermo_gap.protocol.types import Piece, Protocol, Segment, Wave

def short(robot, markers=False):
    spine = Piece("spine", "bend it", 2.0, (Wave("spine_lateral", 0.3, 1.0),), looks=(0.5,))
    squat = Piece("squat", "squat", 2.0, (Wave("front_left_knee", -0.3, 1.0, one_way=True),), looks=(0.6,))
    trot = Piece("trot", "trot", 3.0, commands=((0.0, ControlCommand(0, forward_velocity=0.06, gait="trot")),))
    hung = Segment("hung", "hung", "hang it up", (spine,))
    return Protocol("short", (hung, Segment("standing", "floor", "set it down", (squat, trot))))

standard.PROTOCOLS["short"] = short
"""
RECORD = f"{SHORT}\nfrom nermo_bringup.cli import main\nsys.argv[0] = 'nermo'\nmain()"
WORDS = [sys.executable, "-c", RECORD, "gap", "record", "--protocol", "short", "--target", "sim"]


DIES_WITH_US = lead_own_life(os.getpid())
"""What a test run that is killed would leave in its ROS domain disturbs whoever leases that domain next."""


def told_by(words: list[str], folder: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        words,
        cwd=folder,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=600.0,
        preexec_fn=DIES_WITH_US,
    )


def in_process(out: Path) -> Recorded:
    made: dict = {}
    exec(SHORT, made)
    record(made["short"](ROBOT), Body.twin(ROBOT), out, 0)
    return read_back(out)


def read_back(folder: Path) -> Recorded:
    folders = segments(folder)
    return read(folders, [scene_of(path) for path in folders], ROBOT)


def column(table: dict[str, NDArray[np.float64]], name: str, run: float, t: NDArray[np.float64]) -> NDArray[np.float64]:
    """A column of a run at times from its beginning."""
    rows = (table["run"] == run) & np.isfinite(table[name])
    return np.interp(t, table["t"][rows] - table["t"][table["run"] == run][0], table[name][rows])


def test_a_protocol_through_the_graph_is_recorded_as_in_process(tmp_path: Path) -> None:
    told = told_by([*WORDS, "--out", "out"], tmp_path)
    assert told.returncode == 0, told.stderr
    for words in ("hung: hang it up", "1 of 1: bend it (2 s)", "standing: set it down", "2 of 2: trot (3 s)"):
        assert words in told.stderr
    assert "next: nermo gap diagnose out" in told.stdout
    graph, process = read_back(tmp_path / "out"), in_process(tmp_path / "process")
    assert graph.looks == process.looks
    assert [stand is None for stand in graph.stands] == [False, True]
    for ours, theirs in zip(graph.tables, process.tables, strict=True):
        commands = [name for name in theirs if name.endswith("_command")]
        assert {*commands, *TRACKER, "gyro_x", "run"} <= set(ours)
        for run in np.unique(theirs["run"]):
            t = np.arange(0.05, np.ptp(theirs["t"][theirs["run"] == run]) - 0.05, 0.005)
            for name in commands:
                difference = np.abs(column(ours, name, run, t) - column(theirs, name, run, t))
                # What is lost of a recording is filled in from both sides here.
                assert np.median(difference) < 2e-3 and np.quantile(difference, 0.9) < 0.02, name
            assert np.abs(column(ours, "base_z", run, t) - column(theirs, "base_z", run, t)).max() < 5e-3
    assert graph.tables[0]["base_z"].mean() == pytest.approx(Stand().height, abs=5e-3), "it hung"


def test_the_mouse_moves_while_the_space_bar_is_held_and_what_was_recorded_is_kept(tmp_path: Path) -> None:
    terminal = Terminal([*WORDS, "--dead-man", "space", "--out", "out"], tmp_path)
    try:

        def hold() -> None:
            terminal.type(" ")

        terminal.until(lambda: terminal.says("hold the space bar"), "the graph is up")
        terminal.until(lambda: terminal.says("1 of 1: bend it"), "the first piece begins", hold)
        terminal.type("x")
        terminal.until(lambda: terminal.says("let go: 'spine' is broken off"), "it is broken off")
        terminal.until(lambda: terminal.says("standing: set it down"), "it was played again", hold)
        terminal.until(lambda: terminal.says("1 of 2: squat"), "the next piece begins", hold)
        terminal.until(lambda: terminal.says("2 of 2: trot"), "and the last one", hold)
        terminal.process.send_signal(signal.SIGINT)
        assert terminal.end() == 1
    finally:
        terminal.close()
    assert "left before the end; 1 of 2 segments are whole in out" in terminal.text
    assert not left_running(os.environ["ROS_DOMAIN_ID"])
    scenes = [scene_of(path) for path in segments(tmp_path / "out")]
    assert [[piece.name for piece in scene.pieces] for scene in scenes if scene is not None] == [["spine"], ["squat"]]
    assert read_back(tmp_path / "out").tables[0]["t"].min() >= 0.0


def test_an_emergency_stop_ends_the_recording(graph, tmp_path: Path) -> None:
    stop = graph.node.create_publisher(Bool, "/nermo/emergency_stop", qos.LATCHED)
    log = tmp_path / "told.txt"
    with log.open("w") as file:
        process = subprocess.Popen(
            [*WORDS, "--out", "out"], cwd=tmp_path, stdout=file, stderr=subprocess.STDOUT, preexec_fn=DIES_WITH_US
        )
    try:
        graph.until(lambda: "1 of 1: bend it" in log.read_text(), "the first piece begins", 240.0)
        stop.publish(Bool(data=True))
        graph.until(lambda: process.poll() is not None, "it ends", 120.0)
    finally:
        process.kill()
        process.wait()
    assert process.returncode == 1
    assert "emergency stop: the recording ends here" in log.read_text()
    assert not (tmp_path / "out" / "2_standing").exists()


@pytest.mark.parametrize("nonsense", ["nan", "inf", "-1", "much", ""])
def test_what_an_emulated_device_left_out_is_heard(graph, nonsense: str) -> None:
    values = [KeyValue(key="skipped_s", value=said) for said in ("3.50", nonsense)]
    status = DiagnosticStatus(name="device_emulator: device", values=[KeyValue(key="voltage_v", value="7.4"), *values])
    told = graph.node.create_publisher(DiagnosticArray, "/diagnostics", 10)
    with in_graph("nermo", sim_time=False) as node:

        def heard() -> bool:
            told.publish(DiagnosticArray(status=[status]))
            node.serve(0.02)
            return node.skipped > 0.0

        graph.until(heard, "it is heard", 60.0)
        assert node.skipped == 3.5


def test_two_graphs_do_not_disturb_each_other(graph, tmp_path: Path) -> None:
    there = rclpy.create_node("mujoco_sim", namespace="nermo", context=graph.node.context)
    try:
        told = told_by([*WORDS, "--out", "out"], tmp_path)
    finally:
        there.destroy_node()
    assert told.returncode == 1
    assert "a graph is up already" in told.stderr and "/nermo/mujoco_sim" in told.stderr
    assert "take another ROS_DOMAIN_ID" in told.stderr
    assert "1 of 1" not in told.stderr, "it was seen before anything was played"


def test_a_real_mouse_is_not_moved_without_somebody_who_watches_it(tmp_path: Path) -> None:
    words = [*WORDS[:-1], "serial", "--port", str(tmp_path / "device"), "--out", "out"]
    told = told_by(words, tmp_path)
    assert told.returncode == 2
    assert "this needs a terminal as its input" in told.stderr and "Traceback" not in told.stderr
    assert not (tmp_path / "out").exists()
