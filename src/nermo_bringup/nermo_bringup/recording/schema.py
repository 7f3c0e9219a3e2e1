"""Message definitions as MCAP schemas of encoding `ros2msg`: a definition followed by those it depends on."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

from ament_index_python.packages import PackageNotFoundError, get_package_share_directory

from nermo_bringup.recording.errors import RecordingError

SEPARATOR = "=" * 80

_PRIMITIVES = frozenset(
    {"bool", "byte", "char", "float32", "float64", "string", "wstring"}
    | {f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)}
)
_FIELD = re.compile(r"^\s*(?P<type>[A-Za-z][\w/]*)(<=\d+)?(\[(<=)?\d*\])?\s+[A-Za-z]")


@cache
def definition(type_name: str) -> str:
    """Text of the `.msg` file of a type such as `sensor_msgs/msg/Imu`.

    Raises:
        RecordingError: the type is no message, or its package or file is not installed.
    """
    parts = type_name.split("/")
    if len(parts) != 3 or parts[1] != "msg":
        raise RecordingError(f"{type_name}: only message types (package/msg/Name) have a definition to record")
    package, _, name = parts
    try:
        path = Path(get_package_share_directory(package)) / "msg" / f"{name}.msg"
        return path.read_text(encoding="utf-8")
    except PackageNotFoundError:
        raise RecordingError(f"{type_name}: the package {package} is not installed") from None
    except OSError as error:
        raise RecordingError(f"{type_name}: cannot read its definition: {error}") from None


def dependencies(type_name: str) -> list[str]:
    """Message types that appear as fields of a type, in the order of their first appearance."""
    package = type_name.split("/")[0]
    found: dict[str, None] = {}
    for line in definition(type_name).splitlines():
        match = _FIELD.match(line)
        if match is None or match["type"] in _PRIMITIVES:
            continue
        parts = match["type"].split("/")
        owner = parts[0] if len(parts) > 1 else package
        found[f"{owner}/msg/{parts[-1]}"] = None
    return list(found)


@cache
def ros2msg(type_name: str) -> str:
    """Schema text of a type: its definition, then that of every type it needs, each once.

    Raises:
        RecordingError: the type or one of its dependencies is not installed.
    """
    needed: dict[str, None] = {}
    waiting = dependencies(type_name)
    while waiting:
        dependency = waiting.pop(0)
        if dependency not in needed:
            needed[dependency] = None
            waiting.extend(dependencies(dependency))
    sections = [definition(type_name)]
    for dependency in needed:
        package, _, name = dependency.split("/")
        sections.append(f"{SEPARATOR}\nMSG: {package}/{name}\n{definition(dependency)}")
    return "\n".join(section.rstrip("\n") for section in sections) + "\n"
