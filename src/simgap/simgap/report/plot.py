"""Plots out of shapes: scales with round ticks, panels with axes, maps of coloured cells, a legend."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simgap.report.style import INK, LINE, ink_on
from simgap.report.svg import FONT, Drawing, text_width

Array = NDArray[np.float64]

WIDTH = 900.0
"""[px] of a drawing."""
SMALL = 12.0
"""[px] of ticks and of the text in cells."""
ROW = 31.0
"""[px] from one row of names to the next."""
AXIS = 46.0
"""[px] that ticks and the label of the axis below a panel take."""
TOP, LEGEND = 6.0, 30.0
"""[px] above a panel, without and with a legend."""


@dataclass(frozen=True)
class Scale:
    """From values, ``low`` to ``high``, to pixels, ``begin`` to ``end``."""

    low: float
    high: float
    begin: float
    end: float
    logarithmic: bool = False

    def __call__(self, value: float) -> float:
        return float(self.all(np.array([value], float))[0])

    def all(self, values: Array) -> Array:
        """Pixels of many values."""
        low, high = self.low, self.high
        if self.logarithmic:
            with np.errstate(divide="ignore", invalid="ignore"):
                values, low, high = np.log(values), math.log(low), math.log(high)
        return self.begin + (self.end - self.begin) * (values - low) / (high - low)

    def ticks(self, most: int) -> list[tuple[float, str]]:
        """At most ``most`` round values with their texts."""
        values = _decades(self.low, self.high, most) if self.logarithmic else _round(self.low, self.high, most)
        return list(zip(values, number_texts(values), strict=True))


def number_texts(values: Sequence[float]) -> list[str]:
    """Numbers of one axis, with the digits that tell them apart and no more."""
    largest = max((abs(v) for v in values), default=0.0)
    if largest and not 1e-3 <= largest < 1e5:
        power = math.floor(math.log10(largest))
        raised = str(power).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
        return [f"{_plain(v / 10.0**power)}·10{raised}" if v else "0" for v in values]
    return [_plain(v) for v in values]


def _plain(value: float) -> str:
    return f"{value:.6g}".replace("-", "−") if value else "0"


def _round(low: float, high: float, most: int) -> list[float]:
    """Multiples of 1, 2 or 5 times a power of ten."""
    rough = (high - low) / max(most, 1)
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(m * power for m in (1, 2, 5, 10) if m * power >= rough * (1 - 1e-9))
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return [float(f"{k * step:.12g}") for k in range(first, last + 1)]


def _decades(low: float, high: float, most: int) -> list[float]:
    """1, 2 and 5 of each power of ten, or fewer where there are many."""
    powers = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    every = 1
    for digits in ((1, 2, 5), (1, 3), (1,)):
        found = [float(f"{m}e{p}") for p in powers for m in digits if low <= float(f"{m}e{p}") <= high]
        if len(found) <= most:
            return found
    while len(found[::every]) > most:
        every += 1
    return found[::every]


class Panel:
    """A plot in the rectangle ``left``, ``top``, ``width``, ``height`` [px] of a drawing.

    x, y: (value at the left, at the right), (at the bottom, at the top).
    """

    def __init__(
        self,
        drawing: Drawing,
        place: tuple[float, float, float, float],
        x: tuple[float, float],
        y: tuple[float, float],
        logarithmic: bool = False,
    ) -> None:
        self.drawing = drawing
        self.left, self.top, self.width, self.height = place
        self.x = Scale(*x, self.left, self.left + self.width, logarithmic)
        self.y = Scale(*y, self.top + self.height, self.top)

    def x_axis(self, label: str = "", grid: bool = True, texts: bool = True) -> None:
        """Round ticks, as many as have room, and the label below them."""
        bottom = self.top + self.height
        for value, text in self._fitting(self.x, self.width, lambda t: text_width(t, SMALL) + 14.0):
            if grid:
                self.drawing.line([(self.x(value), self.top), (self.x(value), bottom)], LINE)
            if texts:
                self.drawing.text(self.x(value), bottom + 13.0, text, anchor="middle", size=SMALL)
        if label:
            half = 0.5 * text_width(label, SMALL)
            middle = min(max(self.left + 0.5 * self.width, half), max(self.drawing.width - half, half))
            self.drawing.text(middle, bottom + 33.0, label, anchor="middle", size=SMALL)

    def y_axis(self, label: str = "", grid: bool = True) -> None:
        """Round ticks, as many as have room, and the label upright beside them."""
        for value, text in self._fitting(self.y, self.height, lambda t: 2.0 * SMALL):
            if grid:
                self.drawing.line([(self.left, self.y(value)), (self.left + self.width, self.y(value))], LINE)
            self.drawing.text(self.left - 7.0, self.y(value), text, anchor="end", size=SMALL)
        if label:
            middle = self.top + 0.5 * self.height
            size = min(SMALL, SMALL * (self.height + 24.0) / text_width(label, SMALL))
            self.drawing.text(9.0, middle, label, anchor="middle", size=size, turn=-90.0)

    @staticmethod
    def _fitting(scale: Scale, room: float, need: Callable[[str], float]) -> list[tuple[float, str]]:
        for most in (9, 7, 5, 4, 3):
            ticks = scale.ticks(most)
            if sum(need(text) for _, text in ticks) <= room:
                return ticks
        return scale.ticks(2)

    def names(self, names: Sequence[str], bold: Collection[str] = ()) -> None:
        """Names of the rows, at the heights 0, 1, 2, ..."""
        for i, name in enumerate(names):
            self.drawing.text(self.left - 10.0, self.y(i), name, anchor="end", bold=name in bold)

    def line(self, x: Array, y: Array, colour: str, width: float = 1.5) -> None:
        """A curve, cut at the panel's border."""
        at, height = _thinned(self.x.all(x), self.y.all(y))
        far = 20.0 * self.height  # a run-away simulation must not become a file of digits
        self.drawing.clip(self.left - 3.0, self.top - 3.0, self.width + 6.0, self.height + 6.0)
        self.drawing.line(np.stack([at, np.clip(height, self.top - far, self.top + far)], 1), colour, width)
        self.drawing.unclip()

    def stroke(self, begin: tuple[float, float], end: tuple[float, float], colour: str, width: float = 1.0) -> None:
        """A straight line between two points in values."""
        self.drawing.line([(self.x(x), self.y(y)) for x, y in (begin, end)], colour, width)

    def dot(self, x: float, y: float, colour: str, radius: float = 5.5, opacity: float = 1.0) -> None:
        self.drawing.dot(self.x(x), self.y(y), radius, colour, opacity)

    def bar(self, begin: float, end: float, row: float, colour: str, thick: float = 17.0) -> None:
        """A bar along x at a height."""
        left, right = sorted((self.x(begin), self.x(end)))
        self.drawing.rect(left, self.y(row) - 0.5 * thick, max(right - left, 1.0), thick, colour)

    def note(self, x: float, y: float, text: str, aside: float = 9.0) -> None:
        """A text beside a point: to the right, or with a negative ``aside`` [px] to the left."""
        anchor = "start" if aside > 0 else "end"
        self.drawing.text(self.x(x) + aside, self.y(y), text, anchor=anchor, size=SMALL)

    def upright(self, x: float, dashed: bool = False) -> None:
        """A line from the bottom to the top."""
        ends = [(self.x(x), self.top), (self.x(x), self.top + self.height)]
        self.drawing.line(ends, INK, 1.1, "4 5" if dashed else "")


