"""The nodes of the workspace, each with the parameters that it needs to be there by itself."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from ament_index_python.packages import get_package_prefix

from nermo_hw.link.config import load_link

PACKAGES = ("nermo_bringup", "nermo_control", "nermo_gap", "nermo_hw", "nermo_sensors", "nermo_sim", "nermo_web")
NO_NODES = frozenset({"nermo", "robot_end"})
"""Executables that are no part of a ROS graph."""

_SCRIPT = "commands:\n  - {at: 0.0, forward_velocity: 0.05}\n  - {at: 3600.0, forward_velocity: 0.0}\n"
_NOBODY = "tcp/127.0.0.1:17999"
"""Where no robot listens."""


@dataclass(frozen=True)
class Subject:
    """A node process: the package and executable, its parameters, and the robot that its messages name."""

    package: str
    executable: str
    parameters: dict[str, object] = field(default_factory=dict)
    robot: str = "nermo_lite"
    in_terminal: bool = False

    @property
    def name(self) -> str:
        """The executable, and what sets it apart from the same one with other parameters."""
        told = ", ".join(f"{key}={value}" for key, value in self.parameters.items() if "/" not in str(value))
        return f"{self.executable} ({told})" if told else self.executable


def subjects(folder: Path) -> list[Subject]:
    """Every node, some of them in several variants. `folder`: for what they write or read."""
    script = folder / "script.yaml"
    script.write_text(_SCRIPT, encoding="utf-8")
    link = folder / "link.yaml"
    plain = {"keys": None, "robot.endpoints": [_NOBODY], "workstation.endpoints": [_NOBODY]}
    link.write_text(load_link(overrides=plain.items()).model_dump_json(), encoding="utf-8")
    special: dict[str, list[dict[str, object]]] = {
        "command_player": [{"file": script, "lockstep": True}],
        "motion_module": [{}, {"coordination": "tegotae", "gaze": "imu"}],
        "state_publisher": [{"use_truth": True}, {"use_truth": False}],
        "pantograph_controller": [{"coordination": "tegotae"}],
        "serial_driver": [{"port": folder / "no_device"}],
        "device_emulator": [{"link": folder / "device"}],
        "twin_device": [{"link": folder / "twin_device"}],
        "recorder": [{"directory": folder / "recording"}],
        "web": [{"port": 0}],
        "zenoh_link": [{"link": link}],
    }
    return [
        Subject(
            package,
            executable,
            parameters,
            robot="cheetah_cub" if executable == "pantograph_controller" else "nermo_lite",
            in_terminal=executable == "keyboard_teleop",
        )
        for package, executable in executables()
        for parameters in special.get(executable, [{}])
    ]


def executables() -> Iterator[tuple[str, str]]:
    """Package and name of every node of the workspace."""
    for package in PACKAGES:
        folder = Path(get_package_prefix(package)) / "lib" / package
        for file in sorted(folder.iterdir()) if folder.is_dir() else ():
            if file.is_file() and file.name not in NO_NODES:
                yield package, file.name
