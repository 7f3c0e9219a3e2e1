"""Colours and type of the report. Blue and orange, and one scale from pale to dark: safe for the colour-blind."""

from __future__ import annotations

import io

import matplotlib
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure

INK, QUIET, LINE = "#1f2a33", "#8a949c", "#e3e7ea"
BEFORE, AFTER, MEASURED = "#c8641b", "#1f6aa5", "#cfd6db"
UNSEEN = "#dfe4e8"
HEAT = LinearSegmentedColormap.from_list("gap", ["#f4f1ea", "#f3d9a4", "#e8a04c", "#b9561b", "#6d2709"])
COOL = LinearSegmentedColormap.from_list("angle", ["#123a5c", "#3f7cad", "#a9c8de", "#f2f5f7"])

matplotlib.rcParams["svg.fonttype"] = "none"


def svg(figure: Figure) -> str:
    """A figure as an SVG element, without the XML head, with the page's own type."""
    buffer = io.StringIO()
    with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": "simgap"}):
        figure.savefig(buffer, format="svg", transparent=True, metadata={"Date": None})
    text = buffer.getvalue()
    return text[text.index("<svg") :].replace("font: ", "font-family: inherit; font: ")


def calm(axes: Axes, grid: str = "") -> None:
    """No frame, quiet ticks, a grid only where it helps."""
    for side in ("top", "right", "left", "bottom"):
        axes.spines[side].set_visible(False)
    axes.tick_params(length=0, labelsize=9, labelcolor=INK)
    if grid:
        axes.grid(axis=grid, color=LINE, linewidth=0.8)  # type: ignore[arg-type]
        axes.set_axisbelow(True)