def rows(
    drawing: Drawing,
    names: Sequence[str],
    place: tuple[float, float],
    x: tuple[float, float],
    *,
    top: float = TOP,
    logarithmic: bool = False,
) -> Panel:
    """A panel with one row a name, the first on top; place: (left, right) [px]."""
    box = (place[0], top, place[1] - place[0], ROW * len(names))
    return Panel(drawing, box, x, (len(names) - 0.5, -0.5), logarithmic)


def names_width(names: Sequence[str], bold: bool = False) -> float:
    """Room that the names beside rows need [px]."""
    return max((text_width(n, FONT, bold) for n in names), default=0.0) + 16.0


def legend(
    drawing: Drawing, left: float, entries: Sequence[tuple[str, str]], dots: bool = False, thick: Sequence[float] = ()
) -> None:
    """Colours and what they mean, in one row at the top from ``left`` on; entries: (text, colour).

    A narrow screen shows the left of a drawing first.
    """
    x = left
    for i, (text, colour) in enumerate(entries):
        if dots:
            drawing.dot(x + 6.0, 10.0, 5.5, colour)
        else:
            drawing.line([(x + 3.0, 10.0), (x + 22.0, 10.0)], colour, thick[i] if thick else 2.0)
        x += 18.0 if dots else 31.0
        drawing.text(x, 10.0, text, size=SMALL)
        x += text_width(text, SMALL) + 18.0


