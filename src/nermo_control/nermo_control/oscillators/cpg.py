"""The central pattern generator: four phase oscillators that pull each other into a gait (C 3.2.2, (3.2))."""

from __future__ import annotations

import math
from collections.abc import Sequence

from nermo_control.oscillators.phase import TWO_PI, wrap


def phase_differences(offsets: Sequence[float]) -> tuple[tuple[float, ...], ...]:
    """Psi [rad] of (3.2), in [-pi, pi), from the legs' phase advances in cycles: psi[i][j] is leg j ahead of leg i.

    Taken from advances, the differences always fit together around any loop of legs.
    """
    return tuple(tuple(wrap(TWO_PI * (other - one)) for other in offsets) for one in offsets)


class CoupledOscillators:
    """theta_i' = omega + w sum_j sin(theta_j - theta_i - psi_ij), (3.2) with its dot. All legs are coupled alike."""

    def __init__(self, coupling: float, phases: Sequence[float]) -> None:
        """`coupling` w [rad/s], 0 or more; `phases` [rad] at the start. Raises ValueError."""
        if not (math.isfinite(coupling) and coupling >= 0.0):
            raise ValueError(f"coupling = {coupling} rad/s: must be finite and 0 or more")
        if not all(map(math.isfinite, phases)):
            raise ValueError(f"phases = {list(phases)} rad: must be finite")
        self._coupling = coupling
        self.phases = list(phases)
        """theta [rad], growing without bound."""

    def rates(self, omega: float, differences: Sequence[Sequence[float]]) -> list[float]:
        """Rates [rad/s] of the phases at a pulsation [rad/s] under the differences psi [rad] of a gait."""
        sin, phases, coupling = math.sin, self.phases, self._coupling
        return [
            omega + coupling * sum(sin(other - one - psi) for other, psi in zip(phases, row, strict=True))
            for one, row in zip(phases, differences, strict=True)
        ]

    def step(self, period: float, omega: float, differences: Sequence[Sequence[float]]) -> None:
        """Advances by a period [s]. A new gait pulls the legs over within a few 1 / w."""
        for leg, rate in enumerate(self.rates(omega, differences)):
            self.phases[leg] += period * rate

    def disorder(self, differences: Sequence[Sequence[float]]) -> float:
        """Largest distance of a phase difference from the gait's [rad], 0 once locked."""
        return max(
            abs(wrap(other - one - psi))
            for one, row in zip(self.phases, differences, strict=True)
            for other, psi in zip(self.phases, row, strict=True)
        )
