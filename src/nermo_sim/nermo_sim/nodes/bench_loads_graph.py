"""The leg-load estimator as a node on the walking twin: its loads beside MuJoCo's contact forces, and its cost."""

from __future__ import annotations

import contextlib
import time
from typing import Any

import numpy as np

from nermo_description.results import CommandError
from nermo_interfaces.msg import FootForces, LegLoads
from nermo_node.time import to_nanoseconds
from nermo_sensors.bench.walk import LoadTrace, judge_walk
from nermo_sensors.parameters import tactile_of_robot
from nermo_sim.nodes.bench_graph import NODES, Probe, cpu_meters, started

ESTIMATOR = {"leg_load_estimator": "nermo_sensors.nodes.leg_load_estimator"}


def bench_loads_graph(robot: str = "nermo_lite", duration: float = 20.0) -> dict[str, Any]:
    """Walks the graph for a time [s] and judges `leg_loads` against `truth/foot_forces`, joined by their stamps.

    `answer_ms` is the time from the arrival of a tick's truth to that of its loads, as another process hears them.

    Raises CommandError where the graph does not come up or the estimator says nothing.
    """
    listener = _Listener()
    with started(robot, {**NODES, **ESTIMATOR}) as processes, contextlib.closing(Probe()) as probe:
        probe.hear(FootForces, "truth/foot_forces", listener.on_truth)
        probe.hear(LegLoads, "leg_loads", listener.on_loads)
        probe.walk(processes)
        meters = cpu_meters({name: processes[name] for name in ESTIMATOR})
        listener.clear()
        begin = time.monotonic()
        probe.spin(duration)
        wall = time.monotonic() - begin
        cpu = {name: meter.cpu_percent() for name, meter in meters.items()}
    if len(listener.loads) < 2:
        raise CommandError("leg_load_estimator published no leg_loads: nothing to judge")
    answers = listener.answers()
    p50, p99 = np.percentile(answers, [50.0, 99.0])
    rows = judge_walk(listener.trace(), tactile_of_robot(robot).contact_force)
    return {
        "loads": [{"source": "graph", "estimator": "memory", "weigh": True, **row} for row in rows],
        "loads_node": {
            "rate_hz": len(listener.loads) / wall,
            "cpu_percent": cpu["leg_load_estimator"],
            "answer_ms_p50": float(p50),
            "answer_ms_p99": float(p99),
            "answer_ms_max": float(answers.max()),
            "unanswered": len(listener.truth) - len(answers),
            "duration_s": wall,
        },
    }


class _Listener:
    """Keeps what is heard, by stamp."""

    def __init__(self) -> None:
        self.clear()

    def clear(self) -> None:
        self.truth: dict[int, tuple[int, list[float]]] = {}
        self.loads: dict[int, tuple[int, Any, Any, Any]] = {}

    def on_truth(self, message: FootForces) -> None:
        forces = [force.z for force in message.force]
        self.truth[to_nanoseconds(message.header.stamp)] = time.monotonic_ns(), forces

    def on_loads(self, message: LegLoads) -> None:
        stamp = to_nanoseconds(message.header.stamp)
        self.loads[stamp] = time.monotonic_ns(), list(message.load), list(message.variance), list(message.contact)

    def answers(self) -> np.ndarray:
        """[ms]"""
        return np.array([(self.loads[stamp][0] - self.truth[stamp][0]) * 1e-6 for stamp in self._stamps()])

    def trace(self) -> LoadTrace:
        stamps = self._stamps()
        _, load, variance, contact = (
            np.array(column) for column in zip(*(self.loads[stamp] for stamp in stamps), strict=True)
        )
        truth = np.array([self.truth[stamp][1] for stamp in stamps])
        return LoadTrace(np.array(stamps) * 1e-9, truth, load, variance, contact)

    def _stamps(self) -> list[int]:
        return sorted(set(self.truth) & set(self.loads))
