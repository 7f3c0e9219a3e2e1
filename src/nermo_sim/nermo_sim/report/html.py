"""Writes the report: one HTML file that needs nothing beside it."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined, select_autoescape

from nermo_description.results import CommandError
from nermo_sim.experiments.runs import Settings
from nermo_sim.experiments.suite import CHAPTER
from nermo_sim.report.figures import FIGURES, svg

TABLES = {
    **{name: experiment.title for name, experiment in CHAPTER.items()},
    "theory_against_twin": "Theory against twin (N 7.2.1)",
    "ablation": "Each spine function off alone",
}
"""Tables shown in full, and their titles."""
HIDDEN = ("cycles", "series", "track_m", "path_m", "losses")
"""Columns that are drawn and not printed."""


def write_report(path: Path, facts: dict[str, Any], settings: Settings) -> Path:
    """Writes the report of `experiment all`, whole or not at all; returns its path.

    Raises CommandError where it cannot be written.
    """
    environment = Environment(
        loader=PackageLoader("nermo_sim", "report"), undefined=StrictUndefined, autoescape=select_autoescape()
    )
    environment.filters["cell"] = cell
    drawn = ((title, draw(facts)) for title, draw in FIGURES)
    text = environment.get_template("report.html.j2").render(
        settings=settings,
        summary=facts["summary"],
        score=facts["score"],
        comparison=facts["comparison"]["rows"],
        balance=facts["balance"],
        figures=[(title, svg(figure)) for title, figure in drawn if figure is not None],
        tables=[(title, _columns(facts[name]["rows"]), facts[name]["rows"]) for name, title in TABLES.items()],
    )
    partial = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        partial.write_text(text, encoding="utf-8")
        partial.replace(path)
    except OSError as error:
        raise CommandError(f"{path} cannot be written: {error.strerror}.") from error
    return path


def _columns(rows: list[dict[str, Any]]) -> list[str]:
    return [name for name in rows[0] if name not in HIDDEN] if rows else []


def cell(value: Any) -> str:
    """A value as a table shows it."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, list | tuple):
        return ", ".join(map(cell, value))
    return f"{value:.4g}" if isinstance(value, float) else str(value)
