"""How far a ROS graph reaches: this machine alone, or every machine in its network."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Literal

Network = Literal["localhost", "subnet"]

FAST_DDS = "rmw_fastrtps"
RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
PROFILES = "FASTDDS_DEFAULT_PROFILES_FILE"
_PROFILES_OF_FAST_DDS_2 = "FASTRTPS_DEFAULT_PROFILES_FILE"
"""Fast DDS 2 knows this name only, and of Fast DDS 3 each node warns where it is set."""
_FAST_DDS_2 = ("humble", "iron", "jazzy")
_LOOPBACK = str(Path(__file__).with_name("loopback.xml"))
_SUBNET = str(Path(__file__).with_name("subnet.xml"))


def chosen_network(environment: Mapping[str, str]) -> Network:
    """What whoever set the environment wants: this machine alone, unless the ROS variable names the subnet."""
    return "subnet" if environment.get(RANGE, "").upper() == "SUBNET" else "localhost"


def reaching(environment: Mapping[str, str], network: Network) -> dict[str, str]:
    """The environment of nodes whose graph reaches so far."""
    return subnet(environment) if network == "subnet" else loopback(environment)


def loopback(environment: Mapping[str, str]) -> dict[str, str]:
    """The environment with ROS kept on this machine.

    With Fast DDS by a profile of UDP over 127.0.0.1. Its own range LOCALHOST still listens on every interface to whom
    knows its ports, and adds shared memory whatever is asked: a node that was killed leaves its ports there, and one
    that takes its place is now and then deaf to some of the others for good. Any other middleware, and whoever has a
    Fast DDS profile of their own, gets the range LOCALHOST.
    """
    kept = dict(environment)
    if name := _profiles(kept):
        kept[RANGE] = "SYSTEM_DEFAULT"
        kept[name] = _LOOPBACK
    else:
        kept[RANGE] = "LOCALHOST"
    return kept


def subnet(environment: Mapping[str, str]) -> dict[str, str]:
    """The environment with ROS open to every machine that this one reaches by multicast.

    Fast DDS gets a profile that differs from its defaults in one thing: how often each node says that it is there.
    """
    opened = {**environment, RANGE: "SUBNET"}
    if name := _profiles(environment):
        opened[name] = _SUBNET
    return opened


def _profiles(environment: Mapping[str, str]) -> str | None:
    """The variable that names Fast DDS's profiles; None with another middleware, or where they are the user's own."""
    name = _PROFILES_OF_FAST_DDS_2 if environment.get("ROS_DISTRO") in _FAST_DDS_2 else PROFILES
    ours = environment.get(name, _LOOPBACK) in (_LOOPBACK, _SUBNET)
    return name if ours and environment.get("RMW_IMPLEMENTATION", FAST_DDS).startswith(FAST_DDS) else None
