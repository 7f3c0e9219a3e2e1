"""Holding a heading and a turn rate by odometry, in the external trajectory mode.

A mouse told to go straight drifts, and one told to turn slips: it turns at two thirds of what the turning model says.
One reference takes care of both: a heading that moves at the turn rate asked for. The heading's error is the integral
of the turn rate's, so that what is proportional to it is the slow integral trim of the turn rate.
"""

from __future__ import annotations

import math

from nermo_control.path import CycleMean
from nermo_control.types import Odometry

LARGEST_ERROR = 0.4
"""The reference runs ahead of the mouse by no more than this [rad]: what the gait cannot do is not stored up."""


class HeadingHold:
    """The turn rate to add to the one asked for, from the deviation of the heading, a mean over a gait cycle."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forgets the reference; the next step begins one where the mouse then points."""
        self._reference: float | None = None
        self._asked = 0.0
        self._stamp = 0
        self._mean = CycleMean()

    def step(self, odometry: Odometry, turn_rate: float, gain: float, frequency: float) -> float:
        """Correction [rad/s] for the turn rate asked for [rad/s].

        `gain` [1/s]: turn rate for each radian of deviation. `frequency` of the gait [Hz]. A stick that is let go, or
        thrown to the other side, begins anew: the heading of that moment is held.
        """
        turned_back = self._asked != 0.0 and turn_rate * self._asked <= 0.0
        if self._reference is None or turned_back or odometry.stamp < self._stamp:
            self.reset()
            self._reference, self._stamp = odometry.yaw, odometry.stamp
        self._reference += turn_rate * (odometry.stamp - self._stamp) * 1e-9
        self._asked, self._stamp = turn_rate, odometry.stamp
        error = math.remainder(self._reference - odometry.yaw, 2.0 * math.pi)
        held = max(-LARGEST_ERROR, min(error, LARGEST_ERROR))
        self._reference += held - error
        mean, _ = self._mean.step(odometry.stamp, held, 0.0, 1.0 / frequency)
        return gain * mean
