"""Leg loads of a walking robot beside the truth: errors, contact, and how late a touch-down is noticed."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nermo_description.parameters import LEGS
from nermo_sensors.estimation.consistency import judge

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

BOUNCE = 0.05
"""A contact or a gap between two that is shorter is a bounce, not a step [s]."""
EARLY = 0.05
"""An estimate that is in contact for longer than this before the foot is has not seen that touch-down [s]."""


@dataclass(frozen=True, slots=True)
class LoadTrace:
    """Estimates and truth, one row a tick; arrays are (n, 4) but for `time`."""

    time: Array
    """(n,) [s], evenly spaced."""
    truth: Array
    """Vertical contact force [N]."""
    load: Array
    """[N]"""
    variance: Array
    """[N^2]"""
    contact: Mask

    @property
    def period(self) -> float:
        """[s]"""
        return float(np.median(np.diff(self.time)))


def judge_walk(trace: LoadTrace, threshold: float) -> list[dict[str, Any]]:
    """One row a leg and one for all of them; a foot is in contact above `threshold` [N].

    Touch-down delays count from the truth's crossing of the threshold to the estimate's event; negative is early.
    Raises ValueError where no foot ever touches down.
    """
    touching = trace.truth > threshold
    delays = [touch_down_delays(touching[:, leg], trace.contact[:, leg], trace.period) for leg in range(len(LEGS))]
    if not any(map(len, delays)):
        raise ValueError(f"no foot touches down in {trace.time[-1] - trace.time[0]:.1f} s: nothing to judge")
    rows: list[dict[str, Any]] = []
    parts: list[tuple[str, Any, Array]] = [(leg, np.s_[:, number], delays[number]) for number, leg in enumerate(LEGS)]
    for leg, part, late in (*parts, ("all", np.s_[:], np.concatenate(delays))):
        quality = judge(trace.truth[part].ravel(), trace.load[part].ravel(), trace.variance[part].ravel(), [])
        rows.append(
            {
                "leg": leg,
                "rmse_n": quality.rmse,
                "within_3_sigma": quality.within_3_sigma,
                "nees": quality.nees,
                **_agreement(touching[part], trace.contact[part]),
                **_percentiles(late),
            }
        )
    return rows


def touch_down_delays(truth: Mask, contact: Mask, period: float) -> Array:
    """Of each true touch-down, (steps,) [s]; NaN where the estimate does not notice it before the foot lifts off."""
    steady = steady_contact(truth, period, BOUNCE)
    begins = np.flatnonzero(steady[1:] & ~steady[:-1]) + 1
    ends = np.flatnonzero(~steady[1:] & steady[:-1]) + 1
    early = round(EARLY / period)
    delays = []
    for begin in begins:
        later = ends[ends > begin]
        if later.size == 0 or begin < early:
            continue  # cut off by the end of the recording, or by its start
        window = contact[begin - early : later[0]]
        noticed = np.flatnonzero(window)
        seen = noticed.size > 0 and not window[0]
        delays.append((noticed[0] - early) * period if seen else np.nan)
    return np.array(delays, dtype=np.float64)


def steady_contact(mask: Mask, period: float, bounce: float) -> Mask:
    """Contact (n,) without its shorter gaps than `bounce` [s], then without its shorter stretches."""
    return _without_short(~_without_short(~mask, period, bounce), period, bounce)


def _without_short(mask: Mask, period: float, shortest: float) -> Mask:
    """The mask with its shorter stretches cleared; what touches either end stays."""
    edges = np.flatnonzero(np.diff(mask.astype(np.int8))) + 1
    result = mask.copy()
    for begin, end in itertools.pairwise(edges):
        if mask[begin] and (end - begin) * period < shortest:
            result[begin:end] = False
    return result


def _agreement(truth: Mask, contact: Mask) -> dict[str, float]:
    both = float(np.sum(truth & contact))
    return {"precision": both / max(float(contact.sum()), 1.0), "recall": both / max(float(truth.sum()), 1.0)}


def _percentiles(delays: Array) -> dict[str, Any]:
    noticed = 1e3 * delays[np.isfinite(delays)]
    p50, p99 = np.percentile(noticed, [50.0, 99.0]) if noticed.size else (np.nan, np.nan)
    return {
        "touch_downs": int(delays.size),
        "missed": int(delays.size - noticed.size),
        "delay_ms": {"p50": float(p50), "p99": float(p99)},
    }
