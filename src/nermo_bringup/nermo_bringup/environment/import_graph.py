"""Which module imports which, read from the code; and the picture of the packages in docs/architecture.md.

python -m nermo_bringup.environment.import_graph     # draws the picture anew
"""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterator
from pathlib import Path

from nermo_bringup.environment.checkout import checkout_root

PAGE = Path("docs") / "architecture.md"
_PICTURE = re.compile(r"```mermaid\n.*?```\n", re.DOTALL)


def modules(root: Path) -> dict[str, Path]:
    """Every module of every package in `src/`, and its file."""
    found = {}
    for manifest in sorted(root.glob("src/*/package.xml")):
        package = manifest.parent / manifest.parent.name
        for file in sorted(package.rglob("*.py")):
            parts = file.relative_to(manifest.parent).with_suffix("").parts
            found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = file
    return found


def imported(file: Path, known: dict[str, Path]) -> Iterator[tuple[str, bool]]:
    """What of the known modules a file imports, and whether it does so at once, and not first in a function."""
    tree = ast.parse(file.read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        names: list[str] = []
        if isinstance(node, ast.Import):
            names = [name.name for name in node.names]
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module is not None:
            whole = [f"{node.module}.{name.name}" for name in node.names]
            names = [name if name in known else node.module for name in whole]
        yield from ((name, node in tree.body) for name in names if name in known)


def packages(root: Path) -> dict[str, set[str]]:
    """Which of our packages each one imports, anywhere in its code."""
    known = modules(root)
    graph: dict[str, set[str]] = {name.split(".")[0]: set() for name in known}
    for name, file in known.items():
        package = name.split(".")[0]
        graph[package] |= {other.split(".")[0] for other, _ in imported(file, known)} - {package}
    return graph


def allowed(text: str) -> dict[str, set[str]]:
    """What each package may import, from the page's table, whose rows stand in order: nobody imports from below."""
    rows = re.findall(r"^\| `(\w+)` \| [^|]* \| ([^|]*) \|$", text, re.MULTILINE)
    may: dict[str, set[str]] = {}
    for name, others in rows:
        may[name] = set(may) if others == "all" else set(re.findall(r"`(\w+)`", others))
    return may


def picture(graph: dict[str, set[str]]) -> str:
    """The packages as a mermaid flow chart; an arrow that follows from two others is left out."""
    lines = ["```mermaid", "flowchart BT"]
    for name in sorted(graph):
        above = {other for middle in graph[name] for other in _all_below(graph, middle)}
        lines += [f"  {name} --> {other}" for other in sorted(graph[name] - above)]
    return "\n".join([*lines, "```"]) + "\n"


def _all_below(graph: dict[str, set[str]], name: str) -> set[str]:
    """All that a package imports, and what that imports."""
    found: set[str] = set()
    waiting = [name]
    while waiting:
        for other in graph[waiting.pop()] - found:
            found.add(other)
            waiting.append(other)
    return found


def redrawn(text: str, graph: dict[str, set[str]]) -> str:
    """The page with the picture of this graph."""
    return _PICTURE.sub(lambda _: picture(graph), text, count=1)


def main() -> int:
    """Draws the picture anew."""
    root = checkout_root()
    page = root / PAGE
    page.write_text(redrawn(page.read_text(encoding="utf-8"), packages(root)), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
