"""Make development cases, diagnose them, and count: ``python -m nermo_gap.benchmark.run --cases 24 --out cases.jsonl``.

Each case is a line of the output file; a run that was cut off goes on where it stopped. These cases are for developing
and calibrating; they are not the blind set.
"""

from __future__ import annotations

import json
import time
from collections import Counter
from pathlib import Path
from typing import Annotated, Any

import mujoco
import numpy as np
import typer
from numpy.typing import NDArray
from scipy.stats import binomtest

from nermo_gap.benchmark import robots
from nermo_gap.benchmark.faults import FAULTS, UNKNOWN, Fault
from nermo_gap.benchmark.truth import build, record
from nermo_gap.core.diagnose import Options, diagnose
from nermo_gap.core.mapping import parse_map
from nermo_gap.core.plant import build_plant
from nermo_gap.core.recording import recording_from_table

Array = NDArray[np.float64]

#: robot -> (joints with an actuator, all joints, bodies, actuators, position servos, outputs as (kind, name))
LAYOUT: dict[str, dict[str, Any]] = {
    "pendulum": {
        "joint": ["hinge"], "body": ["link"], "actuator": ["servo"], "servo": ["servo"], "play": [("hinge", "servo")],
        "read": [("joint", "hinge")], "sensor": ["angle"], "inputs": ["u"], "link": [],
    },
    "cart_pole": {
        "joint": ["slide", "swing"], "body": ["cart", "pole"], "actuator": ["push"], "servo": [], "play": [],
        "read": [("joint", "slide"), ("joint", "swing")], "sensor": ["slide", "swing"], "inputs": ["f"], "link": [],
    },
    "arm": {
        "joint": ["shoulder", "elbow"], "body": ["upper", "fore"], "actuator": ["shoulder_servo", "elbow_servo"],
        "servo": ["shoulder_servo", "elbow_servo"],
        "play": [("shoulder", "shoulder_servo"), ("elbow", "elbow_servo")],
        "read": [("joint", "shoulder"), ("joint", "elbow")], "sensor": ["shoulder_pos", "elbow_pos"],
        "inputs": ["u0", "u1"], "link": ["all"],
    },
}  # fmt: skip


def make_case(number: int, seed: int, seconds: float) -> dict[str, Any]:
    """Robot, fault, site and size of a case, drawn from its number and the seed alone."""
    rng = np.random.default_rng([seed, number])
    robot = list(LAYOUT)[int(rng.integers(len(LAYOUT)))]
    layout = LAYOUT[robot]
    draw = rng.random()
    kind = "none" if draw < 0.2 else "unknown" if draw < 0.35 else "single"
    case: dict[str, Any] = {"id": number, "robot": robot, "kind": kind, "seed": seed, "seconds": seconds}
    if kind == "none":
        return case
    pool = [f for f in (UNKNOWN if kind == "unknown" else FAULTS) if layout[f.kind]]
    fault = pool[int(rng.integers(len(pool)))]
    sites = layout[fault.kind]
    site = int(rng.integers(len(sites)))
    case |= {"fault": fault.name, "site": site, "size": int(rng.integers(1 if kind == "unknown" else 0, 3))}
    return case


