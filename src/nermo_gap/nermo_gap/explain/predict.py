"""The experiments of the theses in closed loop, with and without what a diagnosis has found."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from nermo_description.parameters import Deviation
from nermo_gap.explain.evaluate import Evaluator, Progress
from nermo_gap.explain.summary import QUANTITY, Run

QUICK = (
    Run(experiment="straight_line", gait="trot"),
    Run(experiment="straight_line", gait="trot", spine=True),
    Run(experiment="straight_line", gait="lateral_walk"),
)
MORE = (
    *(Run(experiment="turning", strategy=s) for s in ("leg", "spine", "mix")),
    *(Run(experiment="balance", leg=leg, compensation=c) for leg in ("rear_left", "front_left") for c in (False, True)),
)


def predict(
    robot: str, deviations: tuple[Deviation, ...], folder: Path, quick: bool, progress: Progress | None = None
) -> list[dict[str, Any]]:
    """One row an experiment: what the twin gives as described (``nominal``) and as diagnosed (``diagnosed``).

    Speeds in m/s, times in s (None: the arc is lost), lifts 1 or 0 for passed and failed. What has been run lies in
    the folder and is not run again.
    """
    runs = list(QUICK if quick else (*QUICK, *MORE))
    nominal, changed = Evaluator(robot, folder)([(), deviations], runs, progress)
    return [
        {
            "experiment": run.key,
            "quantity": QUANTITY[run.experiment],
            "nominal": _finite(nominal[run.key]),
            "diagnosed": _finite(changed[run.key]),
        }
        for run in runs
    ]


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def print_predictions(rows: list[dict[str, Any]]) -> None:
    """The rows as a table."""
    table = Table("experiment", "quantity", "twin", "twin as diagnosed", "change")
    for row in rows:
        one, two = row["nominal"], row["diagnosed"]
        both = one is not None and two is not None and row["quantity"] != "passed" and one > 0.0
        shown = ["lost" if v is None else f"{v:.3f}" for v in (one, two)]
        table.add_row(row["experiment"], row["quantity"], *shown, f"{100.0 * (two / one - 1.0):+.0f} %" if both else "")
    Console(markup=False).print(table)
