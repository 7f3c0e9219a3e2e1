"""Writes THIRD_PARTY.md: every package of the two locks with the licence that its own metadata names.

.venv/bin/python -m nermo_bringup.environment.licences
"""

from __future__ import annotations

import importlib.metadata
import sys
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from nermo_bringup.environment.checkout import checkout_root
from nermo_bringup.environment.python_packages import LOCKS, normal_name, pinned_packages

_HEAD = """# Licences of what Nermo depends on

Nermo itself is under the Apache License 2.0 (LICENSE). It installs the packages below and contains none of them;
`vendor/tf2_msgs` restates the interface of ROS 2's package of that name (BSD-3-Clause).
Written by `python -m nermo_bringup.environment.licences` from the metadata of the packages in requirements.lock
and requirements-test.lock.

| package | licence |
|---|---|
"""
_LONGEST = 100


def licence(name: str) -> str:
    """The licence of an installed distribution, as it names it itself.

    Raises:
        LookupError: It is not installed or names none.
    """
    manifest = Path(sys.prefix) / "share" / name.removeprefix("ros-").replace("-", "_") / "package.xml"
    if name.startswith("ros-") and manifest.is_file():
        found = [element.text or "" for element in ElementTree.parse(manifest).findall("license")]
        return " AND ".join(filter(None, found))
    metadata: Any = importlib.metadata.metadata(name)
    classifiers = [
        value.split("::")[-1].strip() for value in metadata.get_all("Classifier") or [] if value.startswith("License")
    ]
    named = (metadata.get("License-Expression") or metadata.get("License") or "").strip()
    if named and "\n" not in named and len(named) <= _LONGEST:
        return named
    if classifiers:
        return ", ".join(classifiers)
    texts = [file for file in importlib.metadata.files(name) or [] if "LICENSE" in file.name.upper()]
    for file in texts:
        title = next((line.strip() for line in file.read_text().splitlines() if line.strip()), "")
        if title.startswith("Permission is hereby granted, free of charge"):
            return "MIT"
        if title:
            return title[:_LONGEST]
    raise LookupError(f"{name} names no licence")


def main() -> None:
    """Writes the table."""
    root = checkout_root()
    rows = []
    for name in sorted({normal_name(name) for lock in LOCKS for name, _ in pinned_packages(root / lock)}):
        try:
            rows.append(f"| {name} | {licence(name)} |\n")
        except LookupError as error:
            print(f"nermo: {error}", file=sys.stderr)
            sys.exit(1)
    (root / "THIRD_PARTY.md").write_text(_HEAD + "".join(rows), encoding="utf-8")


if __name__ == "__main__":
    main()
