"""The set-up: what must be built, what it says when something is missing, and the doctor."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from nermo_bringup.environment import checks, steps
from nermo_bringup.environment.checkout import checkout_root
from nermo_bringup.environment.python_packages import Environment
from nermo_bringup.environment.ros import World, find_world
from nermo_bringup.environment.steps import SetupError
from nermo_bringup.environment.workspace import Workspace
from nermo_description.invocation import VARIABLE

STAMP = {"python": "this one"}
SETUP = """
from setuptools import setup
setup(name="toys", version="0.1.0", packages=["toys"], data_files=[
    ("share/ament_index/resource_index/packages", ["resource/toys"]), ("share/toys", ["package.xml"])])
"""
MANIFEST = """
<package format="3"><name>toys</name><version>0.1.0</version><description>-</description>
<maintainer email="a@b.example">a</maintainer><license>Apache-2.0</license>
<export><build_type>ament_python</build_type></export></package>
"""


def test_a_long_step_gives_signs_of_life(capsys, monkeypatch, tmp_path):
    monkeypatch.setattr(steps, "SIGN_OF_LIFE_S", 0.01)
    gate = tmp_path / "gate"
    os.mkfifo(gate)
    asked = []

    def present():
        asked.append(1)
        if len(asked) == 3:
            gate.write_text("go on")
        return "building toys"

    steps.step("long", ["cat", str(gate)], present=present)
    assert capsys.readouterr().err.count("nermo:   building toys (") >= 3


@pytest.fixture
def root(tmp_path):
    """A checkout with one small package."""
    package = tmp_path / "src" / "toys"
    (package / "toys").mkdir(parents=True)
    (package / "resource").mkdir()
    (package / "resource" / "toys").touch()
    (package / "toys" / "__init__.py").touch()
    (package / "setup.py").write_text(SETUP)
    (package / "setup.cfg").write_text(
        "[develop]\nscript_dir=$base/lib/toys\n[install]\ninstall_scripts=$base/lib/toys\n"
    )
    (package / "package.xml").write_text(MANIFEST)
    return tmp_path


def workspace(root, stamp=None):
    return Workspace(root, World("kilted", "/opt/ros", tf2_msgs=True), stamp or STAMP)


def test_only_what_changed_is_built(root):
    package = root / "src" / "toys"
    assert workspace(root).stale() == ["toys"]
    workspace(root).build(Path(sys.executable))
    assert workspace(root).stale() == []
    (package / "toys" / "new.py").write_text("x = 1\n")
    (package / "test").mkdir()
    (package / "test" / "data.yaml").touch()
    assert workspace(root).stale() == [], "Python and tests need no build"
    assert workspace(root, {"python": "another"}).stale() == ["toys"]
    (package / "config.yaml").touch()
    assert workspace(root).stale() == ["toys"], "a new data file must be installed"
    (package / "config.yaml").unlink()
    (package / "setup.py").write_text(SETUP + "# changed\n")
    assert workspace(root).stale() == ["toys"]
    workspace(root).build(Path(sys.executable))
    assert workspace(root).stale() == []
    shutil.rmtree(root / "install" / "toys")
    assert workspace(root).stale() == ["toys"]


def test_python_edits_reach_the_installed_package(root):
    workspace(root).build(Path(sys.executable))
    (root / "src" / "toys" / "toys" / "late.py").write_text("print('edited')\n")
    command = f"source {root}/install/local_setup.bash && {sys.executable} -c 'import toys.late'"
    result = subprocess.run(["bash", "-c", command], capture_output=True, text=True)
    assert result.stdout == "edited\n", result.stderr


def test_failed_build_names_package_and_log(root, capfd):
    (root / "src" / "toys" / "setup.py").write_text("raise RuntimeError('broken on purpose')\n")
    with pytest.raises(SetupError, match="building toys failed; its whole output is in .*stdout_stderr.log"):
        workspace(root).build(Path(sys.executable))
    assert "broken on purpose" in capfd.readouterr().err
    assert workspace(root).stale() == ["toys"]


@pytest.mark.parametrize(("text", "message"), [("<package>", "is not valid XML"), ("<package/>", "names no package")])
def test_broken_manifest_is_named(root, text, message):
    (root / "src" / "toys" / "package.xml").write_text(text)
    with pytest.raises(SetupError, match=rf"toys/package\.xml {message}"):
        workspace(root).stale()


def test_environment_is_made_anew_when_the_lock_changes(tmp_path):
    for name in ("requirements.in", "requirements.lock", "requirements-test.in", "requirements-test.lock"):
        (tmp_path / name).write_text("numpy==2.0.0\n")
    world = World(None, "", tf2_msgs=False)
    before = Environment(tmp_path / ".venv", tmp_path, world)
    stamp, build_stamp = before.stamp(), before.build_stamp()
    (tmp_path / "requirements.lock").write_text("numpy==2.0.0\nrich==15.0.0\n")
    assert before.stamp() != stamp
    assert before.build_stamp() == build_stamp, "the messages do not depend on rich"
    (tmp_path / "requirements.lock").write_text("ros-rclpy==9.9.9\nnumpy==2.0.0\n")
    assert before.build_stamp() != build_stamp
    assert not before.ready()


def test_what_tests_need_is_told_from_what_runs(tmp_path):
    """A change of it has only the tests' packages fetched anew, one of the environment both."""
    for name in ("requirements.in", "requirements.lock", "requirements-test.in", "requirements-test.lock"):
        (tmp_path / name).write_text("# nothing\n")
    environment = Environment(tmp_path / ".venv", tmp_path, World(None, "", tf2_msgs=False))
    environment.make()
    assert environment.ready() and not environment.ready_for_tests()
    environment.add_tests()
    assert environment.ready_for_tests()
    (tmp_path / "requirements-test.lock").write_text("# something\n")
    assert environment.ready() and not environment.ready_for_tests()
    environment.add_tests()
    (tmp_path / "requirements.lock").write_text("# something\n")
    assert not environment.ready() and not environment.ready_for_tests()
    environment.make()
    assert environment.ready() and not environment.ready_for_tests()


