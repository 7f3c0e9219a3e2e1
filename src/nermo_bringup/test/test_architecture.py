"""Imports run one way: between packages as docs/architecture.md says, and between modules without a circle.

And what CONTRIBUTING.md and the hooks before a commit say is so.
"""

from __future__ import annotations

import ast
import re
from graphlib import TopologicalSorter
from pathlib import Path

import pytest
import yaml

from nermo_bringup.environment.checkout import checkout_root
from nermo_bringup.environment.import_graph import PAGE, allowed, imported, modules, packages, picture, redrawn
from nermo_bringup.testing import CHECKS

ROOT = checkout_root()
TEXT = (ROOT / PAGE).read_text(encoding="utf-8")
GRAPH = packages(ROOT)
MAY = allowed(TEXT)
SHARED = "nermo_node"
"""The package that may use rclpy outside of `nodes/`: it is what nodes share."""


def test_the_table_has_every_package_and_no_other() -> None:
    names = {path.parent.name for path in ROOT.glob("src/*/package.xml")}
    assert set(MAY) == names, f"{PAGE}: the table lacks {names - set(MAY)}, and has {set(MAY) - names} beyond"


def test_the_table_leads_down() -> None:
    above: set[str] = set()
    for name, others in MAY.items():
        assert others <= above, f"{PAGE}: {name} may import {others - above}, which stand below it"
        above.add(name)


@pytest.mark.parametrize("package", sorted(GRAPH))
def test_a_package_imports_what_it_may(package: str) -> None:
    assert GRAPH[package] <= MAY[package], f"{package} imports {GRAPH[package] - MAY[package]}: see {PAGE}"


def test_the_picture_is_drawn_from_the_code() -> None:
    assert redrawn(TEXT, GRAPH) == TEXT, "run python -m nermo_bringup.environment.import_graph"


def test_the_picture_leaves_out_what_follows() -> None:
    drawn = picture({"a": set(), "b": {"a"}, "c": {"a", "b"}})
    assert "b --> a" in drawn and "c --> b" in drawn
    assert "c --> a" not in drawn


def test_modules_import_each_other_in_no_circle() -> None:
    known = modules(ROOT)
    graph = {name: {other for other, _ in imported(file, known)} - {name} for name, file in known.items()}
    assert len(list(TopologicalSorter(graph).static_order())) == len(known)  # CycleError names the circle


def test_rclpy_stands_in_nodes() -> None:
    for name, file in modules(ROOT).items():
        package, *inner = name.split(".")
        if package == SHARED or "nodes" in inner:
            continue
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            names = [one.name for one in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            assert "rclpy" not in {one.split(".")[0] for one in names}, f"{file} imports rclpy outside of nodes/"


@pytest.mark.parametrize("page", ["CONTRIBUTING.md", "docs/changes.md"])
def test_the_files_that_contributors_are_sent_to_are_there(page: str) -> None:
    text = (ROOT / page).read_text(encoding="utf-8")
    named = set(re.findall(r"`((?:src|docs)/[\w./]+)`", text)) | {
        str(Path(page).parent / link) for link in re.findall(r"\]\(([\w./]+)\)", text)
    }
    assert len(named) > 10
    placeholders = ("NAME", "PACKAGE", "FAMILY", "ROBOT")
    missing = [name for name in named if not any(one in name for one in placeholders) and not (ROOT / name).exists()]
    assert not missing


def test_a_commit_is_checked_as_the_tests_check_it() -> None:
    hooks = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text(encoding="utf-8"))["repos"][0]["hooks"]
    assert {hook["id"]: hook["entry"].split()[2:] for hook in hooks} == CHECKS
