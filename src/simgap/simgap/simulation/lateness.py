"""How late the command is that acts, where each one comes late by chance or never."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

Array = NDArray[np.float64]

_FORGOTTEN = 1e-6
"""Commands that are older with less than this probability are left out."""
_TICKS = 1 << 15
"""Updates of the link that is simulated to see how long its lateness lasts."""


@dataclass(frozen=True)
class Lateness:
    """A link that loses each update with probability ``loss`` and delays the others, by ``jitter`` updates on average.

    The newest update that has arrived is the one that acts; a late one does not undo it. Delays are exponential. Where
    they are longer than an update only their density at short delays counts, because the quick ones overtake.
    """

    loss: float
    jitter: float

    def ages(self) -> Array:
        """Probability (m,) that the acting command is 0, 1, ... updates old, in the middle between two updates."""
        loss, jitter = min(self.loss, 0.999), max(self.jitter, 1e-9)
        count = int(np.ceil(np.log(_FORGOTTEN) / np.log(max(loss, 1e-3)) + 6.0 * np.sqrt(jitter))) + 2
        missing = loss + (1.0 - loss) * np.exp(-(np.arange(count) + 0.5) / jitter)
        # Older than m: none of the last m + 1 has arrived.
        older = np.concatenate([[1.0], np.cumprod(missing)])
        shares = -np.diff(older)
        result: Array = shares / shares.sum()
        return result

    def moments(self, u: Array, lag: int) -> tuple[Array, Array]:
        """Mean and standard deviation (n, ...) of the acting command; ``u`` (n, ...) is updated every ``lag`` rows."""
        taps = np.zeros((len(ages := self.ages()) - 1) * lag + 1)
        taps[::lag] = ages
        taps = taps[: len(u) + lag]
        # About the first value, which also came before it.
        moved = u - u[:1]
        mean, square = (lfilter(taps, [1.0], x, axis=0) for x in (moved, moved**2))
        return u[:1] + mean, np.sqrt(np.maximum(square - mean**2, 0.0))

    def memory(self, count: int) -> Array:
        """Autocorrelation (count,) of the acting command's age over 0, 1, ... updates, from a simulated link."""
        rng = np.random.default_rng(0)
        sent = np.arange(_TICKS)
        late = np.ceil(np.maximum(self.jitter * rng.exponential(size=_TICKS) - 0.5, 0.0)).astype(np.int64)
        arrived = (rng.random(_TICKS) >= self.loss) & (sent + late < _TICKS)
        newest = np.zeros(_TICKS, np.int64)
        np.maximum.at(newest, (sent + late)[arrived], sent[arrived])
        age = (sent - np.maximum.accumulate(newest)).astype(float)
        spectrum = np.abs(np.fft.rfft(age - age.mean(), 2 * _TICKS)) ** 2
        covariance = np.fft.irfft(spectrum)[:count]
        result: Array = covariance / max(covariance[0], 1e-300) if covariance[0] > 0 else np.eye(1, count)[0]
        return result
