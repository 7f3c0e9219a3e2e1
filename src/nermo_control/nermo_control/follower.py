"""A target taken up without a jump."""

from __future__ import annotations

import math

RESPONSE_TIME = 0.05
"""Time constant [s]: what is switched or thrown over takes effect within about 0.25 s."""

POSE_RESPONSE_TIME = 0.15
"""Likewise for a pose of tail or back, over whose whole range a servo then moves at no more than about 3 rad/s [s]."""

TUNING_RESPONSE_TIME = 0.07
"""Likewise for a parameter of the spine that is changed while it bends: its servo then accelerates by no more than some
350 rad/s^2, half of what 0.05 s would ask for [s]."""


class Follower:
    """Follows its target as a critically damped spring does: without a jump in value or rate, in exact steps.

    `period` [s] is that of the steps, `value` where it begins, at rest.
    """

    def __init__(self, period: float, value: float = 0.0, response_time: float = RESPONSE_TIME) -> None:
        self._period = period
        self._rate = 1.0 / response_time
        self._decay = math.exp(-period / response_time)
        self.value = value
        """Where it is."""
        self._velocity = 0.0

    def step(self, target: float) -> float:
        """One period on towards the target; returns where it is."""
        error = self.value - target
        change = (self._velocity + self._rate * error) * self._period
        self.value = target + (error + change) * self._decay
        self._velocity = (self._velocity - self._rate * change) * self._decay
        return self.value
