"""The fuzz itself: it finds every subscription by asking ROS, counts refusals, notices a node that ends or hangs."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from nermo_bringup.fuzz.cli import bench_app
from nermo_bringup.fuzz.subjects import Subject, executables, subjects
from nermo_bringup.nodes import fuzz as fuzzing
from nermo_bringup.nodes.fuzz import fuzz
from nermo_description.results import CommandError

FRAGILE = """#!{python}
import sys, time
import rclpy
from geometry_msgs.msg import TwistStamped
from rclpy.node import Node

def take(message):
    if abs(message.twist.linear.x) > 10.0 or message.twist.linear.x != message.twist.linear.x:
        {reaction}

rclpy.init()
node = Node("fragile")
node.create_subscription(TwistStamped, "cmd_vel", take, 10)
rclpy.spin(node)
"""


def fragile(folder: Path, monkeypatch: pytest.MonkeyPatch, reaction: str) -> Subject:
    """A package with a node that cannot stand a number beyond its range."""
    program = folder / "lib" / "toys" / "fragile"
    program.parent.mkdir(parents=True)
    program.write_text(FRAGILE.format(python=sys.executable, reaction=reaction))
    program.chmod(0o755)
    index = folder / "share" / "ament_index" / "resource_index" / "packages"
    index.mkdir(parents=True)
    (index / "toys").touch()
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"{folder}{os.pathsep}{os.environ['AMENT_PREFIX_PATH']}")
    return Subject("toys", "fragile")


def test_a_controller_stands_it_and_says_what_it_refused() -> None:
    outcome = fuzz(Subject("nermo_control", "high_level_controller"), 6.0, seed=0)
    assert outcome.exits == []
    topics = {topic.removeprefix("/fuzz/") for topic in outcome.subscriptions}
    assert topics == {"cmd_vel", "control_command", "gait_parameters", "odom", "path"}
    assert outcome.messages > 20
    assert outcome.refusals is not None and outcome.refusals > 5


def test_a_node_that_ends_is_told_with_its_last_words(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    subject = fragile(tmp_path, monkeypatch, 'sys.exit("math domain error")')
    outcome = fuzz(subject, 5.0, seed=0)
    assert outcome.exits[0] == "status 1: math domain error"
    assert outcome.subscriptions == ["/fuzz/cmd_vel"]


def test_a_node_that_hangs_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fuzzing, "PATIENCE", 10.0)
    outcome = fuzz(fragile(tmp_path, monkeypatch, "time.sleep(3600)"), 3.0, seed=0)
    assert outcome.exits[0].startswith("status none, it hangs")


def test_a_node_that_takes_its_time_with_some_messages_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    outcome = fuzz(fragile(tmp_path, monkeypatch, "time.sleep(0.3)"), 5.0, seed=0)
    assert outcome.longest_stall_s >= 0.3
    assert outcome.worst == "/fuzz/cmd_vel"


def test_every_node_of_the_workspace_is_thrown_at(tmp_path: Path) -> None:
    thrown_at = {(subject.package, subject.executable) for subject in subjects(tmp_path)}
    assert thrown_at == set(executables())
    assert {"mujoco_sim", "motion_module", "safety_supervisor", "gap_monitor"} <= {name for _, name in thrown_at}


def test_a_node_that_does_not_exist_is_wrong_usage() -> None:
    done = CliRunner().invoke(bench_app, ["fuzz", "--node", "moon_walker"])
    assert isinstance(done.exception, CommandError) and done.exception.status == 2
    assert "there is no such node; there are: command_player" in str(done.exception)
