"""What the feet of the twin feel, for a controller that listens: the estimate from tactile cells, or the truth."""

from __future__ import annotations

import math
import time
from typing import Any

import numpy as np

from nermo_control.types import LegLoads, MotionOutput, Phase
from nermo_sensors.bench.walk import LoadTrace
from nermo_sensors.estimation.estimator import LegLoadEstimator
from nermo_sensors.estimation.weight import felt_weight
from nermo_sensors.models.foot import TactileFeet
from nermo_sensors.parameters import TactileParameters
from nermo_sim.sensor_data import SensorData
from nermo_sim.twin import Twin


class TrueLoads:
    """MuJoCo's vertical contact forces."""

    def __init__(self, twin: Twin[Any]) -> None:
        self._twin = twin

    def step(self, sensors: SensorData, output: MotionOutput) -> LegLoads:
        """The loads after a tick."""
        a, b, c, d = self._twin.foot_forces()[0][:, 2].tolist()
        return LegLoads(sensors.stamp, (a, b, c, d))


class FeltLoads:
    """Tactile feet on a twin and the estimator behind them, stepped after each tick as the nodes would."""

    def __init__(
        self, twin: Twin[Any], feet: TactileParameters, estimator: str = "memory", seed: int = 0, weigh: bool = True
    ) -> None:
        """`weigh` ties the four loads to weight and IMU; `seed` is of the feet."""
        self._twin, self._weigh = twin, weigh
        self._feet = TactileFeet(feet, seed=seed)
        self.estimator = LegLoadEstimator(feet, estimator)
        self._rows: list[tuple[Any, ...]] = []
        self.times: list[int] = []
        """Processor time of each update [ns]."""

    def step(self, sensors: SensorData, output: MotionOutput) -> LegLoads | None:
        """Feels one tick; the estimate, once there is one."""
        legs = output.leg_states
        readings = self._feet.read(sensors.foot_forces, self._twin.period_ns * 1e-9)
        swing = [phase is Phase.SWING for phase in legs.phases]
        weight = None
        if self._weigh:
            weight = felt_weight(self._twin.robot.masses.total, sensors.orientation, sensors.linear_acceleration)
        frequency = 2.0 * math.pi * legs.gait_frequency or None
        begin = time.thread_time_ns()
        loads = self.estimator.step(sensors.stamp, readings, frequency, swing, weight)
        self.times.append(time.thread_time_ns() - begin)
        if loads is None:
            return None
        truth = self._twin.foot_forces()[0][:, 2]
        self._rows.append((sensors.stamp * 1e-9, truth, loads.load, loads.variance, loads.contact))
        return LegLoads(loads.stamp, tuple(loads.load.tolist()))

    def trace(self, start: float = 0.0) -> LoadTrace:
        """What was felt from `start` [s] on."""
        columns = [np.array(column) for column in zip(*self._rows, strict=True)]
        kept = columns[0] >= start
        return LoadTrace(*(column[kept] for column in columns))
