"""Nominal numbers that moved: which, from what to what, how sure, and how much of the gap each of them explains."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from simgap.inference.deviations import NORMAL_90, nuisance_deviation
from simgap.inference.fit import Fitter
from simgap.inference.hypothesis import Fit, Hypothesis
from simgap.inference.long_windows import LongWindows
from simgap.inference.nuisance import BOX

Array = NDArray[np.float64]

MOVED = 0.3
"""[prior deviations] A number that moved by less is not reported, unless its interval leaves out the nominal value."""
AT_LIMIT = 0.999
"""Share of the box at which a number sits on its limit."""
_MOST = 16
"""Numbers that are reported, those that moved furthest first."""


def calibration(fitter: Fitter, fit: Fit, longer: LongWindows | None = None) -> list[dict[str, Any]]:
    """``calibration`` of the report for a cross-validated fit; the numbers that explain most come first.

    Where long windows tell the numbers better, it is those.

    ``gap_share`` is the part of the gap that a number explains, see `gap_shares`.
    """
    if longer is None:
        deviation, box = nuisance_deviation(fitter, fit), np.full(len(fit.z), BOX)
    else:
        fit, deviation, box = longer.fit, longer.deviation, longer.box
    low, high = (np.clip(fit.z + side * NORMAL_90 * deviation, -box, box) for side in (-1.0, 1.0))
    sure = (low > 0.0) | (high < 0.0)
    order = np.argsort(-np.abs(fit.z))
    moved = [int(i) for i in order if abs(fit.z[i]) > MOVED or (sure[i] and abs(fit.z[i]) > 0.1 * MOVED)][:_MOST]
    rows = []
    for i, share in zip(moved, gap_shares(fitter, fit, moved), strict=True):
        number = fitter.nuisances[i].described()
        rows.append(
            {
                "name": number.name,
                "site": number.site,
                "nominal": number.value(0.0),
                "value": number.value(float(fit.z[i])),
                "unit": number.unit,
                "ci90": sorted([number.value(float(low[i])), number.value(float(high[i]))]),
                "gap_share": share,
                "prior_deviations": float(fit.z[i]),
                "at_limit": bool(abs(fit.z[i]) >= AT_LIMIT * box[i]),
            }
        )
    return sorted(rows, key=lambda row: -float(str(row["gap_share"])))


def gap_shares(fitter: Fitter, fit: Fit, which: list[int]) -> list[float]:
    """Share of the gap that each of the nuisances ``which`` explains, on the way from the nominal model to the fit.

    Numbers and effects all move along a straight line. With the residual r0 of the nominal model and r1 of the fit,
    |r0|^2 - |r1|^2 = (r0 + r1) (r0 - r1), and r0 - r1 is the sum of what each of them changes: to second order the
    difference that it makes about the middle of the way. Shares of numbers that work against each other may be
    negative; with those of the effects they add up to what the fit explains. Held-out windows and channels count by
    their own gap, so that one that is far off does not hide the rest; those that are within the noise have none.
    """
    held, rest = fitter.windows.fold >= 0, np.zeros_like(fit.z)
    nominal = fitter.replay(Hypothesis(), [(np.zeros(0), rest)])[0]
    square = fitter.mean_square(nominal)
    gapes = fitter.recorded & (square > 1.0)
    weight = (np.where(gapes, 1.0 / (1.0 + square), 0.0) / fitter.count)[held][:, None, :]
    both = (nominal + fitter.replay(fit.hypothesis, [(fit.x, fit.z)])[0])[held]
    power = float((weight * nominal[held] ** 2).sum()) - float((weight * fitter.residuals.mask[held]).sum())
    neutral = fit.hypothesis.scaled(fit.hypothesis.vector("neutral"))
    middle_x = fit.hypothesis.values(0.5 * (neutral + fit.hypothesis.scaled(fit.x)))
    shares = []
    for i in which:
        ends = np.tile(0.5 * fit.z, (2, 1))
        ends[:, i] = 0.0, fit.z[i]
        before, after = fitter.replay(fit.hypothesis, [(middle_x, z) for z in ends])
        shares.append(float((weight * both * (before - after)[held]).sum()) / power if power > 0.0 else 0.0)
    return shares
