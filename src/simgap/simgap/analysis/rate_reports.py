"""Near before far, in one joint: what its sensor of speed says against the slope of its position, without a simulation.

A servo's speed is often a difference over some of its own cycles, or filtered: the same few milliseconds late in all
servos of a robot. Left alone, that is shared out among gains, friction and clocks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from simgap.analysis.borders import lag_costs, refined
from simgap.analysis.input_checks import positions_by_dof
from simgap.data.align import Aligned
from simgap.data.plant import Plant
from simgap.effects.sensor import ALL_RATES, rate_outputs, sensor_sites
from simgap.inference.candidates import Hint

Array = NDArray[np.float64]

_SMOOTH = 0.02
"""[s] by which both are smoothed: a slope of counted positions is all steps."""
_FEW = 50
"""Samples that are needed."""
_PLAIN = 0.8
"""A lag is told where it takes the squared error to this share of what it is without one."""
_UNLIKE = 1.1
"""And a scale where it is off by more than this, whichever of the two signals is the noisy one."""


@dataclass(frozen=True)
class Rate:
    """A report of speed against the slope of the same joint's position.

    Attributes:
        part: site of the sensor (``elbow:velocity``).
        column, position: of the two.
        lag: [s] by which the report follows; 0 where none is plain.
        scale: how many times the slope it says; 1 where that is not plainly wrong.
    """

    part: str
    column: str
    position: str
    lag: float
    scale: float

    def told(self) -> dict[str, object]:
        """As a row of ``borders`` of the report."""
        out = [name for name, usual in (("lag", 0.0), ("scale", 1.0)) if getattr(self, name) != usual]
        return {"part": self.part, "kind": "rate", "lag_s": self.lag, "scale": self.scale, "stands_out": out}


def rate_reports(plant: Plant, aligned: Aligned) -> list[Rate]:
    """Every live report of a joint's speed beside a live report of its position, that moves."""
    sites = {i: site.name for site in sensor_sites(plant) for i in site.targets}
    positions = positions_by_dof(plant, aligned)
    found = []
    for i in rate_outputs(plant):
        position = positions.get(plant.outputs[i].dof)
        if position is None or not aligned.live[i]:
            continue
        told = _told(plant, aligned, i, position)
        if told is not None:
            found.append(Rate(sites[i], plant.outputs[i].column, plant.outputs[position].column, *told))
    return found


def rate_hints(found: Sequence[Rate]) -> list[Hint]:
    """Effects (name, site, value) that speak for themselves here: late reports, of all where all are, and scales."""
    late = [r for r in found if r.lag > 0.0]
    spoken: list[Hint] = [("sensor_scale", r.part, r.scale) for r in found if r.scale != 1.0]
    if len(late) > 1 and len(late) == len(found):
        return [("sensor_delay", ALL_RATES, float(np.median([r.lag for r in late]))), *spoken]
    return [*(("sensor_delay", r.part, r.lag) for r in late), *spoken]


def rate_warnings(found: Sequence[Rate]) -> list[str]:
    """What somebody should look at before anything is blamed on the robot."""
    told = [
        f"column {r.column!r} says {r.scale:.2g} times the slope of {r.position!r}: is the unit of one of them another?"
        for r in found
        if r.scale != 1.0
    ]
    late = [r for r in found if r.lag > 0.0]
    if late:
        each = ", ".join(f"{r.column} {1e3 * r.lag:.0f}" for r in late)
        told.append(f"reports of speed follow the slopes of the positions late [ms]: {each}; they are old, or filtered")
    return told


def _told(plant: Plant, aligned: Aligned, rate: int, position: int) -> tuple[float, float] | None:
    """(lag [s], scale) of a report; None where too little moves."""
    sigma = max(_SMOOTH / aligned.period, 0.5)
    slope, said = np.zeros(len(aligned.time)), np.zeros(len(aligned.time))
    for run in aligned.runs:
        rows = slice(run.start, run.stop)
        if run.stop - run.start < 3:
            continue
        along = aligned.outputs[rows, position] / plant.outputs[position].gear
        slope[rows] = gaussian_filter1d(np.gradient(along, aligned.period), sigma, mode="nearest")
        said[rows] = gaussian_filter1d(aligned.outputs[rows, rate] / plant.outputs[rate].gear, sigma, mode="nearest")
    ok = aligned.valid[:, rate] & aligned.valid[:, position]
    steps, costs, usable = lag_costs(aligned, slope, said, ok)
    if usable.sum() < _FEW or costs[0] <= 0.0 or not np.ptp(slope[usable]) > 0.0:
        return None
    best = int(np.argmin(costs))
    lag = refined(costs) * aligned.period if best and costs[best] < _PLAIN * costs[0] else 0.0
    x = np.roll(slope, int(steps[best]))[usable]
    x, y = x - x.mean(), said[usable] - said[usable].mean()
    both = float(x @ y)
    if both <= 0.0:
        return None
    # Noise of the one makes a regression too flat, noise of the other too steep: the truth lies between.
    least, most = both / float(x @ x), float(y @ y) / both
    unlike = least > _UNLIKE or most < 1.0 / _UNLIKE
    return float(lag), float(np.sqrt(least * most)) if unlike else 1.0
