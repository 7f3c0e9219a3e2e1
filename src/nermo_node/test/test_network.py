"""A graph on this machine only, without what a killed process leaves in shared memory; or open where that is asked."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from nermo_node.network import PROFILES, RANGE, chosen_network, loopback, reaching, subnet

_SELF = """
import os, pathlib, rclpy
rclpy.init()
node = rclpy.create_node("lonely")
print("threads", *sorted(p.read_text().strip() for p in pathlib.Path("/proc/self/task").glob("*/comm")))
inodes = {os.readlink(f)[8:-1] for f in pathlib.Path("/proc/self/fd").iterdir() if os.path.islink(f)}
for line in pathlib.Path("/proc/self/net/udp").read_text().splitlines()[1:]:
    words = line.split()
    if words[9] in inodes:
        print("bound", ".".join(str(byte) for byte in reversed(bytes.fromhex(words[1].split(":")[0]))))
"""


def looks_at_itself(environment: dict[str, str]) -> list[str]:
    return subprocess.run(
        [sys.executable, "-c", _SELF], env=environment, capture_output=True, text=True, check=True
    ).stdout.splitlines()


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="no /proc")
def test_there_is_no_shared_memory_and_nothing_listens_to_another_interface() -> None:
    if PROFILES not in loopback(os.environ):
        pytest.skip("another middleware than Fast DDS 3")
    threads, *bound = looks_at_itself(loopback(os.environ))
    assert "dds.udp" in threads
    assert "dds.shm" not in threads
    # The multicast group is joined on the loopback interface.
    assert {line.split()[1] for line in bound} <= {"127.0.0.1", "239.255.0.1"}
    _, *opened = looks_at_itself(subnet(os.environ))
    assert "bound 0.0.0.0" in opened


def test_another_middleware_keeps_its_own_way() -> None:
    kept = loopback({"RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp", "HOME": "/home/student"})
    assert kept[RANGE] == "LOCALHOST"
    assert PROFILES not in kept
    assert kept["HOME"] == "/home/student"


def test_a_profile_of_the_users_own_is_left_to_them() -> None:
    assert loopback({PROFILES: "mine.xml"}) == {PROFILES: "mine.xml", RANGE: "LOCALHOST"}
    assert subnet({PROFILES: "mine.xml"}) == {PROFILES: "mine.xml", RANGE: "SUBNET"}


@pytest.mark.parametrize(
    ("distro", "variable"), [("jazzy", "FASTRTPS_DEFAULT_PROFILES_FILE"), ("kilted", "FASTDDS_DEFAULT_PROFILES_FILE")]
)
def test_each_version_of_fast_dds_is_told_in_its_own_words(distro: str, variable: str) -> None:
    kept = loopback({"ROS_DISTRO": distro})
    assert kept.keys() == {"ROS_DISTRO", RANGE, variable}
    assert Path(kept[variable]).is_file()
    opened = subnet(kept)
    assert opened.keys() == kept.keys()
    assert opened[RANGE] == "SUBNET"
    assert opened[variable] != kept[variable] and Path(opened[variable]).is_file()
    assert loopback(opened) == kept


@pytest.mark.parametrize(
    ("environment", "network"),
    [({}, "localhost"), ({RANGE: "SUBNET"}, "subnet"), ({RANGE: "LOCALHOST"}, "localhost"), ({RANGE: ""}, "localhost")],
)
def test_this_machine_alone_unless_somebody_says_otherwise(environment: dict[str, str], network: str) -> None:
    assert chosen_network(environment) == network
    assert chosen_network(reaching(environment, chosen_network(environment))) == network
