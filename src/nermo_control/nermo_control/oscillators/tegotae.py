"""The Tegotae rule: each leg's oscillator listens to its own load alone (C 3.3, (3.3)-(3.10))."""

from __future__ import annotations

import math


def discrepancy(phase: float, load: float, feedback: float) -> float:
    """I = sigma F sin theta (3.3): above 0 for a load in the swing, below 0 for one in the stance."""
    return feedback * load * math.sin(phase)


def compensation(load: float, feedback: float, omega: float) -> float:
    """x_c of (3.9) [rad]: puts the fixed point of a leg that cannot go on to mid-stance, -pi / 2."""
    held = feedback * load
    if abs(omega) < abs(held):
        return math.asin(omega / held)
    return math.copysign(0.5 * math.pi, omega * held) if omega * held != 0.0 else 0.0


def rate(phase: float, load: float, feedback: float, omega: float, compensated: bool) -> float:
    """Rate [rad/s] of a phase: omega - sigma F cos theta (3.4), or with the fixed point held at mid-stance (3.10).

    phase [rad]; load F [N]; feedback sigma [rad/(s N)]; omega: the excitation [rad/s].
    """
    shift = compensation(load, feedback, omega) if compensated else 0.0
    return omega - feedback * load * math.cos(phase + shift)


def fixed_point(load: float, feedback: float, omega: float) -> float | None:
    """Stable fixed point of (3.4) [rad] (3.5), or None where the leg never stops."""
    held = feedback * load
    return -math.acos(omega / held) if abs(omega) < held else None
