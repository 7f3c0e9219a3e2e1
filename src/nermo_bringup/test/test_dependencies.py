"""What is imported is declared; what is declared is documented, pinned and has its licence listed."""

import ast
import re
import sys
from functools import cache
from pathlib import Path
from xml.etree import ElementTree

import pytest

from nermo_bringup.environment.checkout import checkout_root
from nermo_bringup.environment.python_packages import LOCKS, normal_name, pinned_packages

ROOT = checkout_root()
PACKAGES = sorted(path.parent.name for path in ROOT.glob("src/*/package.xml"))
DEPENDS = ("depend", "exec_depend", "test_depend", "buildtool_depend", "build_depend")
# Packages of ROS 2, whose import, key and name are one.
ROS = {
    *("ament_cmake", "ament_index_python", "builtin_interfaces", "diagnostic_msgs", "geometry_msgs", "nav_msgs"),
    *("rcl_interfaces", "rclpy", "rosgraph_msgs", "rosidl_default_generators", "rosidl_default_runtime", "sensor_msgs"),
    *("std_msgs", "std_srvs", "tf2_msgs", "trajectory_msgs", "visualization_msgs", "rosidl_runtime_py", "service_msgs"),
}


@cache
def table() -> dict[str, tuple[str, str]]:
    """Rosdep key and PyPI name of each import, from docs/dependencies.md."""
    text = (ROOT / "docs" / "dependencies.md").read_text(encoding="utf-8")
    return {m[1]: (m[2], m[3]) for m in re.finditer(r"^\| `(\w+)` \| (\S+) \| (\S+) \|$", text, re.MULTILINE)}


OPTIONAL = {"distributed"}
"""Modules that the user installs if wanted; nothing needs them."""


def declared(package: str) -> set[str]:
    root = ElementTree.parse(ROOT / "src" / package / "package.xml").getroot()
    names = [element.text for tag in DEPENDS for element in root.findall(tag)]
    return {name for name in names + [element.text for element in root.findall("export/pip_depend")] if name}


def imports(folder: Path) -> set[str]:
    found = set()
    for file in folder.rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                found.update(name.name.split(".")[0] for name in node.names)
            elif isinstance(node, ast.ImportFrom) and node.level == 0:
                found.add(node.module.split(".")[0])
    return found - set(sys.stdlib_module_names)


def name_in_manifest(module: str) -> str:
    if module in ROS or module in PACKAGES:
        return module
    assert module in table(), f"docs/dependencies.md does not know the import {module}"
    key, name = table()[module]
    return name if key == "-" else key


@pytest.mark.parametrize("package", PACKAGES)
def test_what_is_imported_is_declared(package):
    modules = imports(ROOT / "src" / package / package) - {package} - OPTIONAL
    used = {name_in_manifest(module) for module in modules}
    assert used <= declared(package), f"{package}/package.xml lacks {sorted(used - declared(package))}"


@pytest.mark.parametrize("package", PACKAGES)
def test_what_is_declared_is_known(package):
    known = {name if key == "-" else key for key, name in table().values()}
    assert declared(package) <= known | ROS | set(PACKAGES)


def required(lock):
    """Names in the list that a lock file was made from."""
    lines = (ROOT / lock.replace(".lock", ".in")).read_text(encoding="utf-8").splitlines()
    return {normal_name(re.match(r"[\w.-]+", line)[0]) for line in lines if line and not line.startswith("#")}


def pinned(lock):
    return {normal_name(name): version for name, version in pinned_packages(ROOT / lock)}


def test_what_is_documented_is_required():
    assert {normal_name(name) for _, name in table().values()} <= set().union(*map(required, LOCKS))


@pytest.mark.parametrize("lock", LOCKS)
def test_lock_file_holds_all_that_is_required(lock):
    assert required(lock) <= set(pinned(lock))


def test_what_tests_add_changes_nothing_of_what_runs():
    run, test = map(pinned, LOCKS)
    for name in run.keys() & test.keys():
        assert test[name] == run[name]


@pytest.mark.parametrize("package", PACKAGES)
def test_what_runs_imports_nothing_that_tests_alone_need(package):
    """Who only drives the mouse has none of it; Dask is optional, and asked for."""
    tests_only = {normal_name(name) for name in pinned(LOCKS[1]).keys() - pinned(LOCKS[0]).keys()}
    modules = imports(ROOT / "src" / package / package) - OPTIONAL
    names = {normal_name(table()[m][1] if m in table() else m) for m in modules}
    assert not names & tests_only


def test_every_licence_is_listed():
    text = (ROOT / "THIRD_PARTY.md").read_text(encoding="utf-8")
    listed = dict(re.findall(r"^\| (\S+) \| (.+) \|$", text, re.MULTILINE))
    for name in {**pinned(LOCKS[0]), **pinned(LOCKS[1])}:
        assert listed.get(name), f"{name}: run python -m nermo_bringup.environment.licences"


def test_set_up_needs_the_standard_library_only():
    files = [*(ROOT / "src/nermo_bringup/nermo_bringup/environment").glob("*.py")]
    files += [
        ROOT / "src/nermo_bringup/nermo_bringup/__init__.py",
        ROOT / "src/nermo_description/nermo_description/__init__.py",
    ]
    files += [ROOT / f"src/nermo_description/nermo_description/{name}.py" for name in ("opengl", "results")]
    for file in files:
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import | ast.ImportFrom):
                names = [name.name for name in node.names] if isinstance(node, ast.Import) else [node.module]
                for name in names:
                    ours = name.startswith("nermo_bringup.environment") or name.startswith("nermo_description.")
                    assert ours or name.split(".")[0] in sys.stdlib_module_names, f"{file} imports {name}"
