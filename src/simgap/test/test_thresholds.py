"""The numbers that decide a verdict stand in one file, and the method's page tells each."""

from __future__ import annotations

import ast
import importlib
import inspect
import re
from pathlib import Path

import pytest

from simgap.inference import thresholds

PAGE = Path(__file__).parents[3] / "docs" / "simgap" / "method.md"
NUMBERS = {name: value for name, value in vars(thresholds).items() if name.isupper()}


def test_they_are_ten_and_the_page_has_their_values() -> None:
    assert len(NUMBERS) <= 10
    rows = re.findall(r"^\| `([A-Z_]+)` \| ([0-9.]+) \|", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
    assert {name: float(value) for name, value in rows} == NUMBERS


@pytest.mark.parametrize("module", ["verdict", "decision", "likelihood"])
def test_who_judges_has_no_threshold_of_its_own(module: str) -> None:
    """But for how often something is drawn or iterated, how wide a prior of one window is, and shares of 0, 1/2, 1."""
    tree = ast.parse(inspect.getsource(importlib.import_module(f"simgap.inference.{module}")))
    counts = {"_DRAWS", "_ROUNDS", "_SETTLED", "PRIOR_WINDOWS"}
    own = [
        node
        for node in tree.body
        if isinstance(node, ast.Assign)
        and not {n.id for n in ast.walk(node.targets[0]) if isinstance(n, ast.Name)} <= counts
        and any(isinstance(n, ast.Constant) and isinstance(n.value, float) for n in ast.walk(node.value))
    ]
    assert not own, [ast.unparse(node) for node in own]
    compared = [
        ast.unparse(node)
        for node in ast.walk(tree)
        if isinstance(node, ast.Compare)
        for other in node.comparators
        if isinstance(other, ast.Constant) and isinstance(other.value, float) and other.value not in (0.0, 0.5, 1.0)
    ]
    assert not compared, compared
