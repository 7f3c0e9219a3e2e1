"""Is a foot on the ground: the probability of it, and the moments at which that changes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

Array = NDArray[np.float64]


class ContactDetector:
    """Contact is a load above `threshold` [N]; a change is an event once it is more likely than `certainty`.

    The threshold is `contact_force` of the robot's file in `parameters/`, unless the node's parameter says another.
    """

    def __init__(self, count: int, threshold: float, certainty: float = 0.9) -> None:
        if not 0.5 < certainty < 1.0:
            raise ValueError(f"certainty = {certainty}: must be above 0.5 and below 1")
        if not threshold > 0.0:
            raise ValueError(f"threshold = {threshold} N: must be above 0")
        self._threshold, self._certainty = threshold, certainty
        self.contact = np.zeros(count, dtype=bool)
        """(B,): the present state."""
        self.since = np.zeros(count, dtype=np.int64)
        """(B,) [ns]: stamp of the last touch-down or lift-off."""

    def step(self, stamp: int, load: Array, variance: Array) -> Array:
        """Takes the estimate of a stamp [ns]; returns the probability of contact (B,)."""
        probability = ndtr((load - self._threshold) / np.sqrt(variance))
        down = ~self.contact & (probability > self._certainty)
        up = self.contact & (probability < 1.0 - self._certainty)
        self.contact = (self.contact | down) & ~up
        self.since = np.where(down | up, stamp, self.since)
        return np.asarray(probability)
