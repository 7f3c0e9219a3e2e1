"""The demo as a user starts it: it walks the whole graph, and leaves nothing behind."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest


@pytest.mark.slow
def test_the_demo_walks_the_whole_graph_and_leaves_nothing_running(tmp_path: Path) -> None:
    """The rclpy graph as a user starts it."""
    out, results = tmp_path / "demo", tmp_path / "demo.json"
    command = [sys.executable, "-m", "nermo_bringup", "demo", "--quick", "--stepped", "--no-video"]
    done = subprocess.run(
        [*command, "--out", str(out), "--json", str(results)], capture_output=True, text=True, check=False, timeout=880
    )
    assert done.returncode == 0, done.stdout + done.stderr
    facts = json.loads(results.read_text())
    assert facts["passed"] is True
    assert [walk["gait"] for walk in facts["walks"]] == ["trot", "walking_trot", "lateral_walk"]
    assert not any(walk["fell"] for walk in facts["walks"])
    assert facts["turn"]["spine_rad"] > 0.15
    assert facts["balance"]["passed"] is True
    assert {"p50", "p99", "max"} == set(facts["graph"]["command_age_ms"])
    assert facts["graph"]["ticks_missed"] == 0
    assert all(Path(path).stat().st_size > 0 for path in facts["pictures"])
    assert not processes_with(out)


@pytest.mark.long
def test_a_demo_that_is_terminated_leaves_nothing_running(tmp_path: Path) -> None:
    out = tmp_path / "demo"
    demo = subprocess.Popen(
        [sys.executable, "-m", "nermo_bringup", "demo", "--quick", "--no-video", "--out", str(out)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    deadline = time.monotonic() + 240.0
    while len(processes_with(out)) < 3:  # the demo, the launch, a node
        assert demo.poll() is None
        assert time.monotonic() < deadline
        time.sleep(0.1)
    demo.terminate()
    assert demo.wait(240.0) == 128 + signal.SIGTERM
    assert not processes_with(out)


def processes_with(path: Path) -> list[bytes]:
    """Command lines of the processes that name a path."""
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            words = (process / "cmdline").read_bytes()
            if os.fsencode(path) in words:
                found.append(words)
    return found
