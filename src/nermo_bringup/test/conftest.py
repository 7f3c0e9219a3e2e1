"""What the tests share: a small ament prefix for what runs and launches, and a bench in the graph for nodes."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest
from graph_bench import GraphBench


class Bench(GraphBench):
    """A test's own node in a ROS domain, and the nodes that it started there."""

    def __init__(self) -> None:
        super().__init__(start_parameter_services=False)

    def start(self, module: str, *arguments: str, terminal: int | None = None) -> subprocess.Popen[str]:
        """Run the `main` of a node module with ROS arguments, as its console script does."""
        return self.run(f"import sys; from {module} import main; sys.exit(main())", *arguments, terminal=terminal)

    def run(self, code: str, *arguments: str, terminal: int | None = None) -> subprocess.Popen[str]:
        """Run Python code that becomes a node; on a terminal if one is given."""
        command = [sys.executable, "-c", code, *(("--ros-args", *arguments) if arguments else ())]
        if terminal is None:
            return self.begin(command, stdin=subprocess.DEVNULL)
        return self.begin(command, stdin=terminal, stdout=terminal, stderr=terminal)

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
