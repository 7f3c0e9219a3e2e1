"""The RViz and Foxglove layouts show topics and fields that the graph has."""

from __future__ import annotations

import importlib
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

CONFIG = Path(__file__).parents[1] / "config"

TOPICS = {
    "/diagnostics": "diagnostic_msgs/DiagnosticArray",
    "/nermo/control_command": "nermo_interfaces/ControlCommand",
    "/nermo/motion_command": "nermo_interfaces/MotionCommand",
    "/nermo/servo_command": "nermo_interfaces/ServoCommand",
    "/nermo/servo_states": "nermo_interfaces/ServoStates",
    "/nermo/leg_states": "nermo_interfaces/LegStates",
    "/nermo/imu/data_raw": "sensor_msgs/Imu",
    "/nermo/odom": "nav_msgs/Odometry",
    "/nermo/truth/odom": "nav_msgs/Odometry",
    "/nermo/truth/foot_forces": "nermo_interfaces/FootForces",
    "/nermo/robot_description": "std_msgs/String",
}
"""The design's topics, and the one of robot_state_publisher."""


def strings(value: Any) -> Iterator[str]:
    if isinstance(value, dict):
        for key, inner in value.items():
            yield key
            yield from strings(inner)
    elif isinstance(value, list):
        for inner in value:
            yield from strings(inner)
    elif isinstance(value, str):
        yield value


def message(topic: str) -> Any:
    package, name = TOPICS[topic].split("/")
    return getattr(importlib.import_module(f"{package}.msg"), name)


def field_type(owner: Any, name: str) -> str:
    fields = owner.get_fields_and_field_types()
    assert name in fields, f"{owner.__name__} has no field {name}"
    return fields[name]


@pytest.fixture(scope="module")
def foxglove() -> dict[str, Any]:
    return json.loads((CONFIG / "foxglove" / "nermo.json").read_text())


@pytest.fixture(scope="module")
def rviz() -> dict[str, Any]:
    return yaml.safe_load((CONFIG / "rviz" / "nermo.rviz").read_text())


def test_foxglove_plots_fields_that_exist(foxglove: dict[str, Any]) -> None:
    paths = [text for text in strings(foxglove) if text.startswith("/")]
    assert len(paths) > 20
    for path in paths:
        topic = max((topic for topic in TOPICS if path == topic or path.startswith(f"{topic}.")), key=len, default=None)
        assert topic is not None, f"{path} is of no topic"
        owner = message(topic)
        for part in path[len(topic) :].split(".")[1:]:
            name, index = re.fullmatch(r"(\w+)(\[\d+\])?", part).groups()
            kind = field_type(owner, name)
            assert bool(index) == bool(re.search(r"\[|sequence", kind)), f"{path}: {name} is {kind}"
            element = re.sub(r"\[\d*\]|sequence<|>", "", kind)
            if "/" in element:
                package, inner = element.split("/")
                owner = getattr(importlib.import_module(f"{package}.msg"), inner)


def test_foxglove_places_every_panel_once(foxglove: dict[str, Any]) -> None:
    placed = [text for text in strings(foxglove["layout"]) if "!" in text]
    assert sorted(placed) == sorted(foxglove["configById"])


def test_rviz_shows_topics_that_exist(rviz: dict[str, Any]) -> None:
    displays = rviz["Visualization Manager"]["Displays"]
    topics = [text for text in strings(displays) if text.startswith("/")]
    assert topics
    assert set(topics) <= set(TOPICS)
    assert {display["Class"].split("/")[0] for display in displays} == {"rviz_default_plugins"}
    assert rviz["Visualization Manager"]["Global Options"]["Fixed Frame"] == "odom"
