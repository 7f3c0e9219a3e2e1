"""The command in hints is spelled as the person at the keyboard types it."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from nermo_description import invocation

SCRIPT = Path(__file__).parents[3] / "nermo"


def test_hints_are_spelled_as_the_command_was_called(monkeypatch) -> None:
    monkeypatch.setenv(invocation.VARIABLE, "../nermo")
    text = "nermo up starts it, `nermo play FILE` plays; nermo_lite and /work/nermo up and nermo uphill stay"
    assert invocation.spelled(text, ["up", "play"]) == (
        "../nermo up starts it, `../nermo play FILE` plays; nermo_lite and /work/nermo up and nermo uphill stay"
    )
    assert invocation.run_line("nermo_sim", "mujoco_sim") == "../nermo run nermo_sim mujoco_sim"


@pytest.mark.parametrize(
    ("ros", "program", "called", "run"),
    [
        (True, "/ws/lib/nermo", "ros2 run nermo_bringup nermo", "ros2 run a b"),
        (False, "/ws/lib/nermo", "nermo", "nermo run a b"),
        (True, "/ws/nermo_bringup/__main__.py", "python -m nermo_bringup", "python -m nermo_bringup run a b"),
    ],
)
def test_where_the_script_was_not_used_the_way_is_told(
    monkeypatch, ros: bool, program: str, called: str, run: str
) -> None:
    monkeypatch.delenv(invocation.VARIABLE, raising=False)
    monkeypatch.setattr("sys.argv", [program])
    monkeypatch.setattr("shutil.which", lambda name: f"/usr/bin/{name}" if ros else None)
    monkeypatch.setenv("ROS_DISTRO", "kilted")
    assert invocation.called() == called
    assert invocation.run_line("a", "b") == run


@pytest.mark.parametrize(("folder", "typed"), [(".", "./nermo"), ("src", "../nermo")])
def test_the_script_tells_how_it_was_called(folder: str, typed: str) -> None:
    done = subprocess.run(
        [typed, "drive"], cwd=SCRIPT.parent / folder, stdin=subprocess.DEVNULL, capture_output=True, text=True
    )
    assert f"{typed} play FILE" in done.stderr
