"""The words `gap explain` and `gap predict` of the `nermo` command."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from nermo_gap.console import PROGRAM, refusals
from simgap.console import called, progress
from simgap.execution.executors import HELP as EXECUTOR
from simgap.execution.executors import PROCESSES


def explain_command(
    summary: Annotated[Path, typer.Argument(help="SUMMARY.yaml, or thesis_robot for the thesis's own.")],
    out: Annotated[Path, typer.Option(help="Folder for what has been run; a second call goes on there.")] = Path(
        "explanation"
    ),
    json_: Annotated[Path | None, typer.Option("--json", help="File for the explanations.")] = None,
    only: Annotated[list[str] | None, typer.Option(help="Look at this effect only, name@site (repeat).")] = None,
    effects: Annotated[int, typer.Option(min=1, max=5, help="Largest number of effects at once.")] = 2,
    workers: Annotated[int | None, typer.Option(min=1, help="Processes; by default one a processor.")] = None,
    executor: Annotated[str, typer.Option(help=EXECUTOR)] = PROCESSES,
) -> None:
    """Say which effects reproduce a table of published results: speeds, ratios, arc times, lifts.

    \b
    Example:
      nermo gap explain thesis_robot --out explanation --json explanation.json
    """
    with refusals():
        from nermo_gap.explain.report import explain_file, print_explanations
        from simgap.analysis.diagnose import write_report

        with progress("experiments") as say:
            report = explain_file(
                summary,
                out,
                only or [],
                effects,
                workers,
                lambda stage, done, total: say(stage, done / max(total, 1)),
                executor,
            )
    report["command"] = called(PROGRAM, "explain")
    if json_ is not None:
        write_report(report, json_)
    print_explanations(report)


def predict_command(
    diagnosis: Annotated[Path, typer.Argument(help="The diagnosis.json of a recording of the mouse.")],
    out: Annotated[Path, typer.Option(help="Folder for what has been run; a second call goes on there.")] = Path(
        "prediction"
    ),
    json_: Annotated[Path | None, typer.Option("--json", help="File for the predictions.")] = None,
    robot: Annotated[str | None, typer.Option(help="The robot that was diagnosed; by default what it says.")] = None,
    quick: Annotated[bool, typer.Option(help="The straight line only.")] = False,
) -> None:
    """Say how the experiments would go with what a diagnosis has found, in closed loop.

    \b
    Example:
      nermo gap predict diagnosis/diagnosis.json --quick
    """
    with refusals():
        from nermo_gap.explain.predict import predict, print_predictions
        from nermo_gap.robots.apply import deviations_of
        from simgap.analysis.diagnose import write_report
        from simgap.correction.apply import read_diagnosis

        report = read_diagnosis(diagnosis, corrected=False)
        base = robot or str(report.get("robot_file") or report["robot"])
        applied = deviations_of(report, base)
        with progress("experiments") as say:
            rows = predict(
                base, applied.deviations, out, quick, lambda done, total: say("experiments", done / max(total, 1))
            )
    if json_ is not None:
        write_report({"schema": "nermo_gap/prediction/1", "robot": base, "rows": rows}, json_)
    print_predictions(rows)
