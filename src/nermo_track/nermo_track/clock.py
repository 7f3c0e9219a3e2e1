"""The clock of a film: which time of the recording its first picture is, by how the mouse moved."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from nermo_track.errors import TrackError

Array = NDArray[np.float64]

COARSE = 0.02
"""[s] Step of the first search: a fifth of the shortest thing that a trot's body does (0.1 s)."""
LONGEST_STEP = 0.1
"""[s] Two pictures farther apart say nothing of a motion."""
BLOCKS = 8
"""Parts of a film, or of a recording that is shorter, each left out once (jackknife): what the clock's uncertainty is
taken from. So is each of the six motions: a mouse that is not the twin is earlier than it in one and later in another.
"""
MOTIONS = 6
APART = 0.1
"""[s] From this far on another peak is another clock, and not the same one's side."""
SURE = 4.0
"""Standard errors by which the best clock must beat any other. Chosen: it is the best of thousands."""
LEAST_OVERLAP = 4.0
"""[s] of film and commands together: three strides of a slow trot."""
RATE_FROM = 20.0
"""[s] of film from which on the rate is fitted as well: below, the 100 ppm of a bad crystal are lost in the offset."""
RATE_SURE = 3.0
"""Standard deviations from none, from which on a rate is believed: a mouse that tires is late as well."""
GOES = 0.02, 2.0
"""[m] within [s]: a mouse that gets as far walks, one that sways over its feet does not."""
MOST_WALKED = 0.5
"""Share of the time that it walks, from which on its steps tell the clock. A leg that is off steps at another time in
every stride, and no part of the film says so: of seven hidden mice that walked two were 14 and 18 ms off."""
MOST_RATE = 3e-3
"""Largest share by which a film's clock may be wrong. 29.97 instead of 30 Hz is 1e-3."""


@dataclass(frozen=True)
class Motion:
    """A body's pose against time."""

    time: Array
    """(n,) [s]"""
    position: Array
    """(n, 3) [m]"""
    rotation: Rotation
    """n of them"""

    def between(self, begin: float, end: float) -> Motion:
        """The part from one time [s] to another."""
        part = (self.time >= begin) & (self.time <= end)
        return Motion(self.time[part], self.position[part], self.rotation[part])

    def path(self) -> Array:
        """(n, 6) [m, rad] What the body has gone along its own axes and turned about them, added up."""
        middle = self.rotation[:-1]
        gone = middle.inv().apply(np.diff(self.position, axis=0))
        turned = (middle.inv() * self.rotation[1:]).as_rotvec()
        return np.vstack([np.zeros(6), np.cumsum(np.hstack([gone, turned]), axis=0)])


@dataclass(frozen=True)
class Clock:
    """Recording time = offset + (1 + rate) * film time."""

    offset: float
    """[s]"""
    rate: float
    """Of the recording's clock beyond the film's; 0 where the film is too short to tell."""
    deviation: float
    """[s] Standard deviation in the middle of the film."""
    agreement: float
    """Share of what the mouse did that the commands explain, mean over its six motions."""
    beats: float
    """Standard errors by which it is better than any other clock."""
    overlap: float
    """[s] of film and commands together."""
    walked: float
    """Share of that time in which the mouse was to walk."""

    def warnings(self) -> list[str]:
        """What somebody should know who believes it."""
        if self.walked <= MOST_WALKED:
            return []
        return [
            "steps of a walk tell its clock: where a leg is off it may be wrong by 20 ms and looks as sure; film "
            "squats or steps of the servos too (nermo gap record --film), or fit it to them (--clock-from)"
        ]

    def at(self, time: Array) -> Array:
        """(n,) [s] Recording times of film times."""
        return np.asarray(self.offset + (1.0 + self.rate) * time, dtype=np.float64)


