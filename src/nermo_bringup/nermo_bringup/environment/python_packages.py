"""The Python environment in `.venv`, filled from requirements.lock, and for tests from requirements-test.lock.

Standard library only.
"""

from __future__ import annotations

import hashlib
import json
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from nermo_bringup.environment.ros import World
from nermo_bringup.environment.steps import SetupError, say, step

LOCKS = ("requirements.lock", "requirements-test.lock")
"""What runs, and what only checks and tests need."""
_STAMP, _TEST_STAMP = "nermo-environment.json", "nermo-tests.json"
_PIN = re.compile(r"^(?P<name>[A-Za-z0-9._-]+)==(?P<version>[^\s;]+)(?P<marker>\s*;[^\\]*)?")
_BUILD_PACKAGES = ("ros-", "colcon-", "setuptools", "numpy")
_NAME = re.compile(r"^[A-Za-z0-9._-]+")
_LOWER = re.compile(r">=\s*([0-9.]+)")
_UPPER = re.compile(r"<\s*([0-9.]+)")
# A message with an array goes through the NumPy interface that the sourced ROS was compiled against.
_TRY_ROS = """
import numpy
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import Imu
message = Imu()
message.orientation_covariance[4] = 0.5
assert deserialize_message(serialize_message(message), Imu).orientation_covariance[4] == 0.5
"""
# The parent may hold ROS 2 as wheels, whose own start-up only finds the libraries of the environment that runs.
_SEE_PARENT = """import os
import site

if not os.environ.get("_ROS_WHEELS_BOOTSTRAP_COMPLETE"):
    os.environ["LD_LIBRARY_PATH"] = os.pathsep.join([*{libraries!r}, os.environ.get("LD_LIBRARY_PATH", "")])
site.addsitedir({parent!r})
"""
# Where a distribution is there twice, the first one in the path is the one that is imported.
_LIST_DISTRIBUTIONS = """
import importlib.metadata, json
found = [(d.metadata["Name"], d.version) for d in importlib.metadata.distributions() if d.metadata["Name"]]
print(json.dumps(dict(reversed(found))))
"""


