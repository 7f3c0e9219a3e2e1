"""The core knows no robot: it imports nothing of this workspace but itself."""

import ast
from pathlib import Path

import nermo_gap.core


def test_the_core_imports_no_other_package_of_the_workspace() -> None:
    for file in Path(nermo_gap.core.__file__).parent.rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom) and node.module:
                names = [node.module]
            for name in names:
                ours = name.split(".")[0].startswith("nermo_")
                assert not ours or name.startswith("nermo_gap.core"), f"{file} imports {name}"
