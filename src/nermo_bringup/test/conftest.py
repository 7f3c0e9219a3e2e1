"""What the tests share: a small ament prefix for what runs and launches, and a bench in the graph for nodes."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from node_bench import Bench


@pytest.fixture
def graph() -> Iterator[Bench]:
    """A bench that leaves nothing running."""
    from node_bench import Bench

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
