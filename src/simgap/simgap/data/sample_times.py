"""When samples were taken, where the stamps say when they came.

A log notes a message's arrival: later by what the bus, the operating system and a buffer took, which scatters, or five
samples at once. The robot's own clock was steady. Which of the two is right, the motion says: it is smooth only in the
right one.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_APART, _AT_ONCE = 20, 10.0
"""Rows over which the period is looked for, more than come at once; and periods that a row may come too late."""
_LEAST, _BEGIN = 100, 1000
"""Rows that tell a clock, and the most from which it is first fitted."""
_NEAR = 0.05
"""Share by which the period may be off at first."""
_SMOOTHER = 0.7
"""Times as rough, at most, the motion has to be at the steady clock's times."""
_FULL = 0.9
"""Share of the rows in which a channel must have a value, to say anything of the rows' times."""


def sample_times(time: Array, outputs: Array) -> tuple[Array, float]:
    """Times (n,) at which the rows of one run were sampled, and how far stamps scatter about these [s]; 0 if kept.

    Rows are ticks of a steady clock, counted by their stamps, or one by one where several came at once. That clock is
    believed where the ``outputs`` (n, channels) go clearly smoother by it than by the stamps.
    """
    moving = [values for values in outputs.T if np.isfinite(values).mean() > _FULL and np.nanstd(values) > 0.0]
    if len(time) < _LEAST or not moving:
        return time, 0.0
    # Of most stretches, none longer for rows that it has lost.
    period = float(np.percentile(time[_APART:] - time[:-_APART], 25)) / _APART
    if not period > 0.0 or np.abs(np.diff(time)).max() > _AT_ONCE * period:
        return time, 0.0
    best, scatter = time, 0.0
    least = _roughness(time, moving) + float(np.log(_SMOOTHER))
    for ticks in (_counted(time, period), np.arange(float(len(time)))):
        begin, step = _steady(time, ticks)
        times = begin + step * ticks
        off = time - times
        if (np.diff(ticks) < 1.0).any() or np.abs(off).max() > _AT_ONCE * step:
            continue
        if (rough := _roughness(times, moving)) < least:
            best, scatter, least = times, float(np.std(off)), rough
    return best, scatter


def _counted(time: Array, period: float) -> Array:
    """The tick of a clock of about that period [s] to which each row's stamp is nearest.

    Of many periods that is taken at which the first rows agree best in phase; then the clock is fitted to twice as many
    rows each time, over which its error is not yet half a tick.
    """
    rows = min(_BEGIN, len(time))
    first = time[:rows] - time[0]
    periods = period * np.arange(1.0 - _NEAR, 1.0 + _NEAR, 0.1 / rows)
    phases = np.array([np.exp(2j * np.pi * first / one).mean() for one in periods])
    best = int(np.argmax(np.abs(phases)))
    step = float(periods[best])
    begin = float(time[0] + step * np.angle(phases[best]) / (2.0 * np.pi))
    while True:
        ticks = np.round((time[:rows] - begin) / step)
        if rows >= len(time):
            return np.asarray(ticks)
        begin, step = _steady(time[:rows], ticks)
        rows *= 2


def _steady(time: Array, ticks: Array) -> tuple[float, float]:
    """Begin and period [s] of the clock that ticks so, by least squares."""
    step, begin = np.polyfit(ticks, time - time[0], 1).tolist()
    return float(time[0]) + begin, step


def _roughness(time: Array, channels: list[Array]) -> float:
    """Mean logarithm of how far samples lie from the cubic through the two before and the two behind them."""
    found = []
    for values in channels:
        ok = np.isfinite(values)
        t, y = time[ok], values[ok]
        around = [slice(0, -4), slice(1, -3), slice(3, -1), slice(4, None)]
        middle, foretold = t[2:-2], np.zeros(len(t) - 4)
        with np.errstate(divide="ignore", invalid="ignore"):
            for one in around:
                weight = np.ones(len(t) - 4)
                for other in around:
                    if other is not one:
                        weight *= (middle - t[other]) / (t[one] - t[other])
                foretold += weight * y[one]
        off = np.abs(y[2:-2] - foretold)
        moving = off[np.isfinite(off) & (off > 0.0)]
        if len(moving):
            found.append(float(np.log(np.median(moving))))
    return float(np.mean(found)) if found else 0.0
