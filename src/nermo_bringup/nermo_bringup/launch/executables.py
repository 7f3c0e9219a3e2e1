"""Finding what a package offers to run and to launch, through the ament index."""

from __future__ import annotations

import json
import os
from pathlib import Path

from ament_index_python.packages import PackageNotFoundError, get_package_prefix

from nermo_bringup.launch.description import NodeAction
from nermo_description.results import CommandError


def find_executable(package: str, executable: str) -> Path:
    """The file that `ros2 run PACKAGE EXECUTABLE` would start.

    Raises:
        CommandError: There is no such package, or no such executable in it (with those that there are).
    """
    folder = _prefix(package) / "lib" / package
    path = folder / executable
    if path.is_file() and os.access(path, os.X_OK):
        return path
    offered = sorted(file.name for file in folder.iterdir() if file.is_file()) if folder.is_dir() else []
    there_are = f"it has: {', '.join(offered)}" if offered else "it has none"
    raise CommandError(f"the package {package} has no executable {executable!r}; {there_are}.", status=2)


def find_launch_file(package: str, name: str) -> Path:
    """The launch file of that name in a package's share folder.

    Raises:
        CommandError: There is no such package, or no such file in it (with those that there are).
    """
    share = _prefix(package) / "share" / package
    found = sorted(path for path in share.rglob(name) if path.is_file()) if Path(name).name == name else []
    if len(found) == 1:
        return found[0]
    if found:
        raise CommandError(f"the package {package} has several {name}: {', '.join(map(str, found))}.", status=2)
    offered = ", ".join(sorted(path.name for path in share.rglob("*.launch.xml"))) or "none"
    raise CommandError(f"the package {package} has no launch file {name!r}; it has: {offered}.", status=2)


def command_line(node: NodeAction) -> list[str]:
    """The command that starts a node with its name, namespace, parameters and remappings.

    Raises:
        CommandError: Its executable does not exist.
    """
    try:
        executable = find_executable(node.package, node.executable)
    except CommandError as error:
        raise CommandError(f"{node.origin}: {error}") from error
    command = [str(executable), *node.arguments, "--ros-args"]
    if node.name:
        command += ["-r", f"__node:={node.name}"]
    if node.namespace:
        command += ["-r", f"__ns:={node.namespace}"]
    for parameter in node.parameters:
        if isinstance(parameter, Path):
            command += ["--params-file", str(parameter)]
        else:  # JSON is YAML whose types cannot be mistaken
            command += ["-p", f"{parameter[0]}:={json.dumps(parameter[1])}"]
    for source, target in node.remappings:
        command += ["-r", f"{source}:={target}"]
    return command


def _prefix(package: str) -> Path:
    try:
        return Path(get_package_prefix(package))
    except (PackageNotFoundError, ValueError) as error:
        raise CommandError(f"there is no package {package!r} in the sourced workspace.", status=2) from error