def test_sourced_ros_is_found_and_kept(monkeypatch, tmp_path):
    (tmp_path / "ros" / "share" / "tf2_msgs").mkdir(parents=True)
    (tmp_path / "ros" / "share" / "tf2_msgs" / "package.xml").touch()
    (tmp_path / "python" / "rclpy").mkdir(parents=True)
    (tmp_path / "python" / "rclpy" / "__init__.py").touch()
    monkeypatch.setenv("ROS_DISTRO", "jazzy")
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path / "ros"))
    monkeypatch.syspath_prepend(str(tmp_path / "python"))
    sys.modules.pop("rclpy", None)
    world = find_world(tmp_path / "checkout")
    assert (world.distro, world.tf2_msgs) == ("jazzy", True)
    assert not world.variables_to_drop()
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path / "checkout" / "install" / "x"))
    assert find_world(tmp_path / "checkout").distro is None, "our own install is no ROS 2"
    monkeypatch.delenv("ROS_DISTRO")
    world = find_world(tmp_path / "checkout")
    assert world.distro is None
    assert "PYTHONPATH" in world.variables_to_drop()


def test_every_system_package_can_be_looked_for():
    packages = checks.system_packages()
    assert {"python", "python-headers", "compiler", "opengl"} <= {package.name for package in packages}
    for package in packages:
        assert callable(getattr(checks, package.check))
        assert package.install["apt"]


class Bare:
    """A fresh checkout of the scripts, on a system that has hardly anything."""

    def __init__(self, folder: Path) -> None:
        here = checkout_root()
        self.root = folder / "checkout"
        for name in ("src/nermo_bringup/nermo_bringup/environment", "src/nermo_description/nermo_description"):
            ignored = shutil.ignore_patterns("__pycache__", "*.obj", "*.stl", "meshes")
            shutil.copytree(here / name, self.root / name, ignore=ignored)
        for name in (
            "nermo",
            "requirements.in",
            "requirements.lock",
            "requirements-test.in",
            "requirements-test.lock",
            "src/nermo_bringup/nermo_bringup/__init__.py",
        ):
            shutil.copy(here / name, self.root / name)
        shutil.copytree(here / "vendor", self.root / "vendor")
        self.bin = folder / "bin"
        self.bin.mkdir()
        for name in ("bash", "env", "readlink", "dirname"):
            (self.bin / name).symlink_to(shutil.which(name))

    def run(self, *arguments: str, **variables: str) -> subprocess.CompletedProcess:
        environment = {"PATH": str(self.bin), "HOME": str(self.root), "NERMO_PYTHON": sys.executable, **variables}
        command = [str(self.root / "nermo"), *arguments]
        return subprocess.run(command, env=environment, capture_output=True, text=True)


