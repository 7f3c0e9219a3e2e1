"""Signal paths: commands on their way in, what sensors say on its way out, and measurements traced back."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from simgap.data.align import Aligned
from simgap.data.plant import euler_angles
from simgap.simulation.lateness import Lateness
from simgap.simulation.variant import InputPath, OutputPath, Variant

Array = NDArray[np.float64]


def shape_inputs(aligned: Aligned, paths: Sequence[InputPath]) -> Array:
    """Inputs (npath, n, ni) after scale, offset, link, range, play and rate limit; delays act between samples."""
    scale, offset, rate, play = (
        np.stack([getattr(p, n) for p in paths]) for n in ("scale", "offset", "rate_limit", "play")
    )
    low, high = np.stack([p.low for p in paths]), np.stack([p.high for p in paths])
    u = aligned.inputs[None] * scale[:, None] + offset[:, None]
    late = np.stack([(p.loss > 0) | (p.jitter > 0) for p in paths])
    for which, channel in np.argwhere(late):
        for run in aligned.runs:
            part = slice(run.start, run.stop)
            u[which, part, channel] = _expected(u[which, part, channel], paths[which], int(channel), aligned.period)
    for i, path in enumerate(paths):
        if path.added is not None:
            u[i] += path.added
    u = np.clip(u, low[:, None], high[:, None])
    slow = np.flatnonzero((np.isfinite(rate) | (play > 0)).any(axis=1))
    if len(slow):
        u[slow] = _remember(u[slow], aligned, rate[slow] * aligned.period, 0.5 * play[slow])
    return u


def _expected(u: Array, path: InputPath, channel: int, period: float) -> Array:
    """The command (n,) that acts on average over a link that loses updates or delays them unevenly."""
    update = float(path.update[channel])
    law = Lateness(float(path.loss[channel]), float(path.jitter[channel]) / update)
    return law.moments(u, max(round(update / period), 1))[0]


def _remember(u: Array, aligned: Aligned, step: Array, half_play: Array) -> Array:
    """The two operators with a memory, in this order: play, rate limit; (npath, n, ni)."""
    out = np.empty_like(u)
    for run in aligned.runs:
        centre = u[:, run.start].copy()
        value = centre.copy()
        for k in range(run.start, run.stop):
            centre = np.clip(centre, u[:, k] - half_play, u[:, k] + half_play)
            before, value = value, np.clip(centre, value - step, value + step)
            # A limited servo turns all through the period: what acts is the mean of its way.
            way = value - before
            out[:, k] = value - 0.5 * way * np.abs(way) / np.maximum(step, np.finfo(float).tiny)
    return out


def inverse_outputs(aligned: Aligned, path: OutputPath) -> Array:
    """What the sensors would have to have seen for the recorded outputs to come out of ``path``, (n, no).

    Of a filter only its lateness is taken back: to undo it would blow up the noise.
    """
    y, late = (aligned.outputs - path.bias) / path.scale, path.late
    for i in np.flatnonzero(late):
        for run in aligned.runs:
            rows = np.arange(run.start, run.stop)
            y[rows, i] = np.interp(rows + late[i] / aligned.period, rows, y[rows, i])
    result: Array = y
    return result


def filtered(series: Array, steps: Array) -> Array:
    """Series (n, k) behind filters of first order, which lag by so many steps (n,); they begin at rest."""
    keep = steps / (1.0 + steps)
    found = np.empty_like(series)
    value = found[:, 0] = series[:, 0]
    for k in range(1, series.shape[1]):
        value = found[:, k] = series[:, k] + keep * (value - series[:, k])
    return found


def read_outputs(history: Array, variants: Sequence[Variant], times: Array, dt: float) -> Array:
    """Outputs (n, ns, no) ``times`` [s] after the first step, through each variant's output path.

    ``history`` (n, steps, nsensordata): what the sensors of each simulation, one of ``variants``, said step by step.
    """
    (n, steps, _), channels = history.shape, variants[0].plant.outputs
    out = np.empty((n, len(times), len(channels)))
    delay = np.array([v.outputs.delay - v.outputs.lead for v in variants])
    lag = np.array([v.outputs.lag for v in variants])
    sims = np.arange(n)[:, None]
    for i, channel in enumerate(channels):
        at = np.clip((times[None, :] - delay[:, i : i + 1]) / dt, 0.0, steps - 1.0)
        low = np.minimum(at.astype(np.int64), steps - 2)
        share = at - low
        if channel.euler >= 0:
            quaternion = history[:, :, channel.address : channel.address + 4]
            series = np.unwrap(euler_angles(quaternion)[..., channel.euler], axis=1)
        else:
            series = history[:, :, channel.address]
        if lag[:, i].any():
            series = filtered(series, lag[:, i] / dt)
        out[:, :, i] = series[sims, low] * (1.0 - share) + series[sims, low + 1] * share
    for j, variant in enumerate(variants):
        for (x, y, z), turn in variant.outputs.turns:
            out[j][:, [x, y, z]] = out[j][:, [x, y, z]] @ turn.T
    scale = np.array([v.outputs.scale for v in variants])[:, None, :]
    bias = np.array([v.outputs.bias for v in variants])[:, None, :]
    limit = np.array([v.outputs.limit for v in variants])[:, None, :]
    result: Array = np.clip(out * scale + bias, -limit, limit)
    return result
