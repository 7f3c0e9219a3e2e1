"""Development cases, diagnosed in this process: ``python -m simgap.benchmark --cases 24 --out cases.jsonl``.

The cases are those of the blind check with seeds of their own, and nothing is sealed: they are for looking at. Rates
for the record come from ``simgap blind`` with a seed that nobody has developed on.
"""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import mujoco
import typer

from simgap.analysis.diagnose import diagnose
from simgap.analysis.options import Options
from simgap.blind.cases import SMALL, Case, draw, robot_of
from simgap.blind.recordings import realise
from simgap.blind.score import judged, metrics
from simgap.data.mapping import parse_map
from simgap.data.plant import build_plant
from simgap.data.recording import recording_from_table


def run_case(
    case: Case, robots: Sequence[str] = SMALL, threads: int | None = None, baselines: bool = False
) -> dict[str, Any]:
    """Record a case and diagnose it; returns its row of the score, with the ranking."""
    realise(case, robots)
    robot = robot_of(case.robot)
    plant = build_plant(mujoco.MjSpec.from_string(robot.xml), parse_map(robot.mapping))
    started, busy = time.monotonic(), time.process_time()
    recording = recording_from_table(case.columns, plant)
    found = diagnose([recording], plant, Options(baselines=baselines, threads=threads))
    report, selection = found.report, found.selection
    row = judged(case.answer(), report | {"status": "done", "wall_s": time.monotonic() - started})
    return row | {
        "values": [e["parameters"] for e in report["effects"]],
        "parameters": [f.parameters for f in case.faults],
        "nuisances_only": report["gap"]["nuisances_only"],
        "gains": [[e["gap_gain"], *e["ci90"]] for e in report["effects"]],
        "nuisances": {n: round(z, 2) for n, z in report["nuisances"].items() if abs(z) > 1.0},
        "typical": report["gap"]["typical"],
        "cpu_s": time.process_time() - busy,
        "structure": report["unexplained_predictable_share"],
        "reference": selection.reference.score,
        "ranking": [[r["hypothesis"], round(r["score"], 1), round(r["gap"], 2)] for r in report["ranking"][:5]],
    }


def main(
    out: Annotated[Path, typer.Option(help="A line of JSON for each case; existing ones are kept.")],
    cases: Annotated[int, typer.Option(help="How many.")] = 24,
    seed: Annotated[int, typer.Option(help="Of the cases.")] = 1,
    seconds: Annotated[float, typer.Option(help="Length of each recording.")] = 15.0,
    threads: Annotated[int, typer.Option(help="Of each diagnosis; 0 takes all.")] = 0,
    first: Annotated[int, typer.Option(help="Number of the first case to run.")] = 0,
    robots: Annotated[str, typer.Option(help="Comma-separated.")] = ",".join(SMALL),
    kind: Annotated[str, typer.Option(help="Only none, single, pair or unknown.")] = "",
) -> None:
    """Run the development benchmark."""
    done = {json.loads(line)["id"] for line in out.read_text().splitlines()} if out.exists() else set()
    for case in draw(first + cases, seed, tuple(robots.split(",")), seconds)[first:]:
        if case.id in done or kind not in ("", case.kind):
            continue
        row = run_case(case, robots.split(","), threads or None)
        with out.open("a") as file:
            file.write(json.dumps(row) + "\n")
        right = "right" if row["correct"] else "WRONG"
        truth = f"{' + '.join(row['truth']) or 'nothing'} {row['level'] or ''}"
        typer.echo(f"{right} {case.id} {case.robot:10} {truth:44} -> {row['verdict']:9} {row['found']}")
    typer.echo(json.dumps(metrics([json.loads(line) for line in out.read_text().splitlines()]), indent=2))


if __name__ == "__main__":
    typer.run(main)
