"""What each run says about the causes that were found in all of them together, as a figure."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from simgap.report.plot import AXIS, SMALL, WIDTH, Panel, framed, names_width
from simgap.report.style import AFTER, BEFORE
from simgap.report.svg import Drawing, text_width

Array = NDArray[np.float64]
Report = dict[str, Any]

_NUMBERS, _RUNS = 12, 16
"""Panels, and runs in each, at most: numbers that runs agree about least, runs furthest off."""
_BESIDE, _APART, _ROW, _TITLE = 3, 26.0, 22.0, 26.0
"""Panels side by side, the room between them, that of a run, and that of what stands over a panel [px]."""
_REACH = 3.0
"""How far an interval is drawn, in median intervals: one that says nothing must not hide those that do."""


def runs(report: Report) -> Drawing | None:
    """One panel for each number that was found, in it each run's value and 90 % interval; None without.

    Of fewer than two runs the parts are halves of the recording. The dashed line is their weighted mean. Where runs
    disagree (``analysis/agreement.py``) the odd one is orange.
    """
    found = report.get("agreement")
    if not found:
        return None
    rows = sorted(found["rows"], key=lambda row: float(row["p"]))[:_NUMBERS]
    names = sorted(_furthest(found["rows"], found["parts"]), key=found["parts"].index)
    left = names_width(names)
    wide = (WIDTH - left - (_BESIDE - 1) * _APART - 12.0) / _BESIDE
    tall = _ROW * len(names)
    line = _TITLE + tall + AXIS
    drawing = Drawing("runs", WIDTH, line * -(-len(rows) // _BESIDE))
    for i, row in enumerate(rows):
        top = _TITLE + line * (i // _BESIDE)
        place = (left + (i % _BESIDE) * (wide + _APART), top, wide, tall)
        panel = _panel(drawing, place, row, names, odd=row["p"] < found["disagree_below"])
        what = f"{row['effect'].partition('@')[0]}, {row['parameter']}".replace("_", " ")
        title = f"{what} (p = {row['p']:.2g})"
        drawing.text(place[0], top - 13.0, title, size=min(SMALL, SMALL * wide / text_width(title, SMALL)))
        if i % _BESIDE == 0:
            panel.names(names)
    return drawing


def _furthest(rows: list[dict[str, Any]], parts: list[str]) -> list[str]:
    """The parts that are furthest from the mean of any number, in its half intervals."""
    off = {part: max(_off(row, row["by_part"][part]) for row in rows) for part in parts}
    return sorted(parts, key=lambda part: -off[part])[:_RUNS]


def _off(row: dict[str, Any], said: dict[str, Any]) -> float:
    low, high = said["ci90"]
    return abs(float(said["value"]) - float(row["mean"])) / max(0.5 * (high - low), 1e-300)


def _panel(
    drawing: Drawing, place: tuple[float, float, float, float], row: dict[str, Any], names: list[str], odd: bool
) -> Panel:
    said = [row["by_part"][name] for name in names]
    value = np.array([s["value"] for s in said])
    low, high = np.array([s["ci90"] for s in said]).T
    typical = float(np.median(high - low))
    low, high = np.maximum(low, value - _REACH * typical), np.minimum(high, value + _REACH * typical)
    panel = Panel(drawing, place, framed(np.concatenate([low, high, [row["mean"]]])), (len(names) - 0.5, -0.5))
    panel.x_axis("" if row["unit"] in ("", "1") else f"[{row['unit']}]")
    for i, name in enumerate(names):
        colour = BEFORE if odd and name == row["odd"] else AFTER
        panel.stroke((float(low[i]), i), (float(high[i]), i), colour, 2.5)
        panel.dot(float(value[i]), i, colour, 4.5)
    panel.upright(float(row["mean"]), dashed=True)
    return panel
