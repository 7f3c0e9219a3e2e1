"""Writes pages: figures and tables in one HTML file, and each figure as a picture beside it."""

from __future__ import annotations

import io
import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined, select_autoescape
from matplotlib.figure import Figure

from nermo_description.results import CommandError


def write_page(
    folder: Path,
    title: str,
    about: str,
    figures: Sequence[tuple[str, str, Figure | None]],
    tables: Sequence[tuple[str, list[dict[str, Any]]]],
) -> list[Path]:
    """Writes `report.html` and a PNG for each figure (name, heading, figure); returns their paths.

    Raises CommandError where they cannot be written.
    """
    drawn = [(name, heading, figure) for name, heading, figure in figures if figure is not None]
    page = write_html(
        folder / "report.html",
        "page.html.j2",
        title=title,
        about=about,
        figures=[(heading, svg(figure)) for _, heading, figure in drawn],
        tables=[(heading, list(dict.fromkeys(key for row in rows for key in row)), rows) for heading, rows in tables],
    )
    try:
        for name, _, figure in drawn:
            figure.savefig(folder / f"{name}.png", dpi=120)
    except OSError as error:
        raise CommandError(f"{folder} cannot be written: {error.strerror}.") from error
    return [page, *(folder / f"{name}.png" for name, _, _ in drawn)]


def write_html(path: Path, template: str, **values: Any) -> Path:
    """Writes a page from a template of this folder, whole or not at all; returns its path.

    Raises CommandError where it cannot be written.
    """
    environment = Environment(
        loader=PackageLoader("nermo_sim", "report"), undefined=StrictUndefined, autoescape=select_autoescape()
    )
    environment.filters["cell"] = cell
    text = environment.get_template(template).render(**values)
    partial = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        partial.write_text(text, encoding="utf-8")
        partial.replace(path)
    except OSError as error:
        raise CommandError(f"{path} cannot be written: {error.strerror}.") from error
    return path


def svg(figure: Figure) -> str:
    """A figure as an SVG element, without the XML head."""
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", metadata={"Date": None})
    text = buffer.getvalue()
    return text[text.index("<svg") :]


def cell(value: Any) -> str:
    """A value as a table shows it."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, list | tuple):
        return ", ".join(map(cell, value))
    return f"{value:.4g}" if isinstance(value, float) else str(value)
