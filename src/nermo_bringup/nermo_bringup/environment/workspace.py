"""The colcon workspace: what must be built, and building it. Standard library only."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from pathlib import Path
from xml.etree import ElementTree

from nermo_bringup.environment.ros import World
from nermo_bringup.environment.steps import SetupError, say, step

_STAMP = "nermo-build.json"
_BUILD_FILES = {"package.xml", "setup.py", "setup.cfg", "CMakeLists.txt"}
_INTERFACE_SUFFIXES = {".msg", ".srv", ".action"}
_IGNORED_FOLDERS = ("test", "__pycache__", ".egg-info")


class Workspace:
    """The packages of one checkout.

    Args:
        root: The checkout.
        world: The ROS 2 to build against.
        environment: The build stamp of the Python environment; another one means building anew.
    """

    def __init__(self, root: Path, world: World, environment: dict[str, str]) -> None:
        self._root = root
        self._world = world
        self._environment = environment
        manifests = sorted((root / "src").glob("*/package.xml"))
        if not world.tf2_msgs:
            manifests.append(root / "vendor" / "tf2_msgs" / "package.xml")
        self._folders = [manifest.parent for manifest in manifests]

    def stale(self) -> list[str]:
        """Names of the packages whose build is missing or out of date."""
        written = self._written()
        installed = self._root / "install"
        return [
            name
            for name, key in self._keys().items()
            if written.get("packages", {}).get(name) != key or not (installed / name).is_dir()
        ]

    def build(self, python: Path) -> None:
        """Builds what is out of date, with links into the sources, so that edits in Python need no build.

        Args:
            python: The environment's interpreter; it runs colcon and becomes the nodes' own.

        Raises:
            SetupError: The build failed.
        """
        written = self._written()
        if written.get("environment") != self._environment:
            self._clear()
            written = {"environment": self._environment, "packages": {}}
        stale = self.stale()
        if not stale:
            return
        environment = self._world.environment(python.parent.parent)
        if shutil.which("make", path=environment["PATH"]) is None:
            environment.setdefault("CMAKE_GENERATOR", "Ninja")
        failed: list[str] = []
        at_work: list[str] = []

        def on_line(line: str) -> None:
            if line.startswith("Starting >>>"):
                at_work.append(line.split()[2])
            elif line.startswith("Finished <<<"):
                at_work.remove(line.split()[2])
                say("  built " + line.removeprefix("Finished <<<").strip())
            elif line.startswith("Failed   <<<"):
                failed.append(line.split()[2])

        command = [str(python), "-c", "import sys; from colcon_core.command import main; sys.exit(main())"]
        command += ["--log-base", str(self._root / "log"), "build", "--symlink-install"]
        command += ["--build-base", str(self._root / "build"), "--install-base", str(self._root / "install")]
        command += ["--base-paths", *map(str, self._folders), "--packages-select", *stale]
        command += ["--cmake-args", "-DCMAKE_BUILD_TYPE=Release", "-DBUILD_TESTING=OFF", "--no-warn-unused-cli"]
        keys = self._keys()
        try:
            step(
                f"building {len(stale)} of {len(keys)} packages",
                command,
                environment,
                on_line,
                lambda: _at_work(at_work),
            )
        except SetupError as error:
            if failed:
                log = self._root / "log" / "latest_build" / failed[0] / "stdout_stderr.log"
                raise SetupError(f"building {failed[0]} failed; its whole output is in {log}.") from error
            raise
        written["packages"] = {**written.get("packages", {}), **{name: keys[name] for name in stale}}
        (self._root / "install" / _STAMP).write_text(json.dumps(written, indent=1), encoding="utf-8")

    def _clear(self) -> None:
        """Removes a build of another environment, place or kind; mixing them breaks in obscure ways."""
        folders = [folder for folder in (self._root / "build", self._root / "install") if folder.exists()]
        if folders:
            say("build/ and install/ belong to another environment or were built by hand, and are built anew")
        for folder in folders:
            shutil.rmtree(folder)

    def _written(self) -> dict[str, dict[str, str]]:
        try:
            written = json.loads((self._root / "install" / _STAMP).read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return {}
        return written if written.get("environment") == self._environment else {}

    def _keys(self) -> dict[str, str]:
        """For each package a hash of what its build depends on."""
        return {_name(folder): _key(folder) for folder in self._folders}


def _at_work(packages: list[str]) -> str:
    """What colcon is building, in words."""
    what = " and ".join(packages)
    compiled = any(name.endswith(("_interfaces", "_msgs")) for name in packages)
    return what and f"building {what}{', messages take a minute or two to compile' if compiled else ''}"


def _name(folder: Path) -> str:
    """The package's name, from its manifest."""
    try:
        name = ElementTree.parse(folder / "package.xml").findtext("name")
    except ElementTree.ParseError as error:
        raise SetupError(f"{folder / 'package.xml'} is not valid XML: {error}.") from error
    if not name:
        raise SetupError(f"{folder / 'package.xml'} names no package.")
    return name


def _key(folder: Path) -> str:
    """Contents of what is compiled or configured, and the names of what is only linked to."""
    digest = hashlib.sha256()
    for parent, folders, files in os.walk(folder):
        folders[:] = sorted(
            name for name in folders if not name.startswith(".") and not name.endswith(_IGNORED_FOLDERS)
        )
        for name in sorted(files):
            path = Path(parent) / name
            if name.endswith((".py", ".pyc")) and name not in _BUILD_FILES:
                continue
            digest.update(str(path.relative_to(folder)).encode() + b"\0")
            if name in _BUILD_FILES or path.suffix in _INTERFACE_SUFFIXES:
                digest.update(path.read_bytes())
    return digest.hexdigest()
