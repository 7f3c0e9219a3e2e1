"""`nermo doctor`: what is installed, what is missing, and what to do about it. Standard library only.

It must be able to say what is wrong when nothing else works, so it runs with any Python 3.11 before anything is set up.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

from nermo_bringup.environment import checks, python_packages, ros, workspace
from nermo_bringup.environment.checkout import checkout_root
from nermo_bringup.environment.steps import SetupError
from nermo_description.invocation import called
from nermo_description.results import CommandError, write_results

_ASK_RMW = "import rclpy.utilities as u; print(u.get_rmw_implementation_identifier())"
_ASK_NUMPY = "import numpy; print(numpy.__version__)"
_NEEDED_DISK_GB = 2.0


@dataclass(frozen=True)
class Row:
    """One line of the doctor's table.

    Attributes:
        name: What was looked at.
        status: `ok`, `missing` where Nermo cannot run without, `none` where it can.
        found: What was found.
        remedy: What to do about it; empty where there is nothing to do.
    """

    name: str
    status: str
    found: str
    remedy: str = ""


def examine(root: Path) -> list[Row]:
    """Looks at everything, one row each.

    Args:
        root: The checkout.
    """
    world = ros.find_world(root)
    environment = python_packages.Environment(root / ".venv", root, world)
    python = str(environment.python) if environment.python.exists() else sys.executable
    rows = list(_system(python))
    rows += [Row("ROS 2", "ok", world.description)]
    rows += list(_own(root, world, environment))
    rows += list(_surroundings(root))
    return rows


def _system(python: str) -> Iterator[Row]:
    for package in checks.system_packages():
        finding = checks.opengl(python) if package.name == "opengl" else package.find()
        if finding.ok:
            yield Row(package.what, "ok", finding.detail)
            continue
        command = package.install_command()
        remedy = f"{command or 'install it'}  ({package.why})"
        yield Row(package.what, "missing" if package.required else "none", finding.detail, remedy)


def _own(root: Path, world: ros.World, environment: python_packages.Environment) -> Iterator[Row]:
    set_up = "any ./nermo command sets it up"
    ready = environment.ready()
    yield Row("Python environment", *(("ok", str(environment.path)) if ready else ("none", "not set up yet", set_up)))
    try:
        stale = workspace.Workspace(root, world, environment.build_stamp()).stale()
    except SetupError as error:
        yield Row("built workspace", "missing", str(error), "repair that file")
    else:
        built = ("none", f"to be built: {', '.join(stale)}", set_up) if stale else ("ok", str(root / "install"))
        yield Row("built workspace", *built)
    if ready:
        variables = world.environment(environment.path)
        for name, question in (("ROS middleware", _ASK_RMW), ("NumPy", _ASK_NUMPY)):
            command = [str(environment.python), "-c", question]
            result = subprocess.run(command, env=variables, capture_output=True, text=True)
            if result.returncode == 0:
                yield Row(name, "ok", result.stdout.strip())
            else:
                reason = (result.stderr.strip().splitlines() or ["no reason given"])[-1]
                yield Row(name, "missing", reason, "delete .venv; any ./nermo command sets it up again")


def _surroundings(root: Path) -> Iterator[Row]:
    display = os.environ.get("WAYLAND_DISPLAY") or os.environ.get("DISPLAY")
    yield Row(
        "display", *(("ok", display) if display else ("none", "no window of MuJoCo; pictures and videos instead"))
    )
    yield _devices("gamepads", sorted(Path("/dev/input").glob("js*")), "plug one in, or use the keyboard teleop")
    ports = sorted(path for pattern in ("ttyUSB*", "ttyACM*", "cu.usb*") for path in Path("/dev").glob(pattern))
    yield _devices("serial ports", ports, "plug the robot's cable in")
    yield _network_namespaces()
    free = shutil.disk_usage(root).free / 1e9
    enough = free >= _NEEDED_DISK_GB
    remedy = "" if enough else f"make room: environment and build take {_NEEDED_DISK_GB:g} GB"
    yield Row("disk", "ok" if enough else "missing", f"{free:.1f} GB free", remedy)


def _devices(name: str, paths: list[Path], remedy: str) -> Row:
    if not paths:
        return Row(name, "none", "none connected", remedy)
    closed = [str(path) for path in paths if not os.access(path, os.R_OK)]
    if closed:
        group = "input" if name == "gamepads" else "dialout"
        return Row(
            name, "none", f"may not be read: {', '.join(closed)}", f"sudo usermod -aG {group} $USER, log in again"
        )
    return Row(name, "ok", ", ".join(map(str, paths)))


def _network_namespaces() -> Row:
    """Whether graphs can be kept apart completely, each with a network of its own; tests use ROS domains instead."""
    name = "network namespaces"
    for command in (["unshare", "-n", "true"], ["unshare", "-rn", "true"]):
        if shutil.which("unshare") and subprocess.run(command, capture_output=True).returncode == 0:
            return Row(name, "ok", " ".join(command[:-1]))
    return Row(name, "none", "not allowed here; graphs are kept apart by ROS_DOMAIN_ID")


def main(arguments: list[str] | None = None) -> int:
    """Entry point; returns 0 where Nermo can run, 1 where something required is missing."""
    parser = argparse.ArgumentParser(
        prog=f"{called()} doctor",
        description="Say what is installed, what is missing, and what to do about it.",
        epilog="Exit status 0 where Nermo can run, 1 where something that it needs is missing. "
        f"Examples: {called()} doctor; {called()} doctor --json doctor.json",
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the findings to this file")
    parser.add_argument("--root", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--missing-apt", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    if options.missing_apt:
        missing = (package for package in checks.system_packages() if package.ci and not package.find().ok)
        print(" ".join(package.install["apt"] for package in missing))
        return 0
    try:
        rows = examine(options.root or checkout_root())
        ok = all(row.status != "missing" for row in rows)
        _print(rows)
        if options.json is not None:
            write_results(options.json, "doctor", {"ok": ok, "rows": [asdict(row) for row in rows]})
    except (CommandError, FileNotFoundError) as error:
        print(f"nermo: {error}", file=sys.stderr)
        return 1
    if not ok:
        names = "; ".join(row.name for row in rows if row.status == "missing")
        print(f"nermo: missing, and needed: {names}.", file=sys.stderr)
    return 0 if ok else 1


def _print(rows: list[Row]) -> None:
    width = max(len(row.name) for row in rows)
    for row in rows:
        print(f"{row.status:8} {row.name:{width}}  {row.found}")
        if row.remedy:
            print(f"{'':8} {'':{width}}  -> {row.remedy}")


if __name__ == "__main__":
    sys.exit(main())
