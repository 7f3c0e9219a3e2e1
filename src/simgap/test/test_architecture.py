"""simgap stands alone: no ROS, nothing of this workspace, and folders that import one way only."""

import ast
from pathlib import Path

import pytest

import simgap

ROOT = Path(simgap.__file__).parent
LAYERS = (
    "data",
    "execution",
    "simulation",
    "effects",
    "inference",
    "analysis",
    "correction",
    "preparation",
    "monitoring",
    "report",
    "live",
    "blind",
    "examples",
)
"""Lowest first; what stands beside them (the command) may use all."""


def imports(file: Path) -> set[str]:
    """Full names of the modules that a file imports, at its top or later."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {name.name for name in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{file}: relative import"
            found |= {f"{node.module}.{name.name}" for name in node.names}
    return found


def test_no_ros_and_no_other_package_of_the_workspace() -> None:
    others = {path.parent.name for path in ROOT.parents[1].glob("*/package.xml")} - {"simgap"}
    for file in ROOT.rglob("*.py"):
        roots = {name.split(".")[0] for name in imports(file)}
        foreign = {
            r for r in roots if r in others or r.startswith(("nermo", "rcl", "ros", "ament")) or r.endswith("_msgs")
        } - {"rosbags"}  # which reads bags without ROS
        assert not foreign, f"{file} imports {sorted(foreign)}"


@pytest.mark.parametrize("layer", LAYERS)
def test_folders_import_downwards_only(layer: str) -> None:
    below = {"__version__", *LAYERS[: LAYERS.index(layer) + 1]}
    for file in (ROOT / layer).rglob("*.py"):
        for name in imports(file):
            words = name.split(".")
            if words[0] == "simgap" and len(words) > 1:
                assert words[1] in below, f"{file} imports {name}"


def test_every_folder_has_its_layer() -> None:
    assert {file.parent.name for file in ROOT.glob("*/__init__.py")} | {"examples"} == set(LAYERS)


def test_modules_import_each_other_in_no_circle() -> None:
    names = {".".join(file.relative_to(ROOT.parent).with_suffix("").parts): file for file in ROOT.rglob("*.py")}
    edges = {}
    for name, file in names.items():
        needed = imports(file)
        edges[name] = {n for n in names if any(i == n or i.startswith(f"{n}.") for i in needed)} - {name}
    while free := [name for name, needs in edges.items() if not needs & edges.keys()]:
        for name in free:
            del edges[name]
    assert not edges, f"circle among {sorted(edges)}"
