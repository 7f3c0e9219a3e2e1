"""How far a model leaves the robot where nobody forgives it its start: what a user of a corrected model gets.

In the windows of a fit an error of the start is forgiven, and of measured inputs too, and a robot that amplifies its
start gets short ones. A drag that decides where such a robot is after half a second may show little there.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simgap.inference.fit import Fitter
from simgap.inference.hypothesis import Fit
from simgap.inference.residual import Residuals
from simgap.simulation.replay import Replayer
from simgap.simulation.windows import Windows, compared

Array = NDArray[np.float64]

STRETCH = 0.5
"""[s] at least, from where a window starts: chaos has not swallowed all by then, nor has the start been all there is. A
free run whose start error grows without bound is cut into such stretches too."""


class Stretches:
    """Stretches of one recording that begin where its windows do, each predicted by the fit that has not seen it."""

    def __init__(self, fitter: Fitter) -> None:
        base, windows = fitter.residuals.replayer, fitter.windows
        length = max(windows.length, round(STRETCH / base.aligned.period))
        ends = np.array([next(r.stop for r in base.aligned.runs if r.start <= s < r.stop) for s in windows.start])
        kept = np.flatnonzero((windows.fold >= 0) & (windows.start + length <= ends))
        start, block, fold = windows.start[kept], windows.block[kept], windows.fold[kept]
        own = Windows(start, windows.warm_up, length, compared(length), block, fold)
        self._fitter, self._fold = fitter, fold
        replayer = Replayer(base.plant, base.aligned, own, base.floor, base.threads)
        self._residuals = Residuals.build(replayer, fitter.base, start=False)
        self._known: dict[int, tuple[Fit, float]] = {}

    def error(self, fit: Fit) -> float:
        """Error [noise floors] of a typical stretch in a typical channel: the geometric mean over both.

        NaN where no stretch is held out, or the fit was not cross-validated.
        """
        if id(fit) not in self._known:
            self._known[id(fit)] = fit, self._error(fit)
        return self._known[id(fit)][1]

    def _error(self, fit: Fit) -> float:
        if not len(self._fold) or not len(fit.fold_x):
            return float("nan")
        points = zip(fit.fold_x, fit.fold_z, strict=True)
        variants = [self._fitter.variant(fit.hypothesis, x, z) for x, z in points]
        left = self._residuals.of(variants, which=self._fold[None])[0]
        mask = self._residuals.mask
        square = (left**2).sum(axis=1) / np.maximum(mask.sum(axis=1), 1)
        return float(np.sqrt(np.expm1(np.log1p(square[mask.any(axis=1)]).mean())))