class _Agreement:
    """How well the seen motion fits what is expected, for any clock."""

    def __init__(self, seen: Motion, expected: Motion) -> None:
        step = np.diff(seen.time)
        used = step <= LONGEST_STEP
        self.begin, self.end = seen.time[:-1][used], seen.time[1:][used]
        self.middle = float(np.mean(self.begin))
        """[s] Of the film."""
        self.moved = np.diff(seen.path(), axis=0)[used]
        self._time, self._path = expected.time, expected.path()
        # Of the shorter of the two, so that each has something in it.
        film_is_shorter = np.ptp(seen.time) <= np.ptp(expected.time)
        parts = BLOCKS * np.arange(len(self.begin)) // max(len(self.begin), 1)
        self._block = parts if film_is_shorter else None

    def moments(self, offset: float, rate: float = 0.0) -> Array:
        """(blocks, 6, 6) Per block and motion: count, sums of x, y, xx, yy and xy, where film and commands overlap."""
        begin, end = (offset + (1.0 + rate) * t for t in (self.begin, self.end))
        inside = (begin >= self._time[0]) & (end <= self._time[-1])
        x = np.empty_like(self.moved)
        for axis in range(6):
            column = self._path[:, axis]
            x[:, axis] = np.interp(end, self._time, column) - np.interp(begin, self._time, column)
        y = self.moved
        parts = np.stack([np.ones_like(x), x, y, x * x, y * y, x * y], axis=-1) * inside[:, None, None]
        sums = np.zeros((BLOCKS, 6, 6))
        blocks = self._block
        if blocks is None:
            share = (begin - self._time[0]) / (self._time[-1] - self._time[0])
            blocks = np.clip((BLOCKS * share).astype(np.int64), 0, BLOCKS - 1)
        np.add.at(sums, blocks, parts)
        return sums


def _evidence(sums: Array) -> float:
    """What motions' correlations tell [nats]: how much less is left unexplained by the expected than by nothing.

    A motion that goes against what is expected tells nothing. ``sums`` (motions, 6): as `_Agreement.moments`, a
    block's or several blocks' together.
    """
    return float(-0.5 * sums[0, 0] * np.sum(np.log1p(-np.minimum(_explained(sums), 1.0 - 1e-12))))


def _explained(sums: Array) -> Array:
    """(motions,) Share of each motion's variance that is explained."""
    n, x, y, xx, yy, xy = sums.T
    n = np.maximum(n, 1.0)
    both, one, other = xy - x * y / n, xx - x * x / n, yy - y * y / n
    fine = (one > 1e-18) & (other > 1e-18)
    correlation = np.where(fine, both / np.sqrt(np.where(fine, one * other, 1.0)), 0.0)
    return np.asarray(np.clip(correlation, 0.0, 1.0) ** 2, dtype=np.float64)


def fit_clock(seen: Motion, expected: Motion, name: str) -> Clock:
    """The clock of a film by which the seen motion agrees best with what the commands make a mouse do.

    All offsets are tried at which the two overlap; the best one is refined, and the film's rate with it where it is
    long enough. What is left out at a time (jackknife) gives the uncertainty, and whether another clock would do too.

    Args:
        seen: Of base_link, in the film's time.
        expected: Of base_link in the recording's time.
        name: Of the film, for errors.

    Raises:
        TrackError: the two overlap too little, or the clock cannot be told.
    """
    agreement = _Agreement(seen, expected)
    length = min(float(np.ptp(seen.time)), float(np.ptp(expected.time)))
    if length < LEAST_OVERLAP:
        raise TrackError(f"{name}: film and commands are {length:.1f} s together; needed: {LEAST_OVERLAP:g} s")
    least = max(LEAST_OVERLAP, 0.5 * length)
    offsets = np.arange(
        expected.time[0] - seen.time[-1] + least, expected.time[-1] - seen.time[0] - least + COARSE, COARSE
    )
    tried = [agreement.moments(offset) for offset in offsets]
    scores = np.array([_evidence(sums.sum(axis=0)) for sums in tried])
    best = int(np.argmax(scores))
    offset, rate, deviation = _fitted(agreement, float(offsets[best]), length >= RATE_FROM)
    sums = agreement.moments(offset, rate)
    beats = _beaten(sums, tried, scores, np.abs(offsets - offsets[best]) > APART)
    explained = float(np.mean(_explained(sums.sum(axis=0))))
    overlap = float(sums.sum(axis=0)[0, 0] / max(len(agreement.begin), 1) * np.ptp(seen.time))
    filmed = expected.between(*(offset + (1.0 + rate) * seen.time[[0, -1]]))
    if beats < SURE:
        raise TrackError(
            f"{name}: the film's clock cannot be told: another one is {beats:.2f} standard errors from the best "
            f"(needed: {SURE:.2f}), and the commands explain {100.0 * explained:.0f} % of what is seen; is it a film "
            "of this recording? Film a start and a stop too: a walk that never changes looks alike after each stride"
        )
    return Clock(offset, rate, deviation, explained, beats, overlap, _walked(filmed))


