"""Where a healthy robot has been: what it is not known to have done it may always have done otherwise.

What a model misses depends on the motion. A servo that never went fast when it was well says nothing of its friction at
speed, and what shows there in a new recording need not be new. So windows are compared with a reference only where that
has been too, by how far each output goes. The healthy model's prediction stands for both, for a fault moves a robot
elsewhere.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simgap.simulation.replay import Replayer
from simgap.simulation.variant import Variant

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

FURTHER = 1.5
"""Times as far as ever in the reference an output may go within a window."""
_BEYOND = 0.25
"""Share of all that an output covered in the reference by which it may go beyond."""
_FLOORS = 10.0
"""[noise floors] that do not count as going anywhere."""


@dataclass(frozen=True)
class Motion:
    """How far outputs go in windows.

    Attributes:
        low, high: (nw, no) least and largest value of each output in each window.
        on: (nw,) whether servos gave torque all the time.
        bounded: (no,) whether an output's place counts too: a joint's does, that of a robot on the floor does not.
        floor: (no,) noise floors.
        seconds: length of a window [s].
    """

    low: Array
    high: Array
    on: Bools
    bounded: Bools
    floor: Array
    seconds: float

    @classmethod
    def of(cls, replayer: Replayer, variant: Variant) -> Motion:
        """The motion of a recording, as the model of the healthy robot has it."""
        found = replayer.run([variant])[0]
        aligned, windows, plant = replayer.aligned, replayer.windows, replayer.plant
        recorded = aligned.outputs[windows.rows()]
        found = np.where(np.isfinite(found), found, recorded)
        wrapped = np.array([o.wrapped for o in plant.outputs])
        found = np.where(wrapped, np.unwrap(found, axis=1), found)
        on = np.array([aligned.enabled[s - windows.warm_up : s + windows.length].all() for s in windows.start])
        bounded = np.array([o.qpos >= 0 for o in plant.outputs])
        return cls(found.min(axis=1), found.max(axis=1), on, bounded, replayer.floor, windows.length * aligned.period)

    @property
    def way(self) -> Array:
        """(nw, no) how far outputs go in each window."""
        return self.high - self.low

    def strange(self, known: Motion) -> tuple[Bools, Array]:
        """(windows (nw,) that go where ``known`` never did, (no,) how many times as far at most)."""
        strange, times = np.zeros(len(self.on), bool), np.ones(self.low.shape[1])
        for on in (True, False):
            mine, its = self.on == on, known.on == on
            if not its.any():
                strange |= mine
                continue
            most = np.maximum(known.way[its].max(axis=0), _FLOORS * known.floor)
            low, high = known.low[its].min(axis=0), known.high[its].max(axis=0)
            edge = np.where(self.bounded, _BEYOND * (high - low) + _FLOORS * known.floor, np.inf)
            # Who has more time goes further.
            further = self.way / most * min(1.0, known.seconds / self.seconds)
            beyond = (self.low < low - edge) | (self.high > high + edge)
            strange |= mine & ((further > FURTHER) | beyond).any(axis=1)
            if mine.any():
                times = np.maximum(times, further[mine].max(axis=0))
        return strange, times
