"""What a command leaves behind: its results as JSON, or the one sentence on why it failed."""

from __future__ import annotations

import importlib.metadata
import json
import math
import os
import platform
import shlex
import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

SCHEMA_VERSION = 1
_LIBRARIES = ("mujoco", "numpy", "scipy")


class CommandError(Exception):
    """A command cannot do what it was asked to do.

    Args:
        message: One sentence for the user: what, where, and what to do about it.
        status: Exit status: 1 where the thing asked for failed, 2 where it was asked for wrongly.
    """

    def __init__(self, message: str, status: int = 1) -> None:
        super().__init__(message)
        self.status = status


def results(name: str, facts: dict[str, Any], *, robot: str | None = None, seed: int | None = None) -> dict[str, Any]:
    """Puts the common head in front of a command's facts.

    Args:
        name: What the results are, as in "straight-line"; `schema` becomes "nermo/straight-line/1".
        facts: The command's own keys, with units in their names (`speed_m_s`).
        robot: Name of the robot, where there is one.
        seed: The seed used, where anything was random.

    Returns:
        A dictionary with `schema`, `created` (UTC, ISO 8601), `command`, `seed`, `robot`, `versions`, then the facts.
    """
    versions = {"python": platform.python_version(), "platform": platform.platform()}
    for library in _LIBRARIES:
        try:
            versions[library] = importlib.metadata.version(library)
        except importlib.metadata.PackageNotFoundError:
            continue
    return {
        "schema": f"nermo/{name}/{SCHEMA_VERSION}",
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "command": shlex.join(["nermo", *sys.argv[1:]]),
        "seed": seed,
        "robot": robot,
        "versions": versions,
        **facts,
    }


def write_results(
    path: str | os.PathLike[str],
    name: str,
    facts: dict[str, Any],
    *,
    robot: str | None = None,
    seed: int | None = None,
) -> None:
    """Writes `results(...)` as UTF-8 JSON. Numbers that are not finite become null, which JSON can say.

    Args:
        path: The file; missing folders are made. It is replaced whole or not at all.

    Raises:
        CommandError: The file cannot be written.
    """
    target = Path(path)
    text = json.dumps(
        _plain(results(name, facts, robot=robot, seed=seed)), indent=2, ensure_ascii=False, allow_nan=False
    )
    partial = target.with_name(f".{target.name}.{os.getpid()}")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        partial.write_text(text + "\n", encoding="utf-8")
        partial.replace(target)
    except OSError as error:
        raise CommandError(f"{target} cannot be written: {error.strerror}.") from error


def _plain(value: Any) -> Any:
    """The value in types that JSON knows; NumPy scalars and arrays become numbers and lists."""
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [_plain(item) for item in value]
    if hasattr(value, "tolist"):
        return _plain(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    return value
