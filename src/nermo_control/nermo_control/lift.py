"""Lifting one leg of a standing mouse, the balance test of N 6.1.5: first the weight goes off it, then it rises."""

from __future__ import annotations

from nermo_control.gait.phase import Flags
from nermo_control.types import Four, Posture
from nermo_description.blend import smooth

LIFTED_LEG = {
    Posture.LIFT_FRONT_LEFT: 0,
    Posture.LIFT_FRONT_RIGHT: 1,
    Posture.LIFT_REAR_LEFT: 2,
    Posture.LIFT_REAR_RIGHT: 3,
}
"""The postures that stand on three feet, and the leg that each lifts."""
KNEE_COMPRESSION: Four = (0.6, 0.6, 0.7, 0.7)
"""How far each leg's knee servo pulls to lift it [rad], N A.4.2 (it names the rear legs twice: 0.6 is the front's)."""
SHIFT_DURATION = 1.0
"""What the spine has to bring the centre of mass over the other feet [s]; N figure 6.15 shows the lift at about 1 s."""
LIFT_DURATION = 0.3
"""[s]"""


class LegLift:
    """One leg on its way up, and down again once `lower` has been called. Stamps in ns."""

    def __init__(self, leg: int, stamp: int) -> None:
        self.leg = leg
        self.lifted: Flags = tuple(number == leg for number in range(4))  # type: ignore[assignment]
        """For the balance of the spine."""
        self._begin = stamp + round(SHIFT_DURATION * 1e9)
        self._lowered: int | None = None
        self._highest = 1.0

    def lower(self, stamp: int) -> None:
        """Begins to put the leg down, from where it is; again changes nothing."""
        if self._lowered is None:
            self._highest = self._risen(stamp)
            self._lowered = stamp

    def knee(self, stamp: int) -> float:
        """What to add to the position of the leg's knee servo [rad]; 0 on the ground."""
        return -KNEE_COMPRESSION[self.leg] * self._share(stamp)

    def down(self, stamp: int) -> bool:
        """Whether the leg stands again after `lower`."""
        return self._lowered is not None and self._share(stamp) <= 0.0

    def _risen(self, stamp: int) -> float:
        return smooth((stamp - self._begin) * 1e-9 / LIFT_DURATION)

    def _share(self, stamp: int) -> float:
        if self._lowered is None:
            return self._risen(stamp)
        return self._highest * (1.0 - smooth((stamp - self._lowered) * 1e-9 / LIFT_DURATION))
