"""The report of `experiment all`: one HTML file that needs nothing beside it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from nermo_sim.experiments.report_figures import FIGURES
from nermo_sim.experiments.runs import Settings
from nermo_sim.experiments.suite import CHAPTER
from nermo_sim.report.page import svg, write_html

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
    drawn = ((title, draw(facts)) for title, draw in FIGURES)
    return write_html(
        path,
        "report.html.j2",
        settings=settings,
        summary=facts["summary"],
        score=facts["score"],
        comparison=facts["comparison"]["rows"],
        balance=facts["balance"],
        figures=[(title, svg(figure)) for title, figure in drawn if figure is not None],
        tables=[(title, _columns(facts[name]["rows"]), facts[name]["rows"]) for name, title in TABLES.items()],
    )


def _columns(rows: list[dict[str, Any]]) -> list[str]:
    return [name for name in rows[0] if name not in HIDDEN] if rows else []
