"""Where ROS 2 comes from: the one that is sourced, or wheels from PyPI. Standard library only."""

from __future__ import annotations

import importlib.util
import os
import sys
from dataclasses import dataclass
from pathlib import Path

# What another ROS 2, workspace or environment leaves behind and must not leak into the wheels' world. The last one is
# the wheels' own guard: a child of another environment that inherits it does not find its libraries.
_FOREIGN = (
    "PYTHONPATH",
    "PYTHONHOME",
    "AMENT_PREFIX_PATH",
    "COLCON_PREFIX_PATH",
    "CMAKE_PREFIX_PATH",
    "ROS_DISTRO",
    "_ROS_WHEELS_BOOTSTRAP_COMPLETE",
)

DEFAULTS = {"FASTDDS_BUILTIN_TRANSPORTS": "UDPv4", "OPENBLAS_NUM_THREADS": "1"}
"""Environment variables where they are not set: what a killed node leaves in shared memory can deafen its successor,
and a product of matrices whose threads wait for processors that other nodes have takes a hundred times as long."""


@dataclass(frozen=True)
class World:
    """The ROS 2 that Nermo stands on.

    Attributes:
        distro: Name of the sourced ROS 2, or None for the wheels.
        location: Where the sourced rclpy is, or an empty string.
        tf2_msgs: Whether it brings tf2_msgs; the wheels do not, and the vendored package is built instead.
    """

    distro: str | None
    location: str
    tf2_msgs: bool

    @property
    def description(self) -> str:
        """In plain words."""
        version = ".".join(map(str, sys.version_info[:3]))
        source = f"the sourced ROS 2 {self.distro}" if self.distro else "ROS 2 Kilted from PyPI"
        return f"{source} and Python {version}"

    def variables_to_drop(self) -> tuple[str, ...]:
        """Environment variables that must not be handed on into this world."""
        return () if self.distro else _FOREIGN

    def variables(self, venv: Path) -> dict[str, str]:
        """Environment variables that this world needs: the wheels are an ament prefix of their own."""
        if self.distro:
            return {}
        return {"AMENT_PREFIX_PATH": str(venv), "CMAKE_PREFIX_PATH": str(venv)}

    def environment(self, venv: Path) -> dict[str, str]:
        """A whole environment for child processes in this world."""
        kept = {name: value for name, value in os.environ.items() if name not in self.variables_to_drop()}
        if self.distro:  # our own bootstrap put the sources in front; children must not see them there
            paths = kept.get("PYTHONPATH", "").split(os.pathsep)
            kept["PYTHONPATH"] = os.pathsep.join(path for path in paths if Path(path).parent.name != "src")
        path = os.pathsep.join([str(venv / "bin"), kept.get("PATH", os.defpath)])
        return {**DEFAULTS, **kept, **self.variables(venv), "PATH": path, "VIRTUAL_ENV": str(venv)}


def find_world(root: Path) -> World:
    """Finds the ROS 2 to stand on: the sourced one where there is one, else the wheels.

    Args:
        root: The checkout, whose own `install` does not count as a ROS 2.
    """
    distro = os.environ.get("ROS_DISTRO")
    prefixes = [Path(prefix) for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if prefix]
    foreign = [prefix for prefix in prefixes if not prefix.is_relative_to(root)]
    rclpy = importlib.util.find_spec("rclpy")
    if not distro or not foreign or rclpy is None:
        return World(None, "", False)
    has_tf2_msgs = any((prefix / "share" / "tf2_msgs" / "package.xml").is_file() for prefix in foreign)
    return World(distro, str(rclpy.origin), has_tf2_msgs)
