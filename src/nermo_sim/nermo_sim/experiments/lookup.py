"""Rows of a table by what stands in them."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

Row = dict[str, Any]


def pick(rows: Iterable[Row], **wanted: Any) -> Row | None:
    """The first row in which all wanted values stand, or None."""
    return next(iter(pick_all(rows, **wanted)), None)


def pick_all(rows: Iterable[Row], **wanted: Any) -> list[Row]:
    """All rows in which all wanted values stand."""
    return [row for row in rows if all(row.get(name) == value for name, value in wanted.items())]
