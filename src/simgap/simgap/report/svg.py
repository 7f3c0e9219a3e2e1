"""Vector graphics as text: the few shapes that the report needs, and about how wide a text is."""

from __future__ import annotations

from collections.abc import Iterable
from html import escape

import numpy as np
from numpy.typing import NDArray

from simgap.report.style import INK

Array = NDArray[np.float64]

FONT = 13.0
"""[px] of text; the page scales a drawing down on narrow screens."""

_NARROW, _WIDE = frozenset("ijltfrI.,:;'|!()[]{}/- ·°"), frozenset("mwMW@%—→")


def text_width(text: str, size: float = FONT, bold: bool = False) -> float:
    """About how wide the longest line of a text is [px]: a little more than in the widest usual sans serif."""

    def one(line: str) -> float:
        return sum(0.38 if c in _NARROW else 0.95 if c in _WIDE else 0.72 if c.isupper() else 0.61 for c in line)

    return size * (1.08 if bold else 1.0) * max(map(one, text.split("\n")))


class Drawing:
    """Shapes in pixels, x to the right and y down, in the order in which they are painted.

    Attributes:
        width: [px], and so ``height``; both may be set after drawing.
        name: Unique on a page, for what one shape must find another by.
    """

    def __init__(self, name: str, width: float, height: float) -> None:
        self.name, self.width, self.height = name, width, height
        self._parts: list[str] = []
        self._clips = 0

    def svg(self) -> str:
        """The element, in the page's own type and colours."""
        size = f'viewBox="0 0 {_n(self.width)} {_n(self.height)}" width="{_n(self.width)}" height="{_n(self.height)}"'
        return f'<svg xmlns="http://www.w3.org/2000/svg" role="img" {size}>\n' + "\n".join(self._parts) + "\n</svg>"

    def line(
        self, points: Iterable[tuple[float, float]] | Array, colour: str, width: float = 1.0, dash: str = ""
    ) -> None:
        """A line through points (n, 2); a point that is not finite interrupts it."""
        words, pen = [], "M"
        for x, y in points:
            if np.isfinite(x) and np.isfinite(y):
                words.append(f"{pen}{_n(x)} {_n(y)}")
                pen = "L"
            else:
                pen = "M"
        dashes = f' stroke-dasharray="{dash}"' if dash else ""
        self._add(
            f'<path d="{"".join(words)}" fill="none" stroke="{colour}" stroke-width="{_n(width)}"{dashes} '
            'stroke-linecap="round" stroke-linejoin="round"/>'
        )

    def polygon(self, points: Array, fill: str, edge: str, width: float) -> None:
        """A closed shape with an outline; points (n, 2)."""
        corners = " ".join(f"{_n(x)},{_n(y)}" for x, y in points)
        self._add(
            f'<polygon points="{corners}" fill="{fill}" stroke="{edge}" stroke-width="{_n(width)}" '
            'stroke-linejoin="round"/>'
        )

    def rect(self, left: float, top: float, width: float, height: float, fill: str) -> None:
        self._add(f'<rect x="{_n(left)}" y="{_n(top)}" width="{_n(width)}" height="{_n(height)}" fill="{fill}"/>')

    def dot(self, x: float, y: float, radius: float, fill: str, opacity: float = 1.0) -> None:
        faint = f' fill-opacity="{_n(opacity)}"' if opacity < 1.0 else ""
        self._add(f'<circle cx="{_n(x)}" cy="{_n(y)}" r="{_n(radius)}" fill="{fill}"{faint}/>')

    def text(
        self,
        x: float,
        y: float,
        text: str,
        *,
        anchor: str = "start",
        size: float = FONT,
        fill: str = INK,
        bold: bool = False,
        turn: float = 0.0,
    ) -> None:
        """A text whose middle is at height ``y``; lines stand below one another.

        anchor: start, middle or end of the text is at ``x``. turn: about (x, y), clockwise [deg].
        """
        lines = text.split("\n")
        first = y + 0.35 * size - 0.5 * 1.25 * size * (len(lines) - 1)
        weight = ' font-weight="600"' if bold else ""
        turned = f' transform="rotate({_n(turn)} {_n(x)} {_n(y)})"' if turn else ""
        for i, line in enumerate(lines):
            self._add(
                f'<text x="{_n(x)}" y="{_n(first + 1.25 * size * i)}" text-anchor="{anchor}" font-size="{_n(size)}" '
                f'fill="{fill}"{weight}{turned}>{escape(line)}</text>'
            )

    def clip(self, left: float, top: float, width: float, height: float) -> None:
        """Until ``unclip``, show only what lies in this rectangle."""
        self._clips += 1
        name = f"{self.name}-{self._clips}"
        self._add(f'<clipPath id="{name}">')
        self.rect(left, top, width, height, "none")
        self._add(f'</clipPath><g clip-path="url(#{name})">')

    def unclip(self) -> None:
        self._add("</g>")

    def _add(self, part: str) -> None:
        self._parts.append(part)


def _n(value: float) -> str:
    """A number with what a screen can show of it."""
    return f"{value:.2f}".rstrip("0").rstrip(".") if value % 1 else f"{value:.0f}"
