"""`nermo test` on a workspace of a few lines: what runs beside what, what is counted, and how it ends."""

from __future__ import annotations

from pathlib import Path

import pytest

from nermo_bringup.testing import run_all

SETTINGS = """
[tool.pytest.ini_options]
markers = ["ros", "slow"]
timeout = 60
[tool.mypy]
files = ["test_*.py"]
"""
MEETS = """
import time
from pathlib import Path

import pytest


{mark}
def test_meets() -> None:
    Path("{own}").touch()
    while not Path("{other}").exists():
        time.sleep(0.01)
"""


@pytest.fixture
def root(tmp_path: Path) -> Path:
    (tmp_path / "pyproject.toml").write_text(SETTINGS, encoding="utf-8")
    for name, mark in (("plain", "@pytest.mark.slow"), ("graph", "@pytest.mark.ros")):
        other = "graph" if name == "plain" else "plain"
        text = MEETS.format(mark=mark, own=name, other=other)
        (tmp_path / f"test_{name}.py").write_text(text.lstrip(), encoding="utf-8")
    return tmp_path


def test_graphs_are_tested_beside_all_else_and_their_failures_are_told(
    root: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """Each of the two tests waits for the other, and then that of the graph fails."""
    with (root / "test_graph.py").open("a", encoding="utf-8") as file:
        file.write('    assert Path("plain").name == "graph"\n')
    assert run_all(root, quick=False, pytest_arguments=[]) == 1
    told = capfd.readouterr().out
    assert "AssertionError: assert 'plain' == 'graph'" in told and "1 passed, 1 failed in" in told
    assert told.rstrip().endswith("style ok; format ok; types ok")


def test_what_was_asked_for_has_the_terminal_to_itself(root: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (root / "plain").touch()
    assert run_all(root, quick=False, pytest_arguments=["test_graph.py"]) == 0
    assert "1 passed, 0 failed in" in capfd.readouterr().out
    assert run_all(root, quick=False, pytest_arguments=["test_graph.py", "--no-such-option"]) == 2
    assert run_all(root, quick=False, pytest_arguments=["test_graph.py", "-k", "nothing"]) == 1
    assert "no test fits these arguments" in capfd.readouterr().err