def cells(
    drawing: Drawing,
    place: tuple[float, float, float, float],
    values: Array,
    shares: Array,
    colour: Callable[[float], str],
    text: Callable[[float], str],
) -> None:
    """A map of values (rows, columns), each on the colour of its share (0 to 1); what is not finite stays empty.

    place: left, top, width and height [px].
    """
    wide, high = place[2] / values.shape[1], place[3] / values.shape[0]
    size = min(SMALL, 0.36 * wide)
    for (i, j), value in np.ndenumerate(values):
        if np.isfinite(value):
            share = float(shares[i, j])
            left, above = place[0] + j * wide, place[1] + i * high
            drawing.rect(left + 0.75, above + 0.75, wide - 1.5, high - 1.5, colour(share))
            drawing.text(
                left + 0.5 * wide, above + 0.5 * high, text(value), anchor="middle", size=size, fill=ink_on(share)
            )


def column_room(names: Sequence[str], wide: float) -> float:
    """Height that names below columns of this width need [px]; they are turned where they have no room."""
    longest = max(text_width(n, SMALL) for n in names)
    return 24.0 if longest < wide - 6.0 else 16.0 + 0.65 * longest


def columns(
    drawing: Drawing, left: float, bottom: float, wide: float, names: Sequence[str], bold: Collection[str] = ()
) -> None:
    """Names below columns."""
    turned = column_room(names, wide) > 24.0
    for j, name in enumerate(names):
        x = left + (j + 0.5) * wide
        if turned:
            drawing.text(x + 4.0, bottom + 11.0, name, anchor="end", size=SMALL, bold=name in bold, turn=-40.0)
        else:
            drawing.text(x, bottom + 13.0, name, anchor="middle", size=SMALL, bold=name in bold)


def framed(*series: Array) -> tuple[float, float]:
    """From where to where a panel reaches: by the first of the series, so that no run-away simulation decides it."""
    measured = series[0][np.isfinite(series[0])]
    if not len(measured):
        return 0.0, 1.0
    low, high = float(measured.min()), float(measured.max())
    reach = 1.2 * max(high - low, 1e-9, 1e-6 * abs(high))
    everything = np.concatenate([s[np.isfinite(s)] for s in series])
    return (
        max(float(everything.min()), low - reach) - 0.06 * reach,
        min(float(everything.max()), high + reach) + 0.06 * reach,
    )


def _thinned(x: Array, y: Array) -> tuple[Array, Array]:
    """Of a long curve in pixels, what still shows: the lowest and the highest of each half pixel, and its gaps."""
    if len(x) < 2000:
        return x, y
    group = np.floor(2.0 * np.nan_to_num(x, nan=-1.0)).astype(np.int64)
    edges = np.flatnonzero(np.diff(group) | np.diff(np.isfinite(x + y).astype(np.int64))) + 1
    keep = {0, len(x) - 1}
    for part in np.split(np.arange(len(x)), edges):
        keep |= {int(part[0]), int(part[-1])}
        if len(known := part[np.isfinite(y[part])]):
            keep |= {int(known[y[known].argmin()]), int(known[y[known].argmax()])}
    picked = np.array(sorted(keep))
    return x[picked], y[picked]
