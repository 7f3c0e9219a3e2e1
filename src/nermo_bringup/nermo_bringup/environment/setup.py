"""Sets up whatever is missing: the Python environment in `.venv`, then the built workspace in `install`.

Run as `python -m nermo_bringup.environment.setup ROOT [--tests]` by the `nermo` script. A second run compares stamps
and is done in a tenth of a second. Standard library only.
"""

from __future__ import annotations

import contextlib
import fcntl
import shlex
import shutil
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from nermo_bringup.environment import python_packages, ros, workspace
from nermo_bringup.environment.checks import missing_required
from nermo_bringup.environment.steps import SetupError, say

_ACTIVATION = "nermo.bash"


def set_up(root: Path, tests: bool = False) -> None:
    """Makes the environment and builds the workspace, as far as that is not done already.

    Args:
        root: The checkout.
        tests: Fetch also what checks and tests need.

    Raises:
        SetupError: In one sentence, what is missing or failed and what to do about it.
    """
    started = time.monotonic()
    world = ros.find_world(root)
    venv = root / ".venv"
    with _lock(root):
        environment = python_packages.Environment(venv, root, world)
        packages = workspace.Workspace(root, world, environment.build_stamp())
        prepared = environment.ready_for_tests() if tests else environment.ready()
        if prepared and not packages.stale() and _activation(root, world) == _read(venv / _ACTIVATION):
            return
        if missing := missing_required():
            wanted = "; ".join(f"{package.what} ({finding.detail})" for package, finding in missing)
            commands = " && ".join(filter(None, (package.install_command() for package, _ in missing)))
            raise SetupError(
                f"missing: {wanted}. " + (f"Install with: {commands}" if commands else "Install and try again.")
            )
        if not environment.ready():
            say(f"setting up in {root} with {world.description}")
            environment.make()
        if tests and not environment.ready_for_tests():
            environment.add_tests()
        packages.build(environment.python)
        (venv / _ACTIVATION).write_text(_activation(root, world), encoding="utf-8")
    say(f"ready after {time.monotonic() - started:.0f} s")


@contextlib.contextmanager
def _lock(root: Path) -> Iterator[None]:
    """Lets one set-up at a time work in this checkout; a second one waits and then finds everything done."""
    path = root / ".cache" / "setup.lock"
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            say("waiting for another set-up of this checkout to finish")
            fcntl.flock(file, fcntl.LOCK_EX)
        yield


def _activation(root: Path, world: ros.World) -> str:
    """What `.venv/nermo.bash` says, which a shell sources to stand in the environment and the workspace."""
    venv = root / ".venv"
    lines = ["# Written by ./nermo. Source it to work in this environment and workspace by hand."]
    # Images of containers like to set it; then each of a dozen nodes compiles all that it imports, at every start.
    lines += [f"unset {name}" for name in ("PYTHONDONTWRITEBYTECODE", *world.variables_to_drop())]
    lines += [f'export {name}="${{{name}:-{value}}}"' for name, value in ros.DEFAULTS.items()]
    lines += [f"export {name}={shlex.quote(value)}" for name, value in world.variables(venv).items()]
    lines += [
        f"export VIRTUAL_ENV={shlex.quote(str(venv))}",
        f'export PATH={shlex.quote(str(venv / "bin"))}:"$PATH"',
        f"export NERMO_ROOT={shlex.quote(str(root))}",
        f"source {shlex.quote(str(root / 'install' / 'local_setup.bash'))}",
    ]
    return "\n".join(lines) + "\n"


def _read(file: Path) -> str | None:
    return file.read_text(encoding="utf-8") if file.exists() else None


def main(arguments: list[str] | None = None) -> int:
    """Entry point: sets up the checkout named by the first argument; returns the exit status."""
    given = sys.argv[1:] if arguments is None else arguments
    root = Path(given[0]).resolve()
    try:
        set_up(root, tests="--tests" in given[1:])
    except SetupError as error:
        print(f"nermo: {error}", file=sys.stderr)
        return 1
    except PermissionError as error:
        print(f"nermo: cannot write {error.filename}: the checkout must be writable.", file=sys.stderr)
        return 1
    except OSError as error:
        free = shutil.disk_usage(root).free / 1e9
        print(f"nermo: {error} ({free:.1f} GB free on this disk).", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("nermo: interrupted; the next run goes on from here.", file=sys.stderr)
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
