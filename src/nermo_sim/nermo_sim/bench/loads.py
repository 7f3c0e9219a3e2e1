"""The leg-load estimator on the walking twin, in process: what `nermo bench loads` compares with the graph."""

from __future__ import annotations

from typing import Any

import numpy as np

from nermo_control.controller import Controller
from nermo_control.gait.knowledge_base import GaitParameters
from nermo_control.types import ControlCommand
from nermo_description.parameters import LEGS
from nermo_description.robots import load_robot
from nermo_sensors.bench.walk import judge_walk
from nermo_sensors.estimation.load_filter import ESTIMATORS
from nermo_sensors.parameters import tactile_of_robot
from nermo_sim.bench.loop import WALK
from nermo_sim.loads import FeltLoads
from nermo_sim.loop import Loop, constant
from nermo_sim.twin import Twin

SETTLE = 2.0
"""Walking before the judgement [s]."""


def walk_and_feel(
    robot: str,
    duration: float,
    estimator: str = "memory",
    seed: int = 0,
    weigh: bool = True,
    command: ControlCommand = WALK,
) -> FeltLoads:
    """The ideal trot for a time [s], or another `command`, felt; `seed` is of the feet."""
    parameters = load_robot(robot)
    twin = Twin(parameters)
    felt = FeltLoads(twin, tactile_of_robot(robot), estimator, seed, weigh)
    loop = Loop(twin, Controller(parameters, GaitParameters(), twin.period_ns), felt.step)
    loop.run(constant(command), duration, record=False)
    return felt


def bench_loads(robot: str = "nermo_lite", duration: float = 20.0, seed: int = 0) -> dict[str, Any]:
    """Every estimator on the same walk and the same feet, in process, without and with the sum tied to the weight."""
    threshold = tactile_of_robot(robot).contact_force
    rows, times, faults = [], {}, []
    for name in ESTIMATORS:
        for weigh in (False, True):
            felt = walk_and_feel(robot, SETTLE + duration, name, seed, weigh)
            judged = judge_walk(felt.trace(SETTLE), threshold)
            rows += [{"source": "in process", "estimator": name, "weigh": weigh, **row} for row in judged]
        times[name] = float(np.median(felt.times)) * 1e-3
        faults += [
            f"{name}: {LEGS[foot]}, {felt.estimator.cells[cell]} {fault.value}"
            for foot, cell, fault in felt.estimator.broken()
        ]
    return {"loads": rows, "loads_update_us": times, "loads_faults": faults, "contact_force_n": threshold}