@pytest.fixture
def bare(tmp_path):
    return Bare(tmp_path)


def test_missing_compiler_is_said_in_one_sentence(bare):
    result = bare.run("up")
    assert result.returncode == 1
    assert result.stdout == ""
    (line,) = result.stderr.splitlines()
    assert line.startswith("nermo: missing: a C and a C++ compiler (no C compiler")
    assert not (bare.root / ".venv").exists()


def test_doctor_works_before_anything_is_set_up(bare, tmp_path):
    result = bare.run("doctor", "--json", str(tmp_path / "doctor.json"))
    assert result.returncode == 1
    assert result.stderr.splitlines()[-1] == "nermo: missing, and needed: a C and a C++ compiler."
    written = json.loads((tmp_path / "doctor.json").read_text())
    assert written["schema"] == "nermo/doctor/1"
    assert written["ok"] is False
    rows = {row["name"]: row for row in written["rows"]}
    assert rows["a C and a C++ compiler"]["status"] == "missing"
    assert rows["Python environment"]["found"] == "not set up yet"
    assert {"ROS 2", "display", "gamepads", "serial ports", "network namespaces", "disk"} <= set(rows)


def test_compiler_that_is_named_must_exist(bare, tmp_path):
    result = bare.run("doctor", CC="/no/such/compiler")
    assert "no C compiler (/no/such/compiler)" in result.stdout


def test_wrong_usage_of_the_doctor(bare):
    result = bare.run("doctor", "--bogus")
    assert result.returncode == 2
    assert "Traceback" not in result.stderr


@pytest.mark.parametrize(
    ("arguments", "status", "last"),
    [
        (["fly"], 2, "Error: No such command 'fly'."),
        (["up", "--target", "moon"], 2, "nermo: --target moon is not one of: sim, serial, link."),
        (["up", "robot=nermo"], 2, "nermo: 'robot=nermo' is not an argument; write NAME:=VALUE."),
        (
            ["launch", "no_such_package", "x.xml"],
            2,
            "nermo: there is no package 'no_such_package' in the sourced workspace.",
        ),
        (["launch", "x.launch.xml"], 2, "nermo: the launch file x.launch.xml does not exist."),
        (["run", "nermo_bringup", "no_such"], 2, None),
    ],
)
def test_wrong_usage_ends_with_one_sentence(arguments, status, last):
    result = subprocess.run([sys.executable, "-m", "nermo_bringup", *arguments], capture_output=True, text=True)
    assert result.returncode == status
    assert "Traceback" not in result.stderr
    assert last is None or result.stderr.splitlines()[-1] == last


def test_help_of_every_word_has_an_example_that_can_be_typed_as_it_stands(monkeypatch):
    from nermo_bringup.cli import app

    monkeypatch.setenv(VARIABLE, "../there/nermo")
    for command in app.registered_commands:
        name = command.name or command.callback.__name__
        result = subprocess.run([sys.executable, "-m", "nermo_bringup", name, "--help"], capture_output=True, text=True)
        assert result.returncode == 0, result.stderr
        assert f"../there/nermo {name.replace('_', '-')}" in result.stdout
        assert not [line for line in result.stdout.splitlines() if line.strip().startswith("nermo ")]


def test_help_of_the_bench_names_those_of_other_packages(monkeypatch):
    from nermo_bringup.cli import _BENCHES

    monkeypatch.setenv(VARIABLE, "nermo")
    result = subprocess.run([sys.executable, "-m", "nermo_bringup", "bench", "--help"], capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    told = " ".join(result.stdout.split())
    assert not [word for word in _BENCHES if f"nermo bench {word}" not in told]
