"""An explanation as plain data and as a table."""

from __future__ import annotations

import math
import platform
from collections.abc import Sequence
from dataclasses import asdict
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
from nermo_gap.explain.posterior import held_out, of_effects, probabilities
from nermo_gap.explain.search import Progress, explain
from nermo_gap.explain.sets import Explanation
from nermo_gap.explain.summary import Summary, load_summary
from nermo_gap.robots.checks import check
from simgap.data.errors import GapInputError, nearest
from simgap.execution.executors import PROCESSES

SCHEMA = "nermo_gap/explanation/1"
SHOWN = 12
OPEN, NEXT = 0.1, 4
"""An effect that acts with a probability farther than this from no and yes is open; so many of them are told."""
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
    sets = [before, *found]
    chance = probabilities(summary.cells, sets)
    acts = of_effects(sets, chance)
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
        "before": _plain(before, chance[0]),
        "explanations": [_plain(e, p) for e, p in zip(found, chance[1:], strict=True)],
        "effects": [{"effect": key, "probability": p} for key, p in acts.items()],
        "held_out": [asdict(row) for row in held_out(summary.cells, before, sets)],
        "measure_next": _measure_next(acts, found),
        "emulator": {
            "cells_predicted": sum(len(e.met) for e in emulated),
            "cells_right": right,
        },
        "blamed": [
            {"effect": b, "in_best": b in best, "rank_alone": _rank_alone(b, found), **_opinion(acts.get(b))}
            for b in summary.blamed
        ],
    }


def _opinion(probability: float | None) -> dict[str, Any]:
    """What the cells say of an effect that the author blames."""
    if probability is None:
        return {"probability": None, "verdict": "not looked at"}
    verdict = "likely" if probability >= 0.5 else "open" if probability > OPEN else "nothing speaks for it"
    return {"probability": probability, "verdict": verdict}


def _measure_next(acts: dict[str, float], found: Sequence[Explanation]) -> list[dict[str, Any]]:
    """What to look at on the robot: effects that may act or not, those first of which least is known."""
    open_ = [key for key, p in acts.items() if OPEN < p < 1.0 - OPEN]
    rows = []
    for key in sorted(open_, key=lambda k: abs(acts[k] - 0.5))[:NEXT]:
        part = next(p for one in found for p in one.parts if p.candidate.key == key)
        values = part.candidate.deviation(part.size).values
        where = part.candidate.where.split("_forward")[0].split("_back")[0]
        rows.append({"effect": key, "probability": acts[key], "check": check(part.candidate.effect, where, values)})
    return rows


def _plain(explanation: Explanation, probability: float) -> dict[str, Any]:
    return {
        "probability": float(probability),
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
    """The best explanations, the cells of the best one, and what may be believed."""
    console, cells = Console(markup=False), report["cells"]
    ranking = Table("effects", "cells met", "distance", "probability", title=f"{report['summary']} from its twin")
    for entry in [report["before"], *report["explanations"][:SHOWN]]:
        named = [f"{e['effect']} {e['size']:g} {e['unit']}" for e in entry["effects"]]
        ranking.add_row(
            " + ".join(named) or "the twin as it is",
            f"{entry['cells_met']} of {len(cells)}",
            f"{entry['distance']:.2f}",
            f"{entry['probability']:.2f}",
        )
    console.print(ranking)
    if report["explanations"]:
        console.print(_cells(report))
    console.print(_foretold(report))
    accuracy = report["emulator"]
    if accuracy["cells_predicted"]:
        console.print(
            f"the emulator had {accuracy['cells_right']} of {accuracy['cells_predicted']} cells right "
            "where it was checked by experiments"
        )
    for effect in report["effects"]:
        if effect["probability"] >= OPEN:
            console.print(f"acts with a probability of {effect['probability']:.2f}: {effect['effect']}")
    for blamed in report["blamed"]:
        rank = f" (rank {blamed['rank_alone']} alone)" if blamed["rank_alone"] else ""
        chance = "" if blamed["probability"] is None else f", {blamed['probability']:.2f}"
        console.print(f"blamed by the author: {blamed['effect']}: {blamed['verdict']}{chance}{rank}")
    for row in report["measure_next"]:
        console.print(f"look at next: {row['effect']} ({row['probability']:.2f}): {row['check']}")


def _cells(report: dict[str, Any]) -> Table:
    """The published table beside the twin and the best set."""
    best = report["explanations"][0]
    table = Table("cell", "published", "twin", "with the best", "met")
    for i, cell in enumerate(report["cells"]):
        wanted = f"{cell['low']:g} to {cell['high']:g}" if cell["passed"] is None else _word(cell["passed"])
        shown = [_shown(entry["values"][i], cell) for entry in (report["before"], best)]
        table.add_row(cell["name"], wanted, *shown, "yes" if best["met"][i] else "no")
    return table


def _foretold(report: dict[str, Any]) -> Table:
    """Each source foretold by the others."""
    table = Table(
        "left out", "cells", "met by the twin", "by the likeliest set", "expected", title="told by the others"
    )
    for row in report["held_out"]:
        numbers = (row["cells"], row["twin"], row["best"])
        table.add_row(row["source"], *map(str, numbers), f"{row['expected']:.1f}")
    return table


def _shown(value: float | None, cell: dict[str, Any]) -> str:
    if cell["passed"] is not None:
        return _word(bool(value))
    return "lost" if value is None else f"{value:.3f}"


def _word(passed: bool) -> str:
    return "passes" if passed else "fails"
