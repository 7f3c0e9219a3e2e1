"""What the tests share: a small ament prefix for what runs and launches, and a bench in the graph for nodes."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import pytest
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

PATIENCE_S = 90.0
"""How long a condition is waited for before the test fails; on an idle machine all hold within a second."""


class Bench:
    """A test's own node in a ROS domain, and the processes that it started there."""

    def __init__(self) -> None:
        self._context = Context()
        rclpy.init(context=self._context)
        self.node = Node("bench", context=self._context, start_parameter_services=False)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._processes: list[subprocess.Popen[str]] = []
        self._stopped: list[subprocess.Popen[str]] = []

    def start(self, module: str, *arguments: str, terminal: int | None = None) -> subprocess.Popen[str]:
        """Run the `main` of a node module with ROS arguments, as its console script does."""
        return self.run(f"import sys; from {module} import main; sys.exit(main())", *arguments, terminal=terminal)

    def run(self, code: str, *arguments: str, terminal: int | None = None) -> subprocess.Popen[str]:
        """Run Python code that becomes a node; on a terminal if one is given."""
        process = subprocess.Popen(
            [sys.executable, "-c", code, *(("--ros-args", *arguments) if arguments else ())],
            stdin=subprocess.DEVNULL if terminal is None else terminal,
            stdout=subprocess.PIPE if terminal is None else terminal,
            stderr=subprocess.STDOUT,
            text=True,
        )
        self._processes.append(process)
        return process

    def spin_until(self, condition: Callable[[], bool], what: str, patience: float = PATIENCE_S) -> None:
        """Serve the test's node until something holds; the test fails when it does not."""
        deadline = time.monotonic() + patience
        while not condition():
            for process in self._processes:
                # What it said last may be heard after it has ended.
                if process not in self._stopped and process.poll() is not None and not self._hears(condition):
                    raise AssertionError(f"a node ended before {what}: {process.communicate()[0]}")
            if time.monotonic() > deadline:
                raise AssertionError(f"waited {patience:g} s in vain until {what}")
            self._executor.spin_once(timeout_sec=0.02)

    def _hears(self, condition: Callable[[], bool]) -> bool:
        """Whether something holds after a second of serving the test's node."""
        deadline = time.monotonic() + 1.0
        while not condition() and time.monotonic() < deadline:
            self._executor.spin_once(timeout_sec=0.02)
        return condition()

    def stop(self, process: subprocess.Popen[str], number: int = signal.SIGINT) -> tuple[int, str]:
        """Exit status and output of a process after a signal."""
        self._stopped.append(process)
        process.send_signal(number)
        output, _ = process.communicate(timeout=PATIENCE_S)
        return process.returncode, output

    def close(self) -> None:
        """End every process and leave the graph."""
        for process in self._processes:
            if process.poll() is None:
                process.kill()
                process.communicate()
        self._executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self._context)

    @staticmethod
    def parameters(**values: object) -> Sequence[str]:
        """ROS arguments that set parameters."""
        return [argument for name, value in values.items() for argument in ("-p", f"{name}:={json.dumps(value)}")]


@pytest.fixture
def graph() -> Iterator[Bench]:
    """A bench that leaves nothing running."""
    made = Bench()
    try:
        yield made
    finally:
        made.close()


class Prefix:
    """An installed package named `toys`, with executables and launch files that a test writes."""

    def __init__(self, path: Path) -> None:
        self.path = path
        index = path / "share" / "ament_index" / "resource_index" / "packages"
        index.mkdir(parents=True)
        (index / "toys").touch()
        self.share = path / "share" / "toys"
        (self.share / "launch").mkdir(parents=True)
        self.executables = path / "lib" / "toys"
        self.executables.mkdir(parents=True)

    def executable(self, name: str, code: str) -> Path:
        file = self.executables / name
        file.write_text(f"#!{sys.executable} -S\n{code}", encoding="utf-8")
        file.chmod(0o755)
        return file

    def launch_file(self, body: str, name: str = "toys.launch.xml") -> Path:
        file = self.share / "launch" / name
        file.write_text(f"<launch>\n{body}\n</launch>\n", encoding="utf-8")
        return file


@pytest.fixture
def prefix(tmp_path, monkeypatch):
    prefix = Prefix(tmp_path / "prefix")
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(prefix.path))
    return prefix
