"""An explanation as plain data and as a table."""

from __future__ import annotations

import math
import platform
from collections.abc import Sequence
from datetime import UTC, datetime
from importlib.resources import files
from pathlib import Path
from typing import Any

import mujoco
from rich.console import Console
from rich.table import Table

from nermo_description.robots import load_robot
from nermo_gap.explain.candidates import candidates
from nermo_gap.explain.evaluate import Evaluator
from nermo_gap.explain.search import Explanation, Progress, explain
from nermo_gap.explain.summary import Summary, load_summary
from simgap.data.errors import GapInputError, nearest
from simgap.execution.executors import PROCESSES

SCHEMA = "nermo_gap/explanation/1"
SHOWN = 12
_SHIPPED = Path(str(files("nermo_gap"))) / "summaries"


def explain_file(
    path: Path,
    folder: Path,
    only: Sequence[str],
    largest: int,
    workers: int | None,
    progress: Progress | None,
    place: str = PROCESSES,
) -> dict[str, Any]:
    """The whole explanation of a summary as plain data.

    Raises:
        ParameterError: the summary or its robot cannot be used.
        GapInputError: ``only`` names an effect that is not among the candidates, or the place cannot be used.
    """
    if not path.suffix and not path.exists():
        path = _SHIPPED / f"{path.name}.yaml"
    summary = load_summary(path)
    choices = candidates(load_robot(summary.robot))
    for name in only:
        if name not in {c.key for c in choices}:
            raise GapInputError(f"--only {name}: {nearest(name, [c.key for c in choices], 'effect')}")
    choices = [c for c in choices if not only or c.key in only]
    before, found = explain(summary, choices, Evaluator(summary.robot, folder, workers, place), largest, progress)
    return _report(summary, before, found)


def _report(summary: Summary, before: Explanation, found: Sequence[Explanation]) -> dict[str, Any]:
    best = {p.candidate.key for p in found[0].parts} if found else set()
    emulated = [e for e in found if e.predicted]
    right = sum(a == b for e in emulated for a, b in zip(e.predicted, e.met, strict=True))
    return {
        "schema": SCHEMA,
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "seed": 0,
        "robot": summary.robot,
        "versions": {"nermo_gap": "0.1.0", "mujoco": mujoco.__version__, "python": platform.python_version()},
        "summary": summary.name,
        "cells": [
            {"name": c.name, "source": c.source, "low": c.low, "high": c.high, "passed": c.passed}
            for c in summary.cells
        ],
        "before": _plain(before),
        "explanations": [_plain(e) for e in found],
        "emulator": {
            "cells_predicted": sum(len(e.met) for e in emulated),
            "cells_right": right,
        },
        "blamed": [{"effect": b, "in_best": b in best, "rank_alone": _rank_alone(b, found)} for b in summary.blamed],
    }


def _plain(explanation: Explanation) -> dict[str, Any]:
    return {
        "effects": [{"effect": p.candidate.key, "size": p.size, "unit": p.candidate.unit} for p in explanation.parts],
        "cells_met": sum(explanation.met),
        "met": list(explanation.met),
        "values": [v if math.isfinite(v) else None for v in explanation.values],
        "distance": explanation.distance,
    }


def _rank_alone(key: str, found: Sequence[Explanation]) -> int | None:
    """Rank among the single effects, from 1; None where it was not looked at."""
    alone = [e.key for e in found if len(e.parts) == 1]
    return alone.index(key) + 1 if key in alone else None


def print_explanations(report: dict[str, Any]) -> None:
    """The best explanations, and the cells of the best one."""
    console, cells = Console(markup=False), report["cells"]
    ranking = Table("effects", "cells met", "distance", title=f"{report['summary']} from its twin")
    for entry in [report["before"], *report["explanations"][:SHOWN]]:
        named = [f"{e['effect']} {e['size']:g} {e['unit']}" for e in entry["effects"]]
        ranking.add_row(
            " + ".join(named) or "the twin as it is",
            f"{entry['cells_met']} of {len(cells)}",
            f"{entry['distance']:.2f}",
        )
    console.print(ranking)
    if report["explanations"]:
        best = report["explanations"][0]
        table = Table("cell", "published", "twin", "with the best", "met")
        for i, cell in enumerate(cells):
            wanted = f"{cell['low']:g} to {cell['high']:g}" if cell["passed"] is None else _word(cell["passed"])
            shown = [_shown(entry["values"][i], cell) for entry in (report["before"], best)]
            table.add_row(cell["name"], wanted, *shown, "yes" if best["met"][i] else "no")
        console.print(table)
    accuracy = report["emulator"]
    if accuracy["cells_predicted"]:
        console.print(
            f"the emulator had {accuracy['cells_right']} of {accuracy['cells_predicted']} cells right "
            "where it was checked by experiments"
        )
    for blamed in report["blamed"]:
        rank = "not looked at" if blamed["rank_alone"] is None else f"rank {blamed['rank_alone']} alone"
        console.print(f"blamed by the author: {blamed['effect']}: {rank}{', in the best' if blamed['in_best'] else ''}")


def _shown(value: float | None, cell: dict[str, Any]) -> str:
    if cell["passed"] is not None:
        return _word(bool(value))
    return "lost" if value is None else f"{value:.3f}"


def _word(passed: bool) -> str:
    return "passes" if passed else "fails"
