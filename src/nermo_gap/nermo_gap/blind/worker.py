"""One mouse of a blind check, diagnosed in a process that sees this one alone: ``python -m nermo_gap.blind.worker``."""

from __future__ import annotations

import sys
from importlib.resources import files
from pathlib import Path

from nermo_gap.robots.diagnosis import diagnose_recordings
from simgap.analysis.diagnose import Diagnosis
from simgap.analysis.options import Options
from simgap.blind.worker import run


def of_mouse(case: Path, options: Options) -> Diagnosis:
    """A case whose folder holds a protocol's recordings."""
    return diagnose_recordings([case / "recordings"], None, options)


def robots() -> list[Path]:
    """Where the nominal robots are described, which a diagnosis has to read; a workspace may have linked them."""
    package = Path(str(files("nermo_description")))
    return [package.resolve(), *(place.resolve() for place in package.iterdir())]


if __name__ == "__main__":
    run(sys.argv[1:], of_mouse, robots())
