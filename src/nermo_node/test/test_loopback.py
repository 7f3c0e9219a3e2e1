"""A graph on this machine only, without what a killed process leaves in shared memory."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from nermo_node.loopback import loopback

_THREADS = """
import pathlib, rclpy
rclpy.init()
node = rclpy.create_node("lonely")
print(*sorted(p.read_text().strip() for p in pathlib.Path("/proc/self/task").glob("*/comm")))
"""


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="no /proc")
def test_there_is_no_shared_memory_and_only_this_machine_is_asked() -> None:
    if not loopback(os.environ).get("FASTDDS_DEFAULT_PROFILES_FILE"):
        pytest.skip("another middleware than Fast DDS")
    found = subprocess.run(
        [sys.executable, "-c", _THREADS], env=loopback(os.environ), capture_output=True, text=True, check=True
    )
    assert "dds.udp" in found.stdout
    assert "dds.shm" not in found.stdout


def test_another_middleware_keeps_its_own_way() -> None:
    kept = loopback({"RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp", "HOME": "/home/student"})
    assert kept["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "LOCALHOST"
    assert "FASTDDS_DEFAULT_PROFILES_FILE" not in kept
    assert kept["HOME"] == "/home/student"
