"""Every ending that a recording's file may have. Nothing of a reader is imported before a file is read."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, cast

TABLES = {
    ".csv": "simgap.data.tables:read_csv",
    ".npz": "simgap.data.tables:read_npz",
    ".parquet": "simgap.data.tables:read_parquet",
}
"""Ending of a table: `module:function` that reads it into columns."""
BAGS = (".mcap", ".db3", ".bag", ".zstd", ".zst")
"""Endings of bags; `rosbags` knows what is in them."""


def reader_of(ending: str) -> Callable[[Path], dict[str, Any]]:
    """The function that reads tables of a known ending."""
    module, _, name = TABLES[ending].partition(":")
    return cast("Callable[[Path], dict[str, Any]]", getattr(importlib.import_module(module), name))


def listed(endings: Iterable[str]) -> str:
    """Endings as a sentence names them."""
    return ", ".join(endings)
