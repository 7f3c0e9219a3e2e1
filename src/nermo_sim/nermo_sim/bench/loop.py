"""Measurements of the control tick and of the in-process loop. Every ratio is taken within one run, side by side.

Times are processor times of the measuring thread: on an idle machine they are the wall's, and on a busy one the time
that other programs take is not counted. Only the batch, which is about all processors, goes by the wall clock.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import Any, get_args

import mujoco
import numpy as np

from nermo_control.controller import Controller
from nermo_control.gait.knowledge_base import GaitParameters
from nermo_control.types import ControlCommand, TrajectoryMode
from nermo_description.parameters import TailModel
from nermo_description.robots import load_robot
from nermo_sim.loop import Loop, constant
from nermo_sim.twin import Twin
from simgap.execution.batch import run_batch
from simgap.execution.executors import processors

WALK = ControlCommand(0, forward_velocity=0.096, trajectory_mode=TrajectoryMode.STRAIGHT_LINE)
"""The ideal trot at 0.8 Hz, held on a line: what most runs do."""
ROUND = 0.25
"""Simulated time of one turn of the closed loop or of the bare one [s]."""
SETTLE = 1.0
"""Time before the measurement [s]."""


@dataclass(frozen=True, slots=True)
class BenchSettings:
    """What is measured, and for how long."""

    robot: str = "nermo_lite"
    duration: float = 20.0
    """Simulated time of a measurement [s]."""
    tail: TailModel = "chain"

    def loop(self) -> Loop[Any]:
        """A loop that walks already."""
        loop = Loop.build(load_robot(self.robot).with_tail(self.tail), GaitParameters())
        loop.run(constant(WALK), SETTLE, record=False)
        return loop


def bench_tick(settings: BenchSettings) -> dict[str, Any]:
    """Time of one control tick of all the controller's modules, while the twin walks."""
    loop = settings.loop()
    times: list[int] = []
    stopwatch = _Stopwatch(loop.controller, times)
    script = constant(WALK)
    for _ in range(round(settings.duration * 1e9 / loop.twin.period_ns)):
        loop.controller = stopwatch
        loop.tick(script(loop.sensors.stamp))
    p50, p99 = np.percentile(np.array(times) * 1e-3, [50.0, 99.0])
    return {"tick_us": {"p50": float(p50), "p99": float(p99), "ticks": len(times)}}


class _Stopwatch:
    """A controller that notes how long each step takes [ns]."""

    def __init__(self, controller: Controller, times: list[int]) -> None:
        self._controller, self._times = controller, times

    def step(self, *arguments: Any) -> Any:
        begin = time.thread_time_ns()
        output = self._controller.step(*arguments)
        self._times.append(time.thread_time_ns() - begin)
        return output


def bench_loop(settings: BenchSettings) -> dict[str, Any]:
    """The closed loop against `mj_step` alone, with the tail as the settings say and under `tails` with either."""
    tails = {tail: _closed_and_bare(replace(settings, tail=tail)) for tail in get_args(TailModel)}
    return {**tails[settings.tail], "tails": tails, "batch": _bench_batch(settings)}


def _closed_and_bare(settings: BenchSettings) -> dict[str, float]:
    """The same model from the same states under the same commands.

    The two take turns every quarter of a simulated second, and the median of each counts: so what else the machine
    does meanwhile to caches and clock rate disturbs both alike, and little.
    """
    loop = settings.loop()
    twin = loop.twin
    ticks = round(ROUND * 1e9 / twin.period_ns)
    script = constant(WALK)
    data = mujoco.MjData(twin.model)
    controls = np.zeros((ticks, twin.model.nu))
    closed: list[int] = []
    bare: list[int] = []
    for _ in range(max(1, round(settings.duration / ROUND))):
        mujoco.mj_copyData(data, twin.model, twin.data)
        begin = time.thread_time_ns()
        for row in range(ticks):
            loop.tick(script(loop.sensors.stamp))
            controls[row] = twin.data.ctrl
        closed.append(time.thread_time_ns() - begin)
        bare.append(_bare(twin, data, controls))
    closed_ns, bare_ns = float(np.median(closed)) / ticks, float(np.median(bare)) / ticks
    return {
        "closed_loop_x_real_time": twin.period_ns / closed_ns,
        "bare_step_x_real_time": twin.period_ns / bare_ns,
        "fraction": bare_ns / closed_ns,
        "closed_loop_us_per_tick": closed_ns * 1e-3,
        "bare_step_us_per_tick": bare_ns * 1e-3,
    }


def _bare(twin: Twin[Any], data: mujoco.MjData, controls: np.ndarray) -> int:
    """Time [ns] of the same ticks with nothing but the physics."""
    substeps = round(twin.period_ns * 1e-9 / twin.model.opt.timestep)
    control = data.ctrl
    begin = time.thread_time_ns()
    for row in controls:
        control[:] = row
        mujoco.mj_step(twin.model, data, substeps)
    return time.thread_time_ns() - begin


def _bench_batch(settings: BenchSettings) -> dict[str, Any]:
    workers = processors()
    jobs = [(settings, number) for number in range(2 * workers)]
    spans = [span for _, span in run_batch(_walk, jobs, workers)]
    wall = max(end for _, end in spans) - min(begin for begin, _ in spans)
    return {"workers": workers, "x_real_time": len(jobs) * settings.duration / wall}


def _walk(job: tuple[BenchSettings, int]) -> tuple[float, float]:
    """Walks in a worker; returns when it began and ended on the clock that all processes share [s]."""
    settings, _ = job
    loop = settings.loop()
    begin = time.monotonic()
    loop.run(constant(WALK), settings.duration, record=False)
    return begin, time.monotonic()
