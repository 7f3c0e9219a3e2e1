"""`nermo test`: style, types, then every test; the last line says how many passed and failed."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO
from xml.etree import ElementTree

_NOTHING_COLLECTED = 5
_USAGE_ERROR = 4
CHECKS = {"style": ["ruff", "check"], "format": ["ruff", "format", "--check"], "types": ["mypy"]}
"""What is checked before the tests; `.pre-commit-config.yaml` has the same."""


_PARALLEL = ("-n", str(len(os.sched_getaffinity(0))), "--dist", "worksteal")
"""Some tests take minutes and most take none: whoever has finished takes over what waits behind another's long one."""


@dataclass
class Count:
    """What became of the tests."""

    passed: int = 0
    failed: int = 0
    errors: int = 0
    skipped: int = 0

    def add(self, report: Path) -> None:
        """Adds the figures of one JUnit report; a run that left none counts as an error."""
        try:
            suites = list(ElementTree.parse(report).getroot().iter("testsuite"))
        except (OSError, ElementTree.ParseError):
            self.errors += 1
            return
        for suite in suites:
            total, failed, errors, skipped = (
                int(suite.get(key, 0)) for key in ("tests", "failures", "errors", "skipped")
            )
            self.passed += total - failed - errors - skipped
            self.failed += failed
            self.errors += errors
            self.skipped += skipped

    def __str__(self) -> str:
        parts = [f"{self.passed} passed", f"{self.failed} failed"]
        parts += [f"{self.errors} errors"] if self.errors else []
        parts += [f"{self.skipped} skipped"] if self.skipped else []
        return ", ".join(parts)


def run_all(root: Path, *, quick: bool, pytest_arguments: Sequence[str]) -> int:
    """Checks style and types, then runs the tests: in parallel those without ROS, one by one those with.

    All of them: both kinds at once, for a graph mostly waits. Some of them: one kind after the other, so that pytest
    has the terminal to itself.

    Args:
        root: The checkout.
        quick: Leave out the tests that are marked slow.
        pytest_arguments: Handed on to pytest. Where there are any, style and types are left out.

    Returns:
        0 where everything passed, 1 where something failed, 2 where pytest did not understand its arguments.
    """
    started = time.monotonic()
    complaints: list[str] = []
    if not pytest_arguments:
        for name, arguments in CHECKS.items():
            _announce(f"{name}: {' '.join(arguments)}")
            if subprocess.run([sys.executable, "-m", *arguments], cwd=root).returncode != 0:
                complaints.append(name)
    count = Count()
    collected = False
    with tempfile.TemporaryDirectory(prefix="nermo_test_") as folder:
        for status, report in _run_pytest(root, Path(folder), quick, pytest_arguments):
            if status == _USAGE_ERROR:
                print("nermo: pytest did not understand its arguments.", file=sys.stderr)
                return 2
            if status != _NOTHING_COLLECTED:
                collected = True
                count.add(report)
                if status not in (0, 1) and not count.errors:
                    count.errors += 1
    if not collected:
        print("nermo: no test fits these arguments.", file=sys.stderr)
        return 1
    verdicts = (
        "" if pytest_arguments else "".join(f"; {name} {'failed' if name in complaints else 'ok'}" for name in CHECKS)
    )
    print(f"{count} in {time.monotonic() - started:.0f} s{verdicts}", flush=True)
    return int(bool(count.failed or count.errors or complaints))


def _run_pytest(root: Path, folder: Path, quick: bool, pytest_arguments: Sequence[str]) -> Iterator[tuple[int, Path]]:
    """Exit status and JUnit report of the tests without ROS, then of those with."""

    def run(
        marker: str, options: Sequence[str] = (), before: Sequence[str] = (), told: IO[bytes] | None = None
    ) -> tuple[subprocess.Popen[bytes], Path]:
        report = folder / f"{marker.replace(' ', '_')}.xml"
        markers = f"{marker} and not slow" if quick else marker
        command = [*before, sys.executable, "-m", "pytest", "-q", "--durations=20", "-m", markers, *options]
        command += [f"--junitxml={report}", *pytest_arguments]
        return subprocess.Popen(command, cwd=root, stdout=told, stderr=told), report

    without, graphs = "tests without ROS, in parallel", "tests with a ROS graph, one by one"
    if pytest_arguments:
        for what, marker, options in ((without, "not ros", _PARALLEL), (graphs, "ros", ())):
            _announce(what)
            process, report = run(marker, options)
            with process:
                yield process.wait(), report
        return
    output = folder / "ros.txt"
    with output.open("wb") as told:
        beside, graphs_report = run("ros", told=told)
    try:
        _announce(f"{without}, and beside them {graphs}")
        # Graphs come first: when they do not wait, some of them have to keep pace with the clock on the wall.
        process, report = run("not ros", _PARALLEL, before=["nice"])
        with process:
            yield process.wait(), report
        _announce(graphs)
    finally:
        # After Ctrl-C too: a test that is ended ends its graph.
        status = beside.wait()
    print(output.read_text(encoding="utf-8", errors="replace"), flush=True)
    yield status, graphs_report


def _announce(text: str) -> None:
    print(f"== {text}", flush=True)
