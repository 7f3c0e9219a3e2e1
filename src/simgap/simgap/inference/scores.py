"""How good a fit is: held-out costs, gaps, and their block bootstrap."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import median_abs_deviation

from simgap.inference.fit import Fitter
from simgap.inference.hypothesis import Fit
from simgap.inference.stretches import Stretches
from simgap.inference.thresholds import LAW_ERROR

Array = NDArray[np.float64]

BOOTSTRAPS = 400
DIFFERENT, _FEW = 0.5, 2
"""[nats] by which two hypotheses differ in a block, at least; blocks that are needed for an interval."""
_SCATTER = 4
"""Fits whose scatter is a measure of chance."""
_OF_A_MINIMUM = 0.5
"""How far the least of some twenty values scatters that do so by one."""
_ENDS = 4
"""Fits that ended twice, from which on that says how rough it is."""
_OF_A_DIFFERENCE = 1.4826 / math.sqrt(2.0)
"""Standard deviation of a normal variable by the median size of the difference of two."""
PER_PARAMETER = 1.0
"""Price of a parameter [nats], beyond what held-out scoring takes by itself."""


def temperature(gain: float, law_error: float = LAW_ERROR) -> float:
    """How many nats count as one, of what an effect gains by its law."""
    return max(1.0, law_error * gain) if math.isfinite(gain) else 1.0


@dataclass(eq=False)
class Scored:
    """A fit with its held-out score; smaller is better."""

    fit: Fit
    score: float
    gap: float

    @property
    def key(self) -> str:
        """Names of its effects."""
        return self.fit.hypothesis.key


class Scores:
    """Scores fits on one recording; every bootstrap sample draws blocks of windows."""

    def __init__(self, fitter: Fitter, seed: int = 0, left: float = math.inf, in_sample: bool = False) -> None:
        """``left``: [noise floors] that a robot which is wholly explained leaves in a channel at most, where known.

        ``in_sample``: whether fits are ranked as they are judged where held-out costs are rough, in sample. A mouse's
        shifted COM was 57 nats in front there, and held out behind the range of a joint that was never reached.
        """
        self._fitter, self._seed, self._left, self._in_sample = fitter, seed, left, in_sample
        self.missed_anyway = False
        """Whether all that hypotheses gain is in what the model misses of the robot when it is well."""
        windows = fitter.windows
        scored = np.flatnonzero(windows.fold >= 0)
        blocks = np.unique(windows.block[scored])
        rng = np.random.default_rng(seed)
        draws = rng.integers(0, len(blocks), (BOOTSTRAPS, len(blocks)))
        times = np.stack([np.bincount(d, minlength=len(blocks)) for d in draws])
        # How often each window counts in each bootstrap sample, (BOOTSTRAPS + 1, nw); the first row is the data itself.
        self.draws: Array = np.zeros((BOOTSTRAPS + 1, len(windows)))
        self.draws[0, scored] = 1.0
        self.draws[1:, scored] = times[:, np.searchsorted(blocks, windows.block[scored])]
        self.written = 0.0
        """What earlier causes earned that are written into the model by now [nats]; 0 where there are none."""
        self.ends: list[float] = []
        """How far apart [nats] two fits of one hypothesis ended that began from different nominal numbers."""
        self._reference = math.nan
        self._stretches: Stretches | None = None

    def known(self, fit: Fit) -> float:
        """What a fit costs because it is far from what somebody has stated [nats].

        The gain of a law is trusted to a share of LAW_ERROR only; what was stated is not law's matter, and weighs as
        much beside a large gap as beside a small one.
        """
        found = fit.hypothesis.implausible(fit.x)
        return found * temperature(self._reference - float(np.nansum(fit.held_cost))) if found else 0.0

    def costs(self, fit: Fit) -> Array:
        """Total score of a fit in each bootstrap sample, (BOOTSTRAPS + 1,)."""
        data = self.draws @ np.nan_to_num(self.telling(fit) if self._in_sample else fit.held_cost)
        result: Array = data + fit.prior + PER_PARAMETER * fit.hypothesis.size + self.known(fit)
        return result

    def gaps(self, square: Array) -> Array:
        """Gap (root mean square of normalised residuals over channels) in each bootstrap sample, from (nw, nl)."""
        weight = self.draws[:, :, None] * self._fitter.recorded[None]
        mean = (weight * np.nan_to_num(square)[None]).sum(axis=1) / np.maximum(weight.sum(axis=1), 1.0)
        result: Array = np.sqrt(mean.mean(axis=1))
        return result

    def typical(self, square: Array) -> float:
        """Gap of a typical window, from (nw, nl): the geometric mean over them, which few wild ones do not move."""
        return float(np.sqrt(np.expm1(self._levels(square)).mean()))

    def overall(self, square: Array) -> float:
        """Gap of a typical window in a typical channel, from (nw, nl): the geometric mean over both, as scores have it.

        One channel that is far off does not drown the others.
        """
        return float(np.sqrt(np.expm1(self._levels(square).mean())))

    def worst_channel(self, square: Array) -> float:
        """Gap of the channel that is furthest off, over held-out windows, from (nw, nl)."""
        weight = self.draws[0][:, None] * self._fitter.recorded
        mean = (weight * np.nan_to_num(square)).sum(axis=0) / np.maximum(weight.sum(axis=0), 1.0)
        return float(np.sqrt(mean.max()))

    def leaves_more(self, square: Array) -> bool:
        """Whether mean squares (nw, nl) of windows are more than this robot leaves where all is explained."""
        return self.worst_channel(square) > self._left

    def free_error(self, fit: Fit) -> float:
        """Error [noise floors] of a cross-validated fit where nothing forgives it its start (`Stretches`)."""
        if self._stretches is None:
            self._stretches = Stretches(self._fitter)
        return self._stretches.error(fit)

    def telling(self, fit: Fit) -> Array:
        """What each window (nw,) speaks against a fit [nats], NaN where it was never held out.

        Its held-out cost; where that is rough, the one in sample, at a price for each parameter that learned of it.
        """
        if fit.likelihood is not None:
            return fit.likelihood
        if self.roughness == 0.0 and not self._in_sample:
            return fit.held_cost
        held = self.draws[0] > 0
        found: Array = np.where(held, self._fitter.seen(fit) + fit.hypothesis.size / held.sum(), np.nan)
        return found

    def left(self, fit: Fit) -> Array:
        """Mean squares (nw, nl) of windows by which is judged what a fit leaves, NaN where never held out.

        Held out; where that is rough, in sample, as in `telling`.
        """
        if fit.likelihood is not None or self.roughness == 0.0:
            return fit.held
        return np.where(np.isfinite(fit.held), self._fitter.mean_square(fit.residual), np.nan)

    def gap(self, square: Array) -> float:
        """Gap of mean squares (nw, nl), over all windows."""
        return float(self.gaps(square)[0])

    @property
    def unit(self) -> str:
        """Of what one hypothesis gains over another, in words."""
        return "nats in sample, less one for each parameter" if self.roughness else "nats on held-out data"

    @property
    def roughness(self) -> float:
        """Standard deviation [nats] of a cost in sample, of a robot that lands: where a fit ends on rough ground.

        What a fit loses by not having seen a window differs by a nat or two a parameter, for all share their nominal
        numbers. Landings make valleys rough, and the rest of the scatter is where a fold's step ended. In sample a fit
        ends in the least of the points that it tried. Of robots that touch nothing all of it is a law's fault.
        Where fits have ended twice, how far apart says it directly: a mouse's ended 6 nats apart, or 2, where the
        scatter of folds would have it 22.
        """
        lost = self._fitter.lost
        if not self._fitter.lands or len(lost) < _SCATTER:
            return 0.0
        if len(self.ends) >= _ENDS:
            return _OF_A_DIFFERENCE * float(np.median(self.ends))
        return _OF_A_MINIMUM * float(median_abs_deviation(lost, scale="normal"))

    def _by_block(self, gains: Array) -> Array:
        """Sums of what held-out windows (nw,) gain, by block."""
        return np.asarray(np.bincount(self._fitter.windows.block, gains * self.draws[0]), np.float64)

    def _levels(self, square: Array) -> Array:
        """Mean logarithm (nl,) of one and the mean squares (nw, nl) of held-out windows."""
        weight = self.draws[0][:, None] * self._fitter.recorded
        mean: Array = (weight * np.log1p(np.nan_to_num(square))).sum(axis=0) / np.maximum(weight.sum(axis=0), 1.0)
        return mean

    def scored(self, fit: Fit) -> Scored:
        """Score a cross-validated fit; one without effects is what all others are compared with."""
        if not fit.hypothesis.effects:
            self._reference = float(np.nansum(fit.held_cost))
        return Scored(fit, float(self.costs(fit)[0]), float(self.gaps(fit.held)[0]))

    def difference(self, worse: Fit, better: Fit) -> tuple[float, float, float]:
        """(mean, 5 %, 95 %) of the score that ``better`` gains over ``worse`` [nats], paired by block."""
        if worse.likelihood is not None and better.likelihood is not None:
            return self.gain(worse.likelihood, better.likelihood)
        price = PER_PARAMETER * (better.hypothesis.size - worse.hypothesis.size)
        price += self.known(better) - self.known(worse)
        return self.gain(*self._compared(worse, better), worse.prior - better.prior - price)

    def without_best(self, worse: Fit, better: Fit) -> float:
        """What ``better`` gains over ``worse`` [nats] where the block in which it gains most had not been recorded."""
        before, after = self._compared(worse, better)
        return self.difference(worse, better)[0] - float(self._by_block(before - after).max(initial=0.0))

    def _compared(self, worse: Fit, better: Fit) -> tuple[Array, Array]:
        """Costs (nw,) of two fits by one measure: `telling`, or where only one is of chance, both held out."""
        if (worse.likelihood is None) == (better.likelihood is None):
            costs = [self.telling(f) for f in (worse, better)]
        else:
            costs = [f.held_cost for f in (worse, better)]
        return np.nan_to_num(costs[0]), np.nan_to_num(costs[1])

    def gain(self, worse: Array, better: Array, beside: float = 0.0) -> tuple[float, float, float]:
        """(mean, 5 %, 95 %) of the difference of costs (nw,) of windows, and what is gained ``beside`` it.

        Blocks are drawn of those in which the two differ, for a stop or a limit that is seldom met says nothing
        elsewhere; windows, where that is a single block. A single window shows nothing: it might be any accident.
        """
        gains = (worse - better) * self.draws[0]
        units = self._by_block(worse - better)
        if (np.abs(units) > DIFFERENT).sum() < _FEW:
            units = gains
        units = units[np.abs(units) > DIFFERENT]
        total = float(gains.sum()) + beside
        if len(units) < _FEW:
            return total, min(total, 0.0), total
        rng = np.random.default_rng(self._seed)
        sums = units[rng.integers(0, len(units), (BOOTSTRAPS, len(units)))].sum(axis=1)
        low, high = np.percentile(total + sums - units.sum(), [5, 95])
        return total, float(low), float(high)
