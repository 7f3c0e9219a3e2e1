"""What the system offers: one function a question, each answering with `Finding`. Standard library only."""

from __future__ import annotations

import ctypes
import os
import shutil
import subprocess
import sys
import sysconfig
import tomllib
from dataclasses import dataclass
from pathlib import Path

PACKAGES_FILE = Path(__file__).with_name("system_packages.toml")
OLDEST_PYTHON = (3, 11)
NEWEST_PYTHON = (3, 13)
_BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
_RENDER = """
import mujoco
model = mujoco.MjModel.from_xml_string("<mujoco><worldbody><geom size='1'/></worldbody></mujoco>")
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
with mujoco.Renderer(model, 16, 16) as renderer:
    renderer.update_scene(data)
    assert renderer.render().max() > 0, "the picture is black"
"""


@dataclass(frozen=True)
class Finding:
    """The answer to one question about the system.

    Attributes:
        ok: Whether it is there.
        detail: What was found, or what is missing, in plain words.
    """

    ok: bool
    detail: str


@dataclass(frozen=True)
class SystemPackage:
    """A thing that the operating system's package manager must bring.

    Attributes:
        name: Its name here.
        what: What it is, in plain words.
        why: What needs it.
        required: Whether Nermo cannot run without it.
        ci: Whether continuous integration installs it.
        check: The function of this module that looks for it.
        install: Package names for each package manager: ``apt``, ``dnf``, ``brew``.
    """

    name: str
    what: str
    why: str
    required: bool
    ci: bool
    check: str
    install: dict[str, str]

    def find(self) -> Finding:
        """Looks for it on this system."""
        finding: Finding = globals()[self.check]()
        return finding

    def install_command(self) -> str:
        """The command that installs it on this system, or an empty string where none is known."""
        for manager, command in (("apt", "apt-get install"), ("dnf", "dnf install"), ("brew", "brew install")):
            if shutil.which(command.split()[0]) and self.install.get(manager):
                return f"{command} {self.install[manager]}"
        return ""


def system_packages() -> list[SystemPackage]:
    """The list of `system_packages.toml`."""
    entries = tomllib.loads(PACKAGES_FILE.read_text(encoding="utf-8"))["package"]
    return [
        SystemPackage(
            name=entry["name"],
            what=entry["what"],
            why=entry["why"],
            required=entry["required"],
            ci=entry["ci"],
            check=entry["check"],
            install={manager: entry[manager] for manager in ("apt", "dnf", "brew")},
        )
        for entry in entries
    ]


def python_with_venv() -> Finding:
    """A Python of a version for which ROS 2 wheels exist, able to make environments."""
    version = ".".join(map(str, sys.version_info[:3]))
    if not OLDEST_PYTHON <= sys.version_info[:2] <= NEWEST_PYTHON:
        return Finding(False, f"this is Python {version}; 3.11, 3.12 or 3.13 is needed")
    try:
        import ensurepip  # noqa: F401  Debian splits it off into python3-venv
        import venv  # noqa: F401
    except ImportError as error:
        return Finding(False, f"Python {version} lacks the module {error.name}")
    return Finding(True, f"Python {version} at {sys.executable}")


def python_headers() -> Finding:
    """The C headers of the running Python."""
    header = Path(sysconfig.get_paths()["include"]) / "Python.h"
    if header.is_file():
        return Finding(True, str(header))
    return Finding(False, f"{header} does not exist")


def compiler() -> Finding:
    """A C and a C++ compiler, where CMake looks for them: CC and CXX, then the usual names."""
    found = []
    for variable, language, names in (("CC", "C", ("cc", "gcc", "clang")), ("CXX", "C++", ("c++", "g++", "clang++"))):
        wanted = os.environ.get(variable, "").split()
        path = next(filter(None, map(shutil.which, wanted[:1] or names)), None)
        if path is None:
            looked_for = wanted[0] if wanted else ", ".join(names)
            return Finding(False, f"no {language} compiler ({looked_for}) is in the PATH")
        found.append(path)
    return Finding(True, " and ".join(found))


def opengl(python: str = sys.executable) -> Finding:
    """OpenGL without a display, really tried: MuJoCo renders one small picture in a process of its own.

    Args:
        python: The interpreter that has MuJoCo; where none has it yet, only the libraries are looked for.
    """
    tried = []
    for backend in dict.fromkeys(filter(None, (os.environ.get("MUJOCO_GL"), "egl", "osmesa"))):
        if backend in ("disable", "disabled", "off"):
            return Finding(False, f"switched off by MUJOCO_GL={backend}")
        try:
            result = subprocess.run(
                [python, "-c", _RENDER],
                env={**os.environ, "MUJOCO_GL": backend},
                capture_output=True,
                text=True,
                timeout=60,
            )
        except subprocess.TimeoutExpired:
            tried.append(f"{backend}: nothing after 60 s")
            continue
        if result.returncode == 0:
            return Finding(True, f"MUJOCO_GL={backend} renders")
        if "No module named 'mujoco'" in result.stderr:
            return _opengl_libraries()
        lines = result.stderr.strip().splitlines()
        tried.append(f"{backend}: {lines[-1] if lines else f'ended with status {result.returncode}'}")
    return Finding(False, "; ".join(tried))


def _opengl_libraries() -> Finding:
    """The libraries, where MuJoCo is not there to try them."""
    for name in ("libEGL.so.1", "libOSMesa.so.8", "libOSMesa.so.6"):
        try:
            ctypes.CDLL(name)
        except OSError:
            continue
        return Finding(True, f"{name} is there; not tried, mujoco is not installed yet")
    return Finding(False, "neither libEGL nor libOSMesa is there")


def browser() -> Finding:
    """A browser that can run without a display."""
    path = next(filter(None, map(shutil.which, _BROWSERS)), None)
    return Finding(True, path) if path else Finding(False, "none in the PATH")


def missing_required() -> list[tuple[SystemPackage, Finding]]:
    """The required packages that are not there, with what was found instead."""
    findings = [(package, package.find()) for package in system_packages() if package.required]
    return [(package, finding) for package, finding in findings if not finding.ok]
