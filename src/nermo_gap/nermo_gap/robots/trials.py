"""Development trials: a changed twin walks, its recording is diagnosed, and the verdict stands beside the change.

    python -m nermo_gap.robots.trials --robot nermo_lite --seconds 60 --out trials.jsonl

The truth is the twin itself with one number changed, so these trials say what the diagnosis can see at best, and how
long it takes; they are no blind test.
"""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Annotated

import mujoco
import typer

from nermo_description.robots import load_robot
from nermo_gap.robots.diagnosis import diagnose_robot
from nermo_gap.robots.simulated import Change, simulate
from simgap.analysis.options import Options


def _gain(model: mujoco.MjModel) -> None:
    knee = model.actuator("front_left_knee").id
    model.actuator_gainprm[knee, 0] *= 0.7
    model.actuator_biasprm[knee, 1] *= 0.7


def _friction(model: mujoco.MjModel) -> None:
    model.geom_friction[:, 0] *= 0.5


def _slack(model: mujoco.MjModel) -> None:
    model.tendon_range[model.tendon("spine_left").id, 1] += 0.003


def _mass(model: mujoco.MjModel) -> None:
    torso = model.body("torso").id
    factor = 1.0 + 0.15 * float(model.body_mass.sum()) / float(model.body_mass[torso])
    model.body_mass[torso] *= factor
    model.body_inertia[torso] *= factor


TRIALS: dict[str, tuple[Change | None, str]] = {
    "none": (None, "no_gap"),
    "gain": (_gain, "servo_gain@front_left_knee"),
    "friction": (_friction, "ground_friction@all_feet"),
    "slack": (_slack, "tendon_slack@spine_left"),
    "mass": (_mass, "mass@torso"),
}
"""Change of the twin, and what a diagnosis should say of it."""


def main(
    robot: Annotated[str, typer.Option(help="nermo, nermo_lite or a parameter file.")] = "nermo_lite",
    trial: Annotated[list[str] | None, typer.Option(help=f"Of {', '.join(TRIALS)} (repeat); by default all.")] = None,
    seconds: Annotated[float, typer.Option(min=6.0, help="Length of the recording in s.")] = 60.0,
    only: Annotated[list[str] | None, typer.Option(help="Consider this effect only (repeat).")] = None,
    seed: Annotated[int, typer.Option(help="Of sensor noise and bootstrap.")] = 0,
    out: Annotated[Path | None, typer.Option(help="File to append one JSON line a trial to.")] = None,
) -> None:
    """Run trials and print verdict, effects, gap and time of each."""
    parameters = load_robot(robot)
    for name in trial or list(TRIALS):
        if name not in TRIALS:
            raise typer.BadParameter(f"{name!r} must be one of {', '.join(TRIALS)}")
        change, expected = TRIALS[name]
        table = simulate(parameters, seconds, change=change, seed=seed)
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
