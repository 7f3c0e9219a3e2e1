"""The live gap: a twin that gets the same servo commands as the robot, and how far the two are apart just now."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from nermo_description.parameters import LEGS, RobotParameters
from nermo_gap.robots.channels import GYRO, RESOLUTION, encoder, leg_servos, position
from nermo_sim.divergence import SimulationDivergedError
from nermo_sim.twin import Twin

Array = NDArray[np.float64]

SPAN = 2.0
"""[s] over which the gap is taken: more than a stride."""
MISSING = 0.5
"""[s] without commands after which the twin starts anew with the next one, standing."""
TURNING = 0.05
"""[rad/s] by which the mean turning rates of two equal mice differ; single samples depend on every footfall."""
FARTHEST = 1e6
"""[rad], [rad/s] A difference counts as no more than this, so that its square stays a number whatever was said."""
FAR = 3.0
"""A gap beyond this many resolutions is worth a warning."""


class LiveGap:
    """Compares a robot with its twin by the stamps of their ticks.

    A twin that runs on its own drifts in place and heading, so only what follows the commands is compared: servos and
    knees sample by sample, turning on the average. The gap of a channel is the root mean square of the difference over
    SPAN seconds in units of what its sensor resolves; 1 is as good as can be told. That of turning is the difference
    of the mean rates in units of TURNING.
    """

    def __init__(self, robot: RobotParameters, period_ns: int = 5_000_000) -> None:
        self._robot, self._twin = robot, Twin(robot, period_ns=period_ns)
        self._servos = list(robot.servos)
        self._channels = [position(s) for s in leg_servos(robot)] + [encoder(leg) for leg in LEGS] + list(GYRO)
        self._length = max(round(SPAN * 1e9 / period_ns), 1)
        self._expected: dict[int, dict[str, float]] = {}
        self._order: deque[int] = deque()
        self._ahead: deque[tuple[int, Mapping[str, float]]] = deque(maxlen=4 * self._length)
        self._differences: dict[str, deque[float]] = {c: deque(maxlen=self._length) for c in self._channels}
        self._last: int | None = None
        self.restarts = 0

    def command(self, stamp: int, positions: Mapping[str, float]) -> None:
        """The robot was told servo positions [rad] at a tick [ns]; the twin is told the same.

        A command that names another servo, lacks one, is not finite, or is no newer than the last, is ignored.
        """
        if set(positions) != set(self._servos) or not all(map(math.isfinite, positions.values())):
            return
        period = self._twin.period_ns
        if self._last is not None and stamp <= self._last:
            if self._last - stamp > MISSING * 1e9:
                self._last = None
            return
        if self._last is None or stamp - self._last > MISSING * 1e9:
            self._restart()
            self._last = stamp - period
        told = [positions[s] for s in self._servos]
        try:
            # Commands may come slower than the twin ticks: it holds the last one, as the servos do.
            while self._last + period <= stamp:
                self._last += period
                self._expect(self._last + period, told)
        except SimulationDivergedError:
            self._last = None

    def measured(self, stamp: int, values: Mapping[str, float]) -> None:
        """What the robot measured at a tick [ns], by the channels' columns; others and NaN are ignored.

        It may come before the command of the tick that led to it.
        """
        if self._last is not None and stamp > self._last + self._twin.period_ns:
            self._ahead.append((stamp, values))
            return
        near = min(self._order, key=lambda s: abs(s - stamp), default=None) if stamp not in self._expected else stamp
        if near is None or abs(near - stamp) > self._twin.period_ns // 2:
            return
        expected = self._expected[near]
        for name, value in values.items():
            if name in self._differences and math.isfinite(value):
                self._differences[name].append(max(-FARTHEST, min(value - expected[name], FARTHEST)))

    def gap(self) -> dict[str, float]:
        """Root mean square gap by subsystem, of those of which something was measured."""
        by_subsystem: dict[str, list[float]] = {}
        for name, differences in self._differences.items():
            if differences:
                by_subsystem.setdefault(_subsystem(name), []).append(_square(name, np.array(differences)))
        return {name: math.sqrt(sum(values) / len(values)) for name, values in by_subsystem.items()}

    @property
    def joints(self) -> dict[str, float]:
        """Joint angles [rad] of the twin after the last command; empty before the first."""
        if self._last is None:
            return {}
        return dict(zip(self._twin.layout.joints, self._twin.joint_states()[0], strict=True))

    def _restart(self) -> None:
        self._twin.reset()
        self._expected.clear()
        self._order.clear()
        for differences in self._differences.values():
            differences.clear()
        self._ahead.clear()
        self.restarts += 1

    def _expect(self, stamp: int, told: list[float]) -> None:
        sensors = self._twin.step(told)
        names = [position(s) for s in self._servos] + [encoder(leg) for leg in LEGS] + list(GYRO)
        values = [*sensors.servo_positions, *sensors.knee_encoders, *sensors.angular_velocity]
        self._expected[stamp] = dict(zip(names, values, strict=True))
        self._order.append(stamp)
        while len(self._order) > self._length:
            del self._expected[self._order.popleft()]
        while self._ahead and self._ahead[0][0] <= stamp:
            self.measured(*self._ahead.popleft())


def _square(column: str, differences: Array) -> float:
    """Squared gap of a channel."""
    if column in GYRO:
        return float(differences.mean() / TURNING) ** 2
    resolution = RESOLUTION["encoder" if column.endswith("encoder") else "position"]
    return float(np.mean((differences / resolution) ** 2))


def _subsystem(column: str) -> str:
    leg = next((leg for leg in LEGS if column.startswith(leg)), None)
    if column in GYRO:
        return "body"
    return "spine" if leg is None else f"{leg} leg"
