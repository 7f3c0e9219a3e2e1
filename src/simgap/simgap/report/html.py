"""Writes the report: one HTML file that needs nothing beside it, no network and no script."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined, select_autoescape

from simgap.data.errors import GapInputError
from simgap.report import figures, progress
from simgap.report.evidence import Evidence
from simgap.report.glossary import GLOSSARY
from simgap.report.runs import runs
from simgap.report.sentences import amount, meaning, number, percent, plain, sentences, title
from simgap.report.style import scales

Report = dict[str, Any]


def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("simgap", "report"),
        undefined=StrictUndefined,
        autoescape=select_autoescape(default=True, default_for_string=True),
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"number": number, "percent": percent, "plain": plain, "meaning": meaning, "amount": amount}
    return environment


def colours() -> str:
    """CSS that says what the names of colours are, on a light and on a dark screen."""
    template = _environment().get_template("colours.css.j2")
    return template.render(scales={"light": scales(dark=False), "dark": scales(dark=True)})


def page(report: Report, evidence: Evidence) -> str:
    """The whole page."""
    drawn = {
        "robot": figures.robot(report, evidence),
        "phases": figures.phase_map(report),
        "bands": figures.band_map(report),
        "ranking": figures.ranking(evidence),
        "runs": runs(report),
        "waterfall": progress.waterfall(report),
        "free": progress.free_curves(evidence),
        "alternatives": figures.alternatives(report),
        "channels": figures.channels(report),
        "curves": figures.curves(evidence),
        "isolability": figures.isolability(report),
        "confusion": figures.confusion(report),
    }
    return (
        _environment()
        .get_template("report.html.j2")
        .render(
            r=report,
            title=title(report),
            sentences=sentences(report),
            figure={name: f.svg() if f is not None else None for name, f in drawn.items()},
            colours=colours(),
            free=progress.free_table(report),
            glossary=GLOSSARY,
            shares=figures.subsystem_shares(report),
        )
    )


def write_page(report: Report, evidence: Evidence, path: Path) -> Path:
    """Write the page, whole or not at all; returns its path.

    Raises:
        GapInputError: it cannot be written.
    """
    partial = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        partial.write_text(page(report, evidence), encoding="utf-8")
        partial.replace(path)
    except OSError as error:
        raise GapInputError(f"{path} cannot be written: {error.strerror}") from error
    return path
