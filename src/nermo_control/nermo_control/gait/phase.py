"""The leg state machine: a timed automaton that says which foot stands, which swings, and when that changes (N 5.4.1).

The phase of a leg is frac(f t + offset): the offsets of table A.6 are phase advances. A leg stands while its phase is
below the duty factor and swings for the rest of the cycle.
"""

from __future__ import annotations

from dataclasses import dataclass

from nermo_control.gait.gaits import GaitDefinition
from nermo_control.types import Four, Phase

Phases = tuple[Phase, Phase, Phase, Phase]
Flags = tuple[bool, bool, bool, bool]

NONE_REQUESTED: Flags = (False, False, False, False)
ALL_REQUESTED: Flags = (True, True, True, True)


@dataclass(frozen=True, slots=True)
class LegPhases:
    """Where the four legs are in their phases at one tick."""

    phases: Phases
    fractions: Four
    """Share of the phase that has passed, [0, 1)."""
    remaining: Four
    """Time until the phase ends [s]."""


STANDING = LegPhases((Phase.STANCE,) * 4, (0.0,) * 4, (0.0,) * 4)


def legs_at(cycle: float, gait: GaitDefinition, frequency: float) -> LegPhases:
    """Phases of the legs at a time given in gait cycles since the cycle began, f t; frequency in Hz."""
    duty = gait.duty_factor
    phases, fractions, remaining = [], [], []
    for offset in gait.phase_offsets:
        phase = (cycle + offset) % 1.0
        if phase < duty:
            phases.append(Phase.STANCE)
            fractions.append(phase / duty)
            remaining.append((duty - phase) / frequency)
        else:
            phases.append(Phase.SWING)
            fractions.append((phase - duty) / (1.0 - duty))
            remaining.append((1.0 - phase) / frequency)
    return LegPhases(tuple(phases), tuple(fractions), tuple(remaining))  # type: ignore[arg-type]


class LegStateMachine:
    """Tracks the legs through the gait cycle and flags every change one control tick ahead.

    A new gait or frequency is taken up at the next start of a cycle; then every leg is planned anew.
    """

    def __init__(self, period_ns: int) -> None:
        self._period = period_ns
        self._cycle_start = 0
        self._cycle = 1
        self._begins = False
        self.now = STANDING
        """The legs at the present tick."""
        self.next = STANDING
        """The legs one tick ahead."""
        self.requested = NONE_REQUESTED
        """Legs of which a phase begins one tick ahead."""
        self.frequency = 0.0
        """Gait frequency in use [Hz], 0 while standing."""
        self.duty_factor = 1.0
        """Of the gait in use, 1 while standing."""
        self._gait: GaitDefinition

    def stand(self) -> None:
        """All legs stand; no cycle runs."""
        self.now = self.next = STANDING
        self.requested = NONE_REQUESTED
        self.frequency, self.duty_factor = 0.0, 1.0

    def start(self, stamp: int, gait: GaitDefinition, frequency: float) -> None:
        """Begins the first cycle one tick after `stamp` [ns], out of standing on four feet."""
        self._cycle_start = stamp + self._period
        self.next = STANDING
        self._adopt(gait, frequency)

    def step(self, stamp: int, gait: GaitDefinition, frequency: float) -> None:
        """Advances to the tick at `stamp` [ns], while a gait at a frequency [Hz] is wanted."""
        self.now = self.next
        elapsed = stamp + self._period - self._cycle_start
        if elapsed >= self._cycle:
            elapsed %= self._cycle
            self._cycle_start = stamp + self._period - elapsed
            if frequency != self.frequency or gait != self._gait:
                self._adopt(gait, frequency)
        self.next = legs_at(elapsed / self._cycle, self._gait, self.frequency)
        if self._begins:
            self.requested, self._begins = ALL_REQUESTED, False
        elif self.now.phases == self.next.phases:
            self.requested = NONE_REQUESTED
        else:
            self.requested = tuple(a is not b for a, b in zip(self.now.phases, self.next.phases, strict=True))  # type: ignore[assignment]

    def _adopt(self, gait: GaitDefinition, frequency: float) -> None:
        self._gait, self.frequency, self.duty_factor = gait, frequency, gait.duty_factor
        self._cycle = round(1e9 / frequency)
        self._begins = True
