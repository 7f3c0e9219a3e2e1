"""The mouse's way over the floor out of its outline: where it is, where its nose points, and how it goes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from nermo_track.errors import TrackError
from nermo_track.faults import LEAST_POSES, longest_gap, outliers
from nermo_track.silhouette import Outlines, Sight

Array = NDArray[np.float64]

WINDOW = 0.8
"""[s] Over which a way is smoothed. Chosen by the bench: over 0.5 s a speed is off by 7 mm/s (legs that swing move the
outline's middle), over 0.8 s by 2, over 1.5 s by 1."""
BEGINNING = 0.5
"""[s] Whose mean heading is the line that drift is counted from: begin in the stand."""
BEND = np.radians(1.0)
"""[rad] Standard deviation of the outline's long axis from base_link's heading, since a walk bends the body: as the
bench measures it. No residual shows it."""
LEAST_IN_WINDOW = 5
"""Pictures; fewer tell no parabola and what is left of it."""
ODD_AREA = 0.35
"""Share by which an outline's area may differ from its usual: a leg is 0.1, a hand that touches the mouse more."""
GAP = 0.5
"""[s] Without an outline from which on the mouse may have turned round unseen."""
LEAST_WAY = 0.5
"""Of its length that the mouse must go, so that the floor's median is without it."""
SURE_TAIL = 0.6
"""Excess of pictures whose thin parts lie to one side, from which on that is the tail."""
LEAST_TAIL = 0.02
"""Of its length by which thin parts pull the outline's middle, below which they are no tail: two legs do as much."""
SURE_WAY = 0.25
"""Of its length that the mouse must go along its axis to tell by it where its nose is."""


@dataclass(frozen=True)
class Unseen:
    """Pictures without a place, and why."""

    pictures: int
    nothing: int
    cut: int
    several: int
    odd: int
    """The outline is another's, or only a part."""
    jump: int
    """It is far from where it was before and after."""
    longest: float
    """[s] The longest time without one."""

    @property
    def count(self) -> int:
        """How many."""
        return self.nothing + self.cut + self.several + self.odd + self.jump

    def sentence(self) -> str:
        """What is missing."""
        return (
            f"the mouse is seen in {self.pictures - self.count} of {self.pictures} pictures ({self.nothing} without "
            f"it, {self.cut} with it cut by the edge, {self.several} with something else that moves, {self.odd} whose "
            f"outline has another size, {self.jump} far from their neighbours: "
            f"{100.0 * self.count / self.pictures:.1f} % missing, for {self.longest:.2f} s at the longest)"
        )


@dataclass(frozen=True)
class Way:
    """How the mouse goes, smoothed over a window; of the pictures in which it is seen."""

    time: Array
    """(n,) [s] Middle of the exposure, in the film's own time."""
    position: Array
    """(n, 2) [m] Of the middle of the body's outline."""
    heading: Array
    """(n,) [rad] Of its long axis towards the nose, from the plane's x, without jumps at half a turn."""
    speed: Array
    """(n,) [m/s] Along the heading."""
    sideways: Array
    """(n,) [m/s] To the left of it."""
    drift: Array
    """(n,) [m] To the left of the line along the first heading through the first place."""
    deviation: Array
    """(n, 6) Standard deviations of x, y [m], heading [rad], speed, sideways [m/s] and drift [m]."""
    first_heading: float
    """[rad] Mean over the beginning."""
    nose_by: str
    """`tail` or `way`: what told which end of the long axis is the nose."""
    length: float
    """[m] Of the body's outline, median."""
    scale_deviation: float
    """Share of all lengths by which they may be off together; it is in the deviations of speeds and drift."""
    unseen: Unseen

    def table(self) -> Array:
        """(n, 13) Time, place, heading, speeds and drift, and their standard deviations, in the order of the fields."""
        seen = [self.time, self.position, self.heading, self.speed, self.sideways, self.drift, self.deviation]
        return np.column_stack(seen)

    @property
    def along(self) -> float:
        """[m] How far the last place is from the first one, along the first heading."""
        return float((self.position[-1] - self.position[0]) @ _axes(self.first_heading)[0])

    @property
    def mean_speed(self) -> float:
        """[m/s] Along the first heading from the first place to the last, stands included."""
        return self.along / float(self.time[-1] - self.time[0])

    @property
    def mean_speed_deviation(self) -> float:
        """[m/s]"""
        span = float(self.time[-1] - self.time[0])
        ends = float(np.hypot(*np.linalg.norm(self.deviation[[0, -1], :2], axis=1))) / span
        return float(np.hypot(ends, self.scale_deviation * self.mean_speed))


def way(
    found: Outlines,
    name: str,
    *,
    exposure: float = 0.0,
    line_delay: float = 0.0,
    scale_deviation: float = 0.0,
    window: float = WINDOW,
    still: bool = False,
) -> Way:
    """The way of a mouse.

    Args:
        found: Its outlines.
        name: Of the film, for errors.
        exposure: [s] For which a row is exposed.
        line_delay: [s] From one row's exposure to the next one's.
        scale_deviation: Share by which lengths may be off together.
        window: [s] Over which it is smoothed.
        still: It may stand still all the time: the floor is known without it.

    Raises:
        TrackError: nothing moves, several things do, or nothing tells where the nose is.
    """
    whole = found.sight == Sight.WHOLE
    _refuse(found, whole, name)
    usual = float(np.median(found.area[whole]))
    odd = whole & (np.abs(found.area - usual) > ODD_AREA * usual)
    rows = np.flatnonzero(whole & ~odd)
    if len(rows) < LEAST_POSES:
        raise TrackError(
            f"{name}: the outline of what moves has another size in each picture; light the floor evenly, keep hands "
            "and shadows out, or give the floor without the mouse (--floor)"
        )
    turned = 0.5 * np.unwrap(2.0 * found.axis[rows])
    alone = _jumps(found.time[rows], found.middle[rows], turned)
    rows, turned = rows[~alone], turned[~alone]
    length, middle = float(np.median(found.length[rows])), found.middle[rows]
    gone = float(np.linalg.norm(middle - middle[0], axis=1).max())
    if gone < LEAST_WAY * length and not still:
        raise TrackError(
            f"{name}: what moves goes {1e3 * gone:.0f} mm, less than half its length of {1e3 * length:.0f} mm, so the "
            "floor beneath it is never seen; let the mouse walk, or give the floor without it (--floor)"
        )
    thin = found.thin[rows] * np.sign(np.cos(turned - found.axis[rows]))  # along the axis as it goes on
    heading, nose_by = _with_nose(found.time[rows], middle, turned, thin, length, name)
    time = found.time[rows] + 0.5 * exposure + line_delay * found.row[rows]
    value, slope, value_sd, slope_sd, fits = smooth(time, np.column_stack([middle, heading]), window)
    if fits.sum() < LEAST_POSES:
        raise TrackError(
            f"{name}: only {fits.sum()} pictures have {LEAST_IN_WINDOW} others within {window:g} s (--window); "
            "film at a higher rate, or smooth over more"
        )
    counts = {kind: int((found.sight == kind).sum()) for kind in Sight}
    unseen = Unseen(
        pictures=len(found.time),
        nothing=counts[Sight.NOTHING],
        cut=counts[Sight.CUT],
        several=counts[Sight.SEVERAL],
        odd=int(odd.sum()),
        jump=int(alone.sum()) + int((~fits).sum()),
        longest=longest_gap(found.time, rows[fits]),
    )
    begin = time - time[0] <= BEGINNING
    first = float(np.mean(heading[begin]))
    place, nose = value[fits, :2], value[fits, 2]
    ahead, left = _axes(nose)
    speed, sideways = np.sum(slope[fits, :2] * ahead, axis=1), np.sum(slope[fits, :2] * left, axis=1)
    relative = place - place[0]
    along, drift = (relative @ axis for axis in _axes(first))
    noise, slow = value_sd[fits], slope_sd[fits, :2].max(axis=1)
    across = np.hypot(noise[:, :2].max(axis=1), noise[0, :2].max())
    deviation = np.column_stack(
        [
            noise[:, :2],
            np.hypot(noise[:, 2], BEND),
            np.sqrt(slow**2 + (scale_deviation * speed) ** 2 + (sideways * noise[:, 2]) ** 2),
            np.sqrt(slow**2 + (scale_deviation * sideways) ** 2 + (speed * noise[:, 2]) ** 2),
            np.sqrt(across**2 + (scale_deviation * drift) ** 2 + (along * noise[0, 2]) ** 2),
        ]
    )
    return Way(
        time[fits],
        place,
        nose,
        speed,
        sideways,
        np.asarray(drift, dtype=np.float64),
        deviation,
        first,
        nose_by,
        length,
        scale_deviation,
        unseen,
    )


def _axes(heading: Array | float) -> tuple[Array, Array]:
    """Unit vectors (..., 2) ahead and to the left."""
    ahead = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    return ahead, np.stack([-ahead[..., 1], ahead[..., 0]], axis=-1)


def _refuse(found: Outlines, whole: NDArray[np.bool_], name: str) -> None:
    """Raises TrackError where too few pictures show one thing that moves."""
    several = int((found.sight == Sight.SEVERAL).sum())
    if several > whole.sum():
        raise TrackError(
            f"{name}: several things move in {several} of {len(whole)} pictures; keep hands, cables and shadows out. "
            "A mouse that stands in one place for half of the film is taken for floor: give the floor without it "
            "(--floor)"
        )
    cut = int((found.sight == Sight.CUT).sum())
    if whole.sum() < LEAST_POSES and cut > whole.sum():
        raise TrackError(
            f"{name}: what moves is cut by the picture's edge in {cut} of {len(whole)} pictures; film from farther off"
        )
    if whole.sum() < LEAST_POSES:
        raise TrackError(
            f"{name}: nothing as large as a mouse moves (in {whole.sum()} of {len(whole)} pictures; needed: "
            f"{LEAST_POSES}); film a walk from above, with a floor of another brightness than the mouse"
        )


def _jumps(time: Array, middle: Array, turned: Array) -> NDArray[np.bool_]:
    """(n,) Which places stand alone, judged as poses are."""
    noise = [1.4826 * float(np.median(np.abs(np.diff(values, n=2)))) for values in (*middle.T, turned)]
    spread = np.diag([*noise[:2], 1e-9, 1e-9, 1e-9, noise[2]]) ** 2
    place = np.column_stack([middle, np.zeros(len(time))])
    return outliers(time, place, Rotation.from_euler("z", turned[:, None]), np.tile(spread, (len(time), 1, 1)))


def _with_nose(time: Array, middle: Array, turned: Array, thin: Array, length: float, name: str) -> tuple[Array, str]:
    """Heading (n,) [rad] of axes ``turned`` (n,) that go on without jumps but for gaps, and what told the nose.

    In each stretch without a long gap a tail tells it, or else the way; a stretch in which neither does goes on as the
    one before it.
    """
    starts = np.flatnonzero(np.diff(time, prepend=-np.inf) > GAP)
    heading, told = turned.copy(), ["" for _ in starts]
    stretches = [slice(begin, end) for begin, end in zip(starts, [*starts[1:], len(time)], strict=True)]
    for number, rows in enumerate(stretches):
        sense, told[number] = _sense(middle[rows], turned[rows], thin[rows], length)
        heading[rows] += np.pi * (sense < 0)
    known = [number for number, by in enumerate(told) if by]
    if not known:
        raise TrackError(
            f"{name}: neither a tail nor its way along its axis tells which end of the mouse is its nose; let it walk "
            f"ahead by {1e3 * SURE_WAY * length:.0f} mm and more"
        )
    order = [*range(known[0] + 1, len(stretches)), *range(known[0] - 1, -1, -1)]
    for number in order:
        rows, after = stretches[number], number > known[0]
        near = heading[stretches[number - 1]][-1] if after else heading[stretches[number + 1]][0]
        here = heading[rows][0 if after else -1]
        turn = 2.0 * np.pi if told[number] else np.pi
        heading[rows] += turn * np.round((near - here) / turn)
    return heading, told[known[0]]


def _sense(middle: Array, turned: Array, thin: Array, length: float) -> tuple[int, str]:
    """1 where the axis of a stretch points to the nose and -1 where to the tail, and what tells so; 0 and empty."""
    tail = -float(np.mean(np.sign(thin)))
    if abs(tail) > SURE_TAIL and float(np.median(np.abs(thin))) > LEAST_TAIL * length:
        return (1 if tail > 0.0 else -1), "tail"
    gone = float(np.sum(np.diff(middle, axis=0) * _axes(turned[:-1])[0]))
    if abs(gone) > SURE_WAY * length:
        return (1 if gone > 0.0 else -1), "way"
    return 0, ""


def smooth(time: Array, values: Array, window: float) -> tuple[Array, Array, Array, Array, NDArray[np.bool_]]:
    """A parabola through each picture's neighbours: its value and slope there (n, k), their standard deviations (n, k).

    The last tells (n,) where there are neighbours enough. What the parabolas leave, in the median, is the noise; it
    counts for fewer pictures than there are by how much neighbours' residuals are alike.
    """
    count, kinds = values.shape
    value, slope = np.full((2, count, kinds), np.nan)
    leverage, gain = np.full((2, count), np.nan)
    low, high = np.searchsorted(time, time - 0.5 * window), np.searchsorted(time, time + 0.5 * window, side="right")
    fits = high - low >= LEAST_IN_WINDOW
    for row in np.flatnonzero(fits):
        part = slice(low[row], high[row])
        past = time[part] - time[row]
        inverse = np.linalg.pinv(np.stack([np.ones_like(past), past, past**2], axis=1))
        value[row], slope[row] = inverse[:2] @ values[part]
        leverage[row], gain[row] = np.sum(inverse[:2] ** 2, axis=1)
    left = (values - value)[fits] / np.sqrt(np.maximum(1.0 - leverage[fits], 1e-3))[:, None]
    noise = 1.4826 * np.median(np.abs(left), axis=0)
    alike = np.array([_alike(column) for column in left.T])
    spread = noise * np.sqrt((1.0 + alike) / (1.0 - alike))
    return value, slope, np.sqrt(leverage)[:, None] * spread, np.sqrt(gain)[:, None] * spread, fits


def _alike(left: Array) -> float:
    """Correlation of a residual with the next one's, 0 to 0.9."""
    whole = float(np.sum(left**2))
    return float(np.clip(np.sum(left[1:] * left[:-1]) / whole, 0.0, 0.9)) if whole > 0.0 else 0.0