def run_case(case: dict[str, Any], threads: int | None = None) -> dict[str, Any]:
    """Record the case's truth and diagnose it."""
    robot, layout = case["robot"], LAYOUT[case["robot"]]
    rng = np.random.default_rng([case["seed"], case["id"], 1])
    fault: Fault | None = next((f for f in (*FAULTS, *UNKNOWN) if f.name == case.get("fault")), None)
    site: Any = layout[fault.kind][case["site"]] if fault else None
    play = {site[0]: fault.sizes[case["size"]]} if fault and fault.kind == "play" else None
    truth = build(robots.MODELS[robot], rng, play)
    if fault and fault.kind == "play":
        case["truth_site"], case["truth_value"] = site[1], fault.sizes[case["size"]]
    elif fault:
        target = str(case["site"]) if fault.kind == "sensor" else site
        case["truth_value"], case["truth_site"] = fault.inject(truth, target, fault.sizes[case["size"]]), site
        mujoco.mj_setConst(truth.model, mujoco.MjData(truth.model))
    n = int(case["seconds"] / 0.005)
    commands = robots.commands(robot, int(rng.integers(1 << 30)), n, 0.005)
    plant = build_plant(mujoco.MjSpec.from_string(robots.MODELS[robot]), parse_map(robots.MAPS[robot]))
    told = np.zeros((n, truth.model.nu))
    for channel in plant.inputs:
        told[:, channel.actuator] = channel.scale * commands[channel.column]
    clock, rows = record(truth, told, layout["read"], 5e-4, rng)
    table = {"t": clock, **commands, **{c.column: rows[:, i] for i, c in enumerate(plant.outputs)}}
    started = time.monotonic()
    report = diagnose([recording_from_table(table, plant)], plant, Options(baselines=False, threads=threads)).report
    keys = [f"{e['name']}@{e['site']}" for e in report["effects"]]
    return case | {
        "verdict": report["verdict"],
        "found": keys,
        "values": [next(iter(e["parameters"].values())) for e in report["effects"]],
        "equivalent": report["equivalent"],
        "gap": {k: report["gap"][k] for k in ("before", "after", "shrink", "nuisances_only")},
        "structure": report["unexplained_predictable_share"],
        "ranking": [[r["hypothesis"], round(r["score"], 1), round(r["gap"], 2)] for r in report["ranking"][:4]],
        "reasons": report["reasons"],
        "wall_s": time.monotonic() - started,
    }


def score(results: list[dict[str, Any]]) -> dict[str, Any]:
    """Rates with their 90 % binomial intervals."""

    def rate(hits: list[bool]) -> dict[str, Any]:
        if not hits:
            return {"value": None, "ci90": None, "n": 0}
        interval = binomtest(sum(hits), len(hits)).proportion_ci(0.9)
        return {"value": sum(hits) / len(hits), "ci90": [float(interval.low), float(interval.high)], "n": len(hits)}

    single = [r for r in results if r["kind"] == "single"]
    for r in single:
        key = f"{r['fault']}@{r['truth_site']}"
        # The class: all that is reported as not told apart, aliases included.
        named = {n for group in r["equivalent"] for part in group for n in part.split(" + ")} | set(r["found"])
        r["top1"] = r["verdict"] in ("effect", "ambiguous") and r["found"][:1] == [key] and len(r["found"]) == 1
        r["class"] = r["verdict"] in ("effect", "ambiguous") and key in named
    none = [r for r in results if r["kind"] == "none"]
    unknown = [r for r in results if r["kind"] == "unknown"]
    visible = [r for r in single if r["gap"]["nuisances_only"] > 1.3]
    return {
        "top1": rate([r["top1"] for r in single]),
        "class": rate([r["class"] for r in single]),
        "top1_visible": rate([r["top1"] for r in visible]),
        "class_visible": rate([r["class"] for r in visible]),
        "false_alarms": rate([r["verdict"] not in ("no_gap",) for r in none]),
        "abstention_on_unknown": rate([r["verdict"] == "unknown" for r in unknown]),
        "verdicts": {
            k: dict(Counter(r["verdict"] for r in results if r["kind"] == k)) for k in ("none", "single", "unknown")
        },
    }


def main(
    out: Annotated[Path, typer.Option(help="A line of JSON for each case; existing ones are kept.")],
    cases: Annotated[int, typer.Option(help="How many.")] = 24,
    seed: Annotated[int, typer.Option(help="Of the cases.")] = 1,
    seconds: Annotated[float, typer.Option(help="Length of each recording.")] = 15.0,
    threads: Annotated[int, typer.Option(help="Of each diagnosis; 0 takes all.")] = 0,
    first: Annotated[int, typer.Option(help="Number of the first case.")] = 0,
) -> None:
    """Run the development benchmark."""
    done = {json.loads(line)["id"] for line in out.read_text().splitlines()} if out.exists() else set()
    for number in range(first, first + cases):
        if number in done:
            continue
        result = run_case(make_case(number, seed, seconds), threads or None)
        with out.open("a") as file:
            file.write(json.dumps(result) + "\n")
        truth = f"{result.get('fault', 'none')}@{result.get('truth_site', '')} size {result.get('size', '-')}"
        typer.echo(f"{number:3d} {result['robot']:10} {truth:36} -> {result['verdict']:9} {result['found']}")
    results = [json.loads(line) for line in out.read_text().splitlines()]
    typer.echo(json.dumps(score(results), indent=2))


if __name__ == "__main__":
    typer.run(main)
