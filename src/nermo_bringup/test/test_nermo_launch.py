"""The launch file that users start, in all its variants, against what the packages install."""

import subprocess
import sys
from itertools import product
from pathlib import Path

import pytest

from nermo_bringup.launch.claim import claimed
from nermo_bringup.launch.command import bring_up
from nermo_bringup.launch.description import load, load_arguments
from nermo_bringup.launch.xml import LaunchError
from nermo_description.results import CommandError

FILE = Path(__file__).parents[1] / "launch" / "nermo.launch.xml"
CONTROL = {"gait_knowledge_base", "high_level_controller", "motion_module", "trajectory_generator", "state_publisher"}


@pytest.mark.parametrize(
    ("target", "teleop", "record"), product(("sim", "serial", "link"), ("joystick", "joy_node", "none"), ("none", "x"))
)
def test_every_variant_has_its_nodes_once(target, teleop, record):
    nodes = load(FILE, {"target": target, "teleop": teleop, "record": record}).nodes
    body = {
        "sim": {"mujoco_sim"},
        "serial": {"device_emulator", "serial_driver", "safety_supervisor"},
        "link": {"device_emulator", "robot_end", "zenoh_link"},
    }[target]
    wanted = CONTROL | body | {"leg_load_estimator"}
    wanted |= {"joystick", "teleop"} if teleop != "none" else set()
    wanted |= {"recorder"} if record != "none" else set()
    assert sorted(node.name for node in nodes) == sorted(wanted)
    assert {node.namespace for node in nodes} == {"/nermo"}


def test_cheetah_cub_has_one_controller_in_the_place_of_five_nodes():
    nodes = {node.name: node for node in load(FILE, {"robot": "cheetah_cub", "gait_set": "best.yaml"}).nodes}
    assert not CONTROL & nodes.keys()
    assert {"mujoco_sim", "pantograph_controller", "leg_load_estimator", "teleop"} <= nodes.keys()
    assert dict(nodes["pantograph_controller"].parameters)["gait_file"] == "best.yaml"


@pytest.mark.parametrize(("target", "expected"), [("sim", True), ("serial", False)])
def test_nodes_follow_the_clock_of_the_twin_only(target, expected):
    nodes = [node for node in load(FILE, {"target": target}).nodes if node.package == "nermo_control"]
    assert nodes
    for node in nodes:
        assert dict(node.parameters)["use_sim_time"] is expected


def test_a_robot_at_a_cable_needs_no_emulator():
    nodes = {node.name: node for node in load(FILE, {"target": "serial", "port": "/dev/ttyUSB0"}).nodes}
    assert "device_emulator" not in nodes
    assert dict(nodes["serial_driver"].parameters)["port"] == "/dev/ttyUSB0"


def test_driver_and_emulated_device_meet():
    nodes = {node.name: node for node in load(FILE, {"target": "serial", "namespace": "mouse_1"}).nodes}
    link = dict(nodes["device_emulator"].parameters)["link"]
    assert link == dict(nodes["serial_driver"].parameters)["port"]
    assert "mouse_1" in link


def test_the_ends_of_the_link_meet():
    nodes = {node.name: node for node in load(FILE, {"target": "link"}).nodes}
    arguments = dict(zip(nodes["robot_end"].arguments[:-1:2], nodes["robot_end"].arguments[1::2], strict=True))
    assert arguments["--endpoint"] == dict(nodes["zenoh_link"].parameters)["endpoint"]
    assert arguments["--port"] == dict(nodes["device_emulator"].parameters)["link"]
    assert "serial_driver" not in nodes
    far = {node.name: node for node in load(FILE, {"target": "link", "port": "quic/10.0.0.7:7447?rel=0"}).nodes}
    assert not {"robot_end", "device_emulator", "mujoco_sim"} & far.keys()
    assert dict(far["zenoh_link"].parameters)["endpoint"] == "quic/10.0.0.7:7447?rel=0"


