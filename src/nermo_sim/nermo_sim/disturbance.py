"""What differs between two runs of the same experiment: pushes, the first pose, the ground. Drawn from a seed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from nermo_sim.twin import Twin


@dataclass(frozen=True, slots=True)
class Disturbance:
    """How far runs differ; standard deviations unless said otherwise."""

    friction: float = 0.1
    """Of the sliding friction of all geoms together, relative."""
    heading: float = 0.01
    """Of the first heading [rad]."""
    joint: float = 0.005
    """Of each joint's first angle [rad]."""
    push: float = 0.05
    """Of each component of the horizontal pushes on the torso [N]; a mouse weighs about 2.8 N."""
    push_interval: float = 1.0
    """Mean time between two pushes [s]."""
    push_duration: float = 0.1
    """[s]"""
    ground: float = 1.0
    """Sliding friction about which runs differ, over the model's."""


NO_DISTURBANCE = Disturbance(friction=0.0, heading=0.0, joint=0.0, push=0.0)


class DisturbedRun:
    """One run's disturbances: `begin` after a reset, then `tick` before each step."""

    def __init__(self, twin: Twin[Any], disturbance: Disturbance, seed: int) -> None:
        self._twin, self._disturbance = twin, disturbance
        self._random = np.random.default_rng(seed)
        self._next_push = 0

    def begin(self) -> None:
        """Draws the ground and the first pose."""
        kind, random, twin = self._disturbance, self._random, self._twin
        twin.scale_friction(kind.ground * float(np.exp(kind.friction * random.standard_normal())))
        twin.displace(kind.heading * random.standard_normal(), kind.joint * random.standard_normal(twin.joint_count))
        self._schedule()

    def tick(self) -> None:
        """Pushes when it is time to."""
        if self._disturbance.push > 0.0 and self._twin.time_ns >= self._next_push:
            forward, left = self._disturbance.push * self._random.standard_normal(2)
            self._twin.push((float(forward), float(left), 0.0), self._disturbance.push_duration)
            self._schedule()

    def _schedule(self) -> None:
        wait = self._random.exponential(self._disturbance.push_interval)
        self._next_push = self._twin.time_ns + round(wait * 1e9)