def _walked(motion: Motion) -> float:
    """Share of the time in which a body goes somewhere."""
    far, within = GOES
    later = np.minimum(motion.time + within, motion.time[-1])
    earlier = later - within
    ends = [
        np.column_stack([np.interp(t, motion.time, motion.position[:, k]) for k in (0, 1)]) for t in (earlier, later)
    ]
    return float(np.mean(np.linalg.norm(ends[1] - ends[0], axis=1) > far))


def _fitted(agreement: _Agreement, offset: float, with_rate: bool) -> tuple[float, float, float]:
    """Offset [s], rate, and the standard deviation [s] in the middle of the film, by jackknife."""
    offset, rate = _refined(agreement, offset, 0.0, with_rate)
    blocks = np.array([_refined(agreement, offset, rate, with_rate, block=k) for k in range(BLOCKS)])
    if with_rate and abs(rate) < RATE_SURE * _jackknife(blocks[:, 1]):
        return _fitted(agreement, offset + rate * agreement.middle, False)
    motions = np.array([_refined(agreement, offset, rate, with_rate, motion=k) for k in range(MOTIONS)])
    by_block, by_motion = (
        _jackknife(parts[:, 0] + (1.0 + parts[:, 1]) * agreement.middle) for parts in (blocks, motions)
    )
    return offset, rate, float(np.hypot(by_block, by_motion))


def _jackknife(parts: Array) -> float:
    """Standard deviation of what was fitted, from fits (n,) that each leave one of n parts out."""
    return float(np.sqrt((len(parts) - 1) / len(parts) * np.sum((parts - parts.mean()) ** 2)))


def _refined(
    agreement: _Agreement,
    offset: float,
    rate: float,
    with_rate: bool,
    block: int | None = None,
    motion: int | None = None,
) -> tuple[float, float]:
    """Offset [s] and rate of most evidence near those given, with a block or a motion left out."""
    kept, used = np.arange(BLOCKS) != block, np.arange(MOTIONS) != motion

    def clock(numbers: Array) -> tuple[float, float]:
        slope = float(numbers[1]) * 1e-3 if with_rate else rate
        # The rate turns about the middle of the film, so that the two hardly depend on each other.
        return offset + float(numbers[0]) * COARSE + (rate - slope) * agreement.middle, slope

    def cost(numbers: Array) -> float:
        begin, slope = clock(numbers)
        if abs(slope) > MOST_RATE:
            return 0.0
        return -_evidence(agreement.moments(begin, slope)[kept].sum(axis=0)[used])

    start = np.array([0.0, rate * 1e3]) if with_rate else np.zeros(1)
    simplex = start + np.vstack([np.zeros(len(start)), np.eye(len(start))])
    options = {"xatol": 1e-3, "fatol": 1e-3, "maxiter": 200, "initial_simplex": simplex}
    return clock(minimize(cost, start, method="Nelder-Mead", options=options).x)


def _beaten(best: Array, tried: list[Array], scores: Array, other: NDArray[np.bool_]) -> float:
    """Standard errors by which the best clock's evidence is above the best of the others, block by block."""
    if not other.any():
        return 0.0
    rival = tried[int(np.flatnonzero(other)[np.argmax(scores[other])])]
    gain = np.array([_evidence(sums) for sums in best]) - np.array([_evidence(sums) for sums in rival])
    error = float(np.std(gain, ddof=1)) / np.sqrt(BLOCKS)
    return float(np.mean(gain)) / max(error, 1e-9)
