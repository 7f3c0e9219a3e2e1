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


def value(row: Row | None, name: str) -> Any:
    """A quantity of a row; None where there is no row."""
    return None if row is None else row[name]


def quotient(a: Row | None, b: Row | None, name: str, over: str = "") -> float | None:
    """A quantity in one row over the same, or another, in a second row; None where one is missing."""
    return None if a is None or b is None else float(a[name] / b[over or name])