def test_two_mice_share_a_graph():
    one = load(FILE, {"namespace": "mouse_1", "frame_prefix": "mouse_1/"}).nodes
    two = load(FILE, {"namespace": "mouse_2", "frame_prefix": "mouse_2/", "publish_clock": "false"}).nodes
    assert not {node.full_name for node in one} & {node.full_name for node in two}
    (twin,) = (node for node in two if node.name == "mujoco_sim")
    assert dict(twin.parameters)["publish_clock"] is False


@pytest.mark.parametrize(
    ("given", "include", "exclude"),
    [
        ({}, "*", ""),
        ({"record_include": "/nermo/odom /nermo/servo_*"}, "/nermo/odom /nermo/servo_*", ""),
        ({"record_exclude": "*/truth/*"}, "*", "*/truth/*"),
    ],
)
def test_the_recorder_gets_the_patterns_of_its_topics(given, include, exclude):
    (recorder,) = (node for node in load(FILE, {"record": "x", **given}).nodes if node.name == "recorder")
    parameters = dict(recorder.parameters)
    assert (parameters["include"], parameters["exclude"]) == (include, exclude)


def test_arguments_are_listed_with_their_meaning():
    arguments = {argument.name: argument for argument in load_arguments(FILE)}
    assert arguments["target"].choices == ("sim", "serial", "link")
    assert arguments["use_sim_time"].default == "$(equals $(var target) sim)"
    assert all(argument.description for argument in arguments.values())


def test_wrong_target_is_refused():
    with pytest.raises(LaunchError, match="target:=moon is not one of: sim, serial, link"):
        load(FILE, {"target": "moon"})


def test_a_robot_s_file_decides_on_its_controller(tmp_path):
    robot = tmp_path / "my cub.yaml"
    robot.write_text("base: cheetah_cub\nname: my_cub\n")
    nodes = {node.name for node in load(FILE, {"robot": str(robot)}).nodes}
    assert "pantograph_controller" in nodes
    assert not CONTROL & nodes
    with pytest.raises(LaunchError, match="robot 'elephant' does not exist; known are cheetah_cub, nermo, nermo_lite"):
        load(FILE, {"robot": "elephant"})
    with pytest.raises(CommandError, match="--robot: robot 'elephant' does not exist"):
        bring_up("elephant", "sim", "", [])


def test_cheetah_cub_has_no_electronics():
    with pytest.raises(CommandError, match="--target serial: there are no electronics for cheetah_cub"):
        bring_up("cheetah_cub", "serial", "", [])


_HOLDER = """
import sys
from pathlib import Path
from nermo_bringup.launch.claim import claimed
from nermo_bringup.launch.description import load
with claimed(load(Path(sys.argv[1]), {}).nodes):
    print("held", flush=True)
    sys.stdin.read()
"""


def test_a_second_graph_of_the_same_names_is_refused_until_the_first_is_gone_however_it_goes(monkeypatch):
    holder = subprocess.Popen(
        [sys.executable, "-c", _HOLDER, str(FILE)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    try:
        assert holder.stdout.readline() == "held\n"
        with pytest.raises(CommandError, match=f"a graph is up already .*/nermo/.*of process {holder.pid}"):
            bring_up("nermo_lite", "sim", "", [])
        with claimed(load(FILE, {"namespace": "mouse_2"}).nodes):
            pass
        monkeypatch.setenv("ROS_DOMAIN_ID", "101")
        with claimed(load(FILE, {}).nodes):
            pass
        monkeypatch.undo()
    finally:
        holder.kill()
        holder.communicate()
    with claimed(load(FILE, {}).nodes):
        pass


def test_where_the_locks_cannot_be_written_the_folder_is_named(monkeypatch, tmp_path):
    (tmp_path / "file").touch()
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "file"))
    with pytest.raises(CommandError, match=r"file/nermo_graphs_\d+/.*Not a directory"), claimed(load(FILE, {}).nodes):
        pass
