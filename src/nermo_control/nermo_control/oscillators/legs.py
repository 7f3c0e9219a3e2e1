"""Leg phases from oscillators: in the place of the timed leg state machine, with the same face."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from nermo_control.gait.gaits import GaitDefinition
from nermo_control.gait.knowledge_base import MAX_GAIT_FREQUENCY
from nermo_control.gait.phase import ALL_REQUESTED, NONE_REQUESTED, STANDING, Flags, LegPhases
from nermo_control.oscillators import tegotae
from nermo_control.oscillators.cpg import CoupledOscillators, phase_differences
from nermo_control.oscillators.phase import TWO_PI, locus_phase
from nermo_control.types import Four, Phase

Coordination = Literal["timed", "cpg", "tegotae"]
"""Who says when a foot lifts off: a clock (N 5.4.1), coupled oscillators (C 3.2), or the legs' loads (C 3.3)."""

FASTEST = TWO_PI * 2.0 * MAX_GAIT_FREQUENCY
"""Largest rate of a phase [rad/s]: a spike of the load must not throw a leg through its path."""
TEGOTAE_DUTY = 0.5
"""Of a path that is planned without a duty factor, which the Tegotae rule leaves to the body [1]."""

DUTY_RATE = 2.0
"""How fast the duty factor follows a new gait's [1/s]: as the phases, it must not jump."""


class OscillatorSettings(BaseModel):
    """Gains of the oscillators."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    coupling: float = Field(
        4.0,
        ge=0.0,
        le=50.0,
        description="w of (3.2): how hard the oscillators of `cpg` pull each other into the gait",
        json_schema_extra={"unit": "rad/s"},
    )
    feedback: float = Field(
        6.0,
        ge=0.0,
        le=200.0,
        description="sigma of (3.3) for a load of one body weight: how much `tegotae` listens to the load",
        json_schema_extra={"unit": "rad/s"},
    )
    fixed_point_compensation: bool = Field(
        True, description="A leg of `tegotae` that must wait does so at mid-stance (3.7)-(3.10)"
    )


class OscillatorLegs:
    """Tracks the legs by an oscillator each and flags every change of phase one control tick ahead.

    A leg that its load pushes back from the swing stands again where it is, until it is free.
    """

    def __init__(
        self, period_ns: int, kind: Literal["cpg", "tegotae"], settings: OscillatorSettings, weight: float
    ) -> None:
        """`weight` of the body [N]. Raises ValueError where it is not positive."""
        if not (weight > 0.0 and math.isfinite(weight)):
            raise ValueError(f"weight = {weight} N: must be finite and above 0")
        self._period, self._kind, self._settings, self._weight = period_ns * 1e-9, kind, settings, weight
        self._theta = [0.0] * 4
        self._begins = False
        self._gait: GaitDefinition
        self.now = STANDING
        """The legs at the present tick."""
        self.next = STANDING
        """The legs one tick ahead."""
        self.requested: Flags = NONE_REQUESTED
        """Legs of which a phase begins one tick ahead."""
        self.frequency = 0.0
        """Gait frequency that is asked for [Hz], 0 while standing. With `tegotae` the legs settle on their own."""
        self.duty_factor = 1.0
        """Of the gait in use, 1 while standing."""

    @property
    def phases(self) -> Four:
        """Theta of the four legs one tick ahead, in [0, 2 pi): of `cpg` linear in time, of `tegotae` on the locus."""
        a, b, c, d = (theta % TWO_PI for theta in self._theta)
        return a, b, c, d

    def set_settings(self, settings: OscillatorSettings) -> None:
        """Other gains from now on."""
        self._settings = settings

    def stand(self) -> None:
        """All legs stand; nothing oscillates."""
        self.now = self.next = STANDING
        self.requested = NONE_REQUESTED
        self.frequency, self.duty_factor = 0.0, 1.0

    def start(self, stamp: int, gait: GaitDefinition, frequency: float) -> None:
        """Begins out of standing on four feet, with the phase differences of the gait."""
        self._gait, self.frequency, self.duty_factor = gait, frequency, self._duty_of(gait)
        self._theta = [TWO_PI * (offset - self.duty_factor) for offset in gait.phase_offsets]
        self.next = STANDING
        self._begins = True

    def step(self, stamp: int, gait: GaitDefinition, frequency: float, loads: Sequence[float] | None = None) -> None:
        """Advances to the tick at `stamp` [ns]; `loads` of the feet [N]. Without any, `tegotae` runs free."""
        self.now = self.next
        self._gait, self.frequency = gait, frequency
        if not self._begins:
            self.duty_factor += DUTY_RATE * self._period * (self._duty_of(gait) - self.duty_factor)
            self._advance(loads)
        self.next = self._legs()
        if self._begins:
            self.requested, self._begins = ALL_REQUESTED, False
        elif self.now.phases == self.next.phases:
            self.requested = NONE_REQUESTED
        else:
            self.requested = tuple(a is not b for a, b in zip(self.now.phases, self.next.phases, strict=True))  # type: ignore[assignment]

    def _duty_of(self, gait: GaitDefinition) -> float:
        return gait.duty_factor if self._kind == "cpg" else TEGOTAE_DUTY

    def _advance(self, loads: Sequence[float] | None) -> None:
        for leg, (theta, rate) in enumerate(zip(self._theta, self._rates(loads), strict=True)):
            self._theta[leg] = theta + self._period * min(max(rate, -FASTEST), FASTEST)

    def _rates(self, loads: Sequence[float] | None) -> list[float]:
        omega, settings = TWO_PI * self.frequency, self._settings
        if self._kind == "cpg":
            oscillators = CoupledOscillators(settings.coupling, self._theta)
            return oscillators.rates(omega, phase_differences(self._gait.phase_offsets))
        sigma = settings.feedback / self._weight
        return [
            tegotae.rate(theta, max(load, 0.0), sigma, omega, settings.fixed_point_compensation)
            for theta, load in zip(self._theta, loads or (0.0,) * 4, strict=True)
        ]

    def _legs(self) -> LegPhases:
        duty, frequency = self.duty_factor, self.frequency
        phases, fractions, remaining = [], [], []
        for theta in self._theta:
            place = locus_phase(theta, duty)
            swings = place < math.pi
            fraction = (place if swings else place - math.pi) / math.pi
            phases.append(Phase.SWING if swings else Phase.STANCE)
            fractions.append(fraction)
            remaining.append((1.0 - fraction) * (1.0 - duty if swings else duty) / frequency)
        return LegPhases(tuple(phases), tuple(fractions), tuple(remaining))  # type: ignore[arg-type]
