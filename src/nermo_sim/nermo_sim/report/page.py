"""Writes the page of one experiment: figures and tables in one HTML file, and each figure as a picture beside it."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined, select_autoescape
from matplotlib.figure import Figure

from nermo_description.results import CommandError
from nermo_sim.report.figures import svg
from nermo_sim.report.html import cell


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
    environment = Environment(
        loader=PackageLoader("nermo_sim", "report"), undefined=StrictUndefined, autoescape=select_autoescape()
    )
    environment.filters["cell"] = cell
    drawn = [(name, heading, figure) for name, heading, figure in figures if figure is not None]
    text = environment.get_template("page.html.j2").render(
        title=title,
        about=about,
        figures=[(heading, svg(figure)) for _, heading, figure in drawn],
        tables=[(heading, list(dict.fromkeys(key for row in rows for key in row)), rows) for heading, rows in tables],
    )
    page = folder / "report.html"
    partial = folder / f".report.html.{os.getpid()}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, _, figure in drawn:
            figure.savefig(folder / f"{name}.png", dpi=120)
        partial.write_text(text, encoding="utf-8")
        partial.replace(page)
    except OSError as error:
        raise CommandError(f"{page} cannot be written: {error.strerror}.") from error
    return [page, *(folder / f"{name}.png" for name, _, _ in drawn)]
