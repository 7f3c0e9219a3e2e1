"""A ROS graph that stays on this machine and survives processes that are killed."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

FAST_DDS = "rmw_fastrtps"


def loopback(environment: Mapping[str, str]) -> dict[str, str]:
    """The environment with ROS kept on this machine.

    With Fast DDS by a profile of UDP over 127.0.0.1. Its own range LOCALHOST adds shared memory whatever is asked: a
    node that was killed leaves its ports there, and one that takes its place is now and then deaf to some of the
    others for good. Any other middleware gets the range LOCALHOST.
    """
    kept = dict(environment)
    if kept.get("RMW_IMPLEMENTATION", FAST_DDS).startswith(FAST_DDS):
        kept["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "SYSTEM_DEFAULT"
        kept["FASTDDS_DEFAULT_PROFILES_FILE"] = str(Path(__file__).with_name("loopback.xml"))
    else:
        kept["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    return kept
