"""Oscillator phases: swing in [0, pi), stance in [-pi, 0), and the duty factor's non-linear phase (C 3.2.2, (3.1))."""

from __future__ import annotations

import math

TWO_PI = 2.0 * math.pi


def wrap(angle: float) -> float:
    """The same angle in [-pi, pi)."""
    return (angle + math.pi) % TWO_PI - math.pi


def locus_phase(theta: float, duty_factor: float) -> float:
    """Theta(theta): phase on the foot locus in [0, 2 pi) of an oscillator at `theta` [rad], swing first.

    (3.1) with what it needs: as printed its second branch has the slope 1 / (1 + d) and begins at
    2 pi (1 - d), so that the stance lasts (1 + d) / 2 of the cycle and never less than half. Here the swing takes
    2 pi (1 - d) of the oscillator's cycle and the stance 2 pi d: continuous at the switch and at the wrap.
    """
    theta %= TWO_PI
    swing = TWO_PI * (1.0 - duty_factor)
    if theta < swing:
        return 0.5 * theta / (1.0 - duty_factor)
    return math.pi + 0.5 * (theta - swing) / duty_factor
