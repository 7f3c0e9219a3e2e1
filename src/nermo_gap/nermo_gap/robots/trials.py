"""Development trials: a changed twin walks, its recording is diagnosed, and the verdict stands beside the change.

    python -m nermo_gap.robots.trials --robot nermo_lite --seconds 60 --out trials.jsonl

The truth is the twin itself with one deviation, so these trials say what the diagnosis can see at best, and how
long it takes; they are no blind test.
"""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Annotated

import typer

from nermo_description.parameters import LEGS, Deviation, RobotParameters
from nermo_description.robots import load_robot
from nermo_gap.robots.diagnosis import diagnose_robot
from nermo_gap.robots.simulated import simulate
from simgap.analysis.options import Options


def trials(robot: RobotParameters) -> dict[str, tuple[str, tuple[Deviation, ...]]]:
    """By name: what a diagnosis should say, and how the twin deviates."""
    feet = tuple(f"{leg}_foot" for leg in LEGS)
    changes = {
        "gain": ("front_left_knee", Deviation.at("servo_gain", "front_left_knee", factor=0.7)),
        "friction": ("all_feet", Deviation.at("ground_friction", *feet, factor=0.5)),
        "slack": ("spine_left", Deviation.at("tendon_slack", "spine_left", slack=0.003)),
        "mass": ("torso", Deviation.at("mass", "torso", change=0.15 * robot.total_mass)),
    }
    named = {name: (f"{change.effect}@{site}", (change,)) for name, (site, change) in changes.items()}
    return {"none": ("no_gap", ()), **named}


def main(
    robot: Annotated[str, typer.Option(help="nermo, nermo_lite or a parameter file.")] = "nermo_lite",
    trial: Annotated[
        list[str] | None, typer.Option(help="none, gain, friction, slack or mass (repeat); by default all.")
    ] = None,
    seconds: Annotated[float, typer.Option(min=6.0, help="Length of the recording in s.")] = 60.0,
    only: Annotated[list[str] | None, typer.Option(help="Consider this effect only (repeat).")] = None,
    seed: Annotated[int, typer.Option(help="Of sensor noise and bootstrap.")] = 0,
    out: Annotated[Path | None, typer.Option(help="File to append one JSON line a trial to.")] = None,
) -> None:
    """Run trials and print verdict, effects, gap and time of each."""
    parameters = load_robot(robot)
    known = trials(parameters)
    for name in trial or known:
        if name not in known:
            raise typer.BadParameter(f"{name!r} must be one of {', '.join(known)}")
        expected, deviations = known[name]
        table = simulate(parameters.model_copy(update={"deviations": deviations}), seconds, seed=seed)
        cpu = time.process_time()
        report = diagnose_robot([table], parameters, Options(seed=seed, baselines=False, only=tuple(only or ()))).report
        row = {
            "robot": robot,
            "trial": name,
            "expected": expected,
            "verdict": report["verdict"],
            "reasons": report["reasons"],
            "effects": report["effects"],
            "equivalent": report["equivalent"],
            "gap": {k: report["gap"][k] for k in ("before", "after", "shrink", "ci90")},
            "recorded_s": seconds,
            "wall_s": report["wall_s"],
            "cpu_s": time.process_time() - cpu,
        }
        if out is not None:
            with out.open("a", encoding="utf-8") as file:
                file.write(json.dumps(row) + "\n")
        found = ", ".join(f"{e['name']}@{e['site']}" for e in report["effects"]) or "-"
        gap = row["gap"]
        typer.echo(
            f"{robot} {name}: expected {expected}; {report['verdict']} ({found}); gap {gap['before']:.2f} to "
            f"{gap['after']:.2f}; {row['wall_s']:.0f} s, {row['cpu_s']:.0f} s of processor"
        )


if __name__ == "__main__":
    typer.run(main)
