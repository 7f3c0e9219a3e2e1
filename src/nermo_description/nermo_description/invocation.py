"""How this person calls the nermo command, so that what it says can be typed as it stands. Standard library only."""

from __future__ import annotations

import os
import re
import shutil
import sys
from collections.abc import Iterable
from pathlib import Path

VARIABLE = "NERMO_COMMAND"
"""The script `./nermo` puts into it how it was called, for this process and those that it starts."""

_BY_ROS = "ros2 run nermo_bringup nermo"


def called() -> str:
    """The command as this person types it: `./nermo`, or what leads to it where that script was not used."""
    if named := os.environ.get(VARIABLE):
        return named
    if Path(sys.argv[0]).name == "__main__.py":
        return "python -m nermo_bringup"
    return _BY_ROS if os.environ.get("ROS_DISTRO") and shutil.which("ros2") else "nermo"


def run_line(package: str, executable: str) -> str:
    """How this person starts an executable of a package."""
    return f"ros2 run {package} {executable}" if called() == _BY_ROS else f"{called()} run {package} {executable}"


def spelled(text: str, words: Iterable[str]) -> str:
    """The text with each `nermo WORD` as this person types it."""
    pattern = rf"(?<![\w./-])nermo (?=(?:{'|'.join(map(re.escape, words))})\b)"
    return re.sub(pattern, lambda _: f"{called()} ", text)