class Environment:
    """The virtual environment of one checkout.

    Args:
        path: Where it is or shall be.
        root: The checkout, with requirements.in, requirements-test.in and their locks.
        world: The ROS 2 that it must fit.
    """

    def __init__(self, path: Path, root: Path, world: World) -> None:
        self.path = path
        self.python = path / "bin" / "python"
        self._root = root
        self._lock = root / "requirements.lock"
        self._wanted = root / "requirements.in"
        self._test_lock, self._test_wanted = root / "requirements-test.lock", root / "requirements-test.in"
        self._world = world

    def stamp(self) -> dict[str, str]:
        """What the environment depends on; it is made anew when any of it changes."""
        return {
            "path": str(self.path),
            "python": f"{sys.base_prefix} {sys.version}",
            "ros": f"{self._world.distro} {self._world.location}",
            "packages": hashlib.sha256(self._lock.read_bytes() + self._wanted.read_bytes()).hexdigest(),
        }

    def build_stamp(self) -> dict[str, str]:
        """What the built workspace depends on: as `stamp`, but of the packages only those that take part in a build."""
        pins = [f"{pin['name']} {pin['version']}" for pin in self._pins() if pin["name"].startswith(_BUILD_PACKAGES)]
        return {**self.stamp(), "packages": hashlib.sha256("\n".join(pins).encode()).hexdigest()}

    def ready(self) -> bool:
        """Whether it is there, whole and up to date."""
        try:
            written = json.loads((self.path / _STAMP).read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return False
        return bool(written == self.stamp()) and self.python.exists()

    def _test_stamp(self) -> dict[str, str]:
        text = self._test_lock.read_bytes() + self._test_wanted.read_bytes()
        return {**self.stamp(), "tests": hashlib.sha256(text).hexdigest()}

    def ready_for_tests(self) -> bool:
        """Whether what tests need is there too, and up to date."""
        try:
            written = json.loads((self.path / _TEST_STAMP).read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return False
        return self.ready() and bool(written == self._test_stamp())

    def add_tests(self) -> None:
        """Installs what tests need, beside all else.

        Raises:
            SetupError: A step failed.
        """
        say("checks and tests need some packages more, which stay in .venv")
        environment = self._world.environment(self.path)
        if self._world.distro:
            self._install_missing(self._test_wanted, self._test_lock, environment)
        else:
            self._install_all(self._test_lock, environment)
        (self.path / _TEST_STAMP).write_text(json.dumps(self._test_stamp(), indent=1), encoding="utf-8")

    def make(self) -> None:
        """Makes it from nothing.

        Raises:
            SetupError: A step failed.
        """
        if self.path.exists():
            say("the Python environment is out of date and is made anew")
            shutil.rmtree(self.path)
        options = ["--system-site-packages"] if self._world.distro else []
        base = getattr(sys, "_base_executable", sys.executable) if self._world.distro is None else sys.executable
        environment = self._world.environment(self.path)
        step("making the Python environment .venv", [base, "-m", "venv", *options, str(self.path)], environment)
        if self._world.distro:
            self._see_parent()
            self._try_ros(environment)  # before anything is downloaded in vain
            self._install_missing(self._wanted, self._lock, environment)
            self._try_ros(environment)
        else:
            self._install_all(self._lock, environment)
        (self.path / _STAMP).write_text(json.dumps(self.stamp(), indent=1), encoding="utf-8")

    def _pip(self, *arguments: str) -> list[str]:
        return [str(self.python), "-m", "pip", "--disable-pip-version-check", "--no-input", *arguments]

    def _install_all(self, lock: Path, environment: dict[str, str]) -> None:
        """Installs a whole lock file, with uv where it can be had (seconds), else with pip (a minute)."""
        if self._install_with_uv(lock, environment):
            return
        what = f"installing {sum(1 for _ in _pins(lock))} Python packages with pip"
        step(what, self._pip("install", "--require-hashes", "-r", str(lock)), environment)

    def _install_with_uv(self, lock: Path, environment: dict[str, str]) -> bool:
        try:
            command = [*self._uv(environment), "install", *self._here(), "--require-hashes", "-r", str(lock)]
            step(f"installing {sum(1 for _ in _pins(lock))} Python packages", command, _for_uv(environment))
        except SetupError as error:
            say(f"{error} Trying pip instead.")
            return False
        return True

    def _uv(self, environment: dict[str, str]) -> list[str]:
        """The command `uv pip` for this environment; uv is installed into it where the system has none.

        Raises:
            SetupError: It cannot be had.
        """
        uv = shutil.which("uv") or str(self.path / "bin" / "uv")
        if not Path(uv).exists():
            with tempfile.TemporaryDirectory() as folder:
                only_uv = Path(folder) / "uv.txt"
                only_uv.write_text(self._entry("uv"), encoding="utf-8")
                step("installing uv", self._pip("install", "--require-hashes", "-r", str(only_uv)), environment)
        return [uv, "pip"]

    def _here(self) -> list[str]:
        return ["--python", str(self.python)]

    def _pins(self) -> Iterator[re.Match[str]]:
        """The pinned packages of the lock file, one match each."""
        return _pins(self._lock)

    def _entry(self, name: str) -> str:
        """The lock file's lines for one package, hashes included."""
        lines = self._lock.read_text(encoding="utf-8").splitlines()
        start = next(index for index, line in enumerate(lines) if line.startswith(f"{name}=="))
        end = start + 1
        while end < len(lines) and lines[end].startswith(" "):
            end += 1
        return "\n".join(lines[start:end]) + "\n"

    def _see_parent(self) -> None:
        """Lets an environment made from another environment see that one's packages, as it sees the system's."""
        if sys.prefix == sys.base_prefix:
            return
        packages = Path("lib") / f"python{sys.version_info.major}.{sys.version_info.minor}" / "site-packages"
        parent = Path(sys.prefix) / packages
        libraries = [str(Path(sys.prefix) / "lib"), *sorted(map(str, parent.glob("ros_*.libs")))]
        own = self.path / packages
        (own / "_parent_environment.py").write_text(_SEE_PARENT.format(parent=str(parent), libraries=libraries))
        (own / "_parent_environment.pth").write_text("import _parent_environment\n")

    def _install_missing(self, asked: Path, lock: Path, environment: dict[str, str]) -> None:
        """Installs only what the sourced ROS 2 and its system lack, in the lock file's versions where they fit."""
        wanted = [
            line.split("#")[0].strip()
            for line in asked.read_text(encoding="utf-8").splitlines()
            if line.strip() and not line.startswith(("#", "ros-"))
        ]
        present = self._present(environment)
        unfit = {_name(line) for line in wanted if not _fits(line, present)}
        kept = {name: version for name, version in present.items() if name not in unfit}
        numpy = [f"numpy=={kept['numpy']}"] if "numpy" in kept else []
        if numpy:
            say(f"keeping NumPy {kept['numpy']}, which the sourced ROS 2 uses")
        missing = [line for line in wanted if _name(line) not in kept]
        what = f"installing what this ROS 2 lacks: {len(missing)} Python packages and what they need"
        with tempfile.TemporaryDirectory() as folder:
            requirements = Path(folder) / "requirements.txt"
            requirements.write_text("\n".join(missing + numpy) + "\n", encoding="utf-8")
            try:
                uv = self._uv(environment)
                # What stands in the output file beforehand is what the resolver prefers.
                resolved = Path(folder) / "resolved.txt"
                resolved.write_text("\n".join(pin[0] for pin in _pins(lock)) + "\n", encoding="utf-8")
                command = [*uv, "compile", *self._here(), "--quiet", "--no-annotate", "--no-header", str(requirements)]
                step("choosing versions that fit", [*command, "-o", str(resolved)], _for_uv(environment))
                lacking = [f"{pin['name']}=={pin['version']}" for pin in _pins(resolved) if _name(pin[0]) not in kept]
                resolved.write_text("\n".join(lacking) + "\n", encoding="utf-8")
                step(what, [*uv, "install", *self._here(), "--no-deps", "-r", str(resolved)], _for_uv(environment))
            except SetupError as error:
                say(f"{error} Trying pip instead.")
                step(what, self._pip("install", "-r", str(requirements)), environment)

    def _present(self, environment: dict[str, str]) -> dict[str, str]:
        """Versions of the distributions that the environment sees, its system's included."""
        command = [str(self.python), "-c", _LIST_DISTRIBUTIONS]
        listing = subprocess.run(command, env=environment, capture_output=True, text=True)
        if listing.returncode != 0:
            raise SetupError(f"the new environment's Python does not run: {listing.stderr.strip()[-300:]}")
        return {normal_name(name): version for name, version in json.loads(listing.stdout).items()}

    def _try_ros(self, environment: dict[str, str]) -> None:
        """Sends one message through the sourced ROS 2's own code, from within the environment."""
        result = subprocess.run([str(self.python), "-c", _TRY_ROS], env=environment, capture_output=True, text=True)
        if result.returncode == 0:
            return
        reason = (result.stderr.strip().splitlines() or [f"signal {-result.returncode}"])[-1]
        numpy = subprocess.run(
            [str(self.python), "-c", "import numpy; print(numpy.__version__, 'at', numpy.__file__)"],
            env=environment,
            capture_output=True,
            text=True,
        )
        found = numpy.stdout.strip() or "that cannot even be imported"
        if "numpy" in result.stderr.lower() or "_ARRAY_API" in result.stderr:
            raise SetupError(
                f"NumPy {found} clashes with the sourced ROS 2 {self._world.distro}, whose messages were built for "
                f"another one ({reason}); remove that NumPy (for one installed with --user: pip uninstall numpy)."
            )
        raise SetupError(
            f"ROS 2 {self._world.distro} is sourced, but Python {sys.version.split()[0]} cannot use its rclpy "
            f"({reason}); source Jazzy or Kilted with its own Python first in the PATH, or unset ROS_DISTRO to use "
            "ROS 2 from PyPI."
        )


def _pins(lock: Path) -> Iterator[re.Match[str]]:
    return filter(None, map(_PIN.match, lock.read_text(encoding="utf-8").splitlines()))


def pinned_packages(lock: Path) -> list[tuple[str, str]]:
    """Names and versions of a lock file, without those for Windows; one may come twice, for different Pythons."""
    return [(pin["name"], pin["version"]) for pin in _pins(lock) if "'win32'" not in (pin["marker"] or "")]


def normal_name(name: str) -> str:
    """A distribution's name as PEP 503 compares it."""
    return re.sub(r"[-_.]+", "-", name).lower()


def _name(requirement: str) -> str:
    """The normal name of the distribution that a requirement or a pin asks for."""
    match = _NAME.match(requirement)
    assert match is not None, requirement
    return normal_name(match[0])


def _fits(requirement: str, present: dict[str, str]) -> bool:
    """Whether a distribution is there in a version between the requirement's bounds."""
    name = _name(requirement)
    if name not in present:
        return False
    version = _numbers(present[name])
    lower, upper = _LOWER.search(requirement), _UPPER.search(requirement)
    return (lower is None or version >= _numbers(lower[1])) and (upper is None or version < _numbers(upper[1]))


def _numbers(version: str) -> list[int]:
    """The leading numbers of a version, for comparing with a bound."""
    return [int(part) for part in re.findall(r"\d+", version.split("+")[0])[:3]]


def _for_uv(environment: dict[str, str]) -> dict[str, str]:
    """An environment in which uv asks the index that pip would ask, and trusts the certificates of this machine."""
    # UV_NATIVE_TLS is what older versions call it; behind a company's proxy neither works without.
    result = {"UV_SYSTEM_CERTS": "true", "UV_NATIVE_TLS": "true", **environment}
    if "PIP_INDEX_URL" in environment:
        result.setdefault("UV_DEFAULT_INDEX", environment["PIP_INDEX_URL"])
    return result
