"""Sheets to print, true to scale: the mouse's tag, those of its markers, the floor's, and the board for the camera."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from nermo_track.calibrate import COLUMNS, ROWS, SQUARE, board
from nermo_track.errors import TrackError
from nermo_track.layout import DICTIONARY, FAMILY, MODULES, Layout, Tag

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PAGE = (297.0, 210.0)
"""[mm] A4, lying."""
SHARP = 300.0
"""Dots per inch of a picture; a PDF's squares have edges of their own."""
DOTS = 56
"""Of a square of the board along its edge: then each of its tag's modules has five, and every edge is exact."""
KINDS = ("mouse", "markers", "floor", "board")
SLOT = 62.0
"""[mm] Least way from one card to the next, for the words below it."""


def write_sheets(out: Path, kinds: Sequence[str], layout: Layout) -> None:
    """Write a page for each kind (`KINDS`): a PDF of several pages, or a PNG of one.

    Of several kinds the markers' page is left out where a layout has none.

    Raises:
        TrackError: the file's ending or number of pages does not go, the tags do not fit the page, or it cannot be
            written.
    """
    from matplotlib.backends.backend_pdf import PdfPages

    if out.suffix not in (".pdf", ".png"):
        raise TrackError(f"--out: {out} must end in .pdf or .png")
    if out.suffix == ".png" and len(kinds) > 1:
        raise TrackError(f"--out: a .png holds one page; give .pdf, or --what {' or '.join(KINDS)}")
    glued = [(place, tag) for place, tags in layout.markers.items() for tag in tags]
    if not glued and list(kinds) == ["markers"]:
        raise TrackError("--what markers: the layout (--tags) has no markers")
    draw: dict[str, Callable[[Axes], None]] = {
        "mouse": lambda axes: _cards(axes, [("base_link", tag) for tag in layout.mouse]),
        "markers": lambda axes: _cards(axes, glued),
        "floor": lambda axes: _floor(axes, layout),
        "board": _board,
    }
    pages = [_page(draw[kind]) for kind in kinds if glued or kind != "markers"]
    try:
        if out.suffix == ".png":
            pages[0].savefig(out, dpi=SHARP)
            return
        with PdfPages(out) as pdf:
            for page in pages:
                pdf.savefig(page)
    except OSError as error:
        raise TrackError(f"{out} cannot be written: {error.strerror}") from error


def _page(draw: Callable[[Axes], None]) -> Figure:
    """A page in millimetres, with a line by which the print's scale is checked."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(PAGE[0] / 25.4, PAGE[1] / 25.4))
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set_axis_off()
    draw(axes)
    axes.plot([-50.0, 50.0], [-98.0, -98.0], color="black", linewidth=0.6)
    for end in (-50.0, 50.0):
        axes.plot([end, end], [-99.0, -97.0], color="black", linewidth=0.6)
    _say(axes, 0.0, -96.5, f"100 mm when printed at 100 % (no fit to page) - {FAMILY}")
    # Pictures move the limits to themselves.
    axes.set(xlim=(-PAGE[0] / 2, PAGE[0] / 2), ylim=(-PAGE[1] / 2, PAGE[1] / 2), aspect="equal")
    return figure


def _say(axes: Axes, x: float, y: float, text: str) -> None:
    axes.text(x, y, text, ha="center", va="bottom", fontsize=7, color="0.3")


def _tag(axes: Axes, tag: Tag, x: float, y: float) -> None:
    """One tag with its middle at x, y [mm], upright."""
    half = 500.0 * tag.size
    modules = cv2.aruco.generateImageMarker(DICTIONARY, tag.id, MODULES, borderBits=1)
    axes.imshow(
        modules, cmap="gray", vmin=0, vmax=255, extent=(x - half, x + half, y - half, y + half), interpolation="none"
    )


def _cards(axes: Axes, worn: Sequence[tuple[str, Tag]]) -> None:
    """Tags of the mouse in a row, each with the frame it is glued in and a line to cut along.

    There are two of each, for one gets dirty.
    """
    sizes = [1000.0 * tag.size for _, tag in worn]
    cards = [size * (1.0 + 2.0 / MODULES) for size in sizes]
    slots = [max(card + 12.0, SLOT) for card in cards]
    if sum(slots) > PAGE[0] - 10.0 or 2.0 * max(cards) + 40.0 > PAGE[1] - 20.0:
        raise TrackError(f"the mouse's tags do not fit an A4 page: together {sum(slots):.0f} mm wide")
    x = -sum(slots) / 2
    for (frame, tag), size, card, slot in zip(worn, sizes, cards, slots, strict=True):
        x += slot / 2
        for y in (45.0, -35.0):
            _tag(axes, tag, x, y)
            edge = card / 2
            axes.plot(
                [x - edge, x + edge, x + edge, x - edge, x - edge],
                [y - edge, y - edge, y + edge, y + edge, y - edge],
                color="0.6",
                linewidth=0.3,
                linestyle="--",
            )
            place = ", ".join(f"{1000.0 * number:g}" for number in tag.position)
            _say(axes, x, y - edge - 4.0, f"tag {tag.id}: black square {size:g} mm")
            _say(axes, x, y - edge - 7.5, f"its middle at ({place}) mm of {frame}")
            turned = ", ".join(f"{number:g}" for number in tag.rpy_deg)
            _say(axes, x, y + edge + 1.5, f"roll, pitch, yaw {turned}" if any(tag.rpy_deg) else "to the nose >")
        x += slot / 2


def _floor(axes: Axes, layout: Layout) -> None:
    """Tags of the floor where they lie, the world's origin in the middle of the page."""
    for tag in layout.floor:
        x, y = 1000.0 * tag.position[0], 1000.0 * tag.position[1]
        edge = 500.0 * tag.size * (1.0 + 2.0 / MODULES)
        if any(tag.rpy_deg) or abs(tag.position[2]) > 0.0 or abs(x) + edge > PAGE[0] / 2 or abs(y) + edge > 98.0:
            raise TrackError(f"floor tag {tag.id} does not lie flat and upright within an A4 page about the origin")
        _tag(axes, tag, x, y)
        _say(axes, x, y - edge - 3.0, f"tag {tag.id}, {1000.0 * tag.size:g} mm")
    for dx, dy, name in ((25.0, 0.0, "x"), (0.0, 25.0, "y")):
        axes.annotate("", xy=(dx, dy), xytext=(0.0, 0.0), arrowprops={"arrowstyle": "->", "linewidth": 0.6})
        _say(axes, 1.15 * dx, 1.1 * dy, name)


def _board(axes: Axes) -> None:
    width, height = 1000.0 * SQUARE * COLUMNS, 1000.0 * SQUARE * ROWS
    picture = board().generateImage((COLUMNS * DOTS, ROWS * DOTS), marginSize=0, borderBits=1)
    across, up = width / 2, height / 2
    axes.imshow(
        np.asarray(picture),
        cmap="gray",
        vmin=0,
        vmax=255,
        extent=(-across, across, -up + 6.0, up + 6.0),
        interpolation="none",
    )
    _say(axes, 0.0, -up + 0.5, f"squares of {1000.0 * SQUARE:g} mm; glue it on something flat")
