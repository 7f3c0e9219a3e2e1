"""How far each step of a diagnosis goes: the waterfall, and free runs."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from simgap.report.evidence import Evidence
from simgap.report.figures import frame_to
from simgap.report.sentences import plain
from simgap.report.style import AFTER, BEFORE, INK, LINE, MEASURED, QUIET, calm

Array = NDArray[np.float64]
Report = dict[str, Any]

_WIDTH = 9.0
"""[in]"""
_SHOWN = 20.0
"""[s] of a free run that are drawn."""
_STEPS = {
    "nominal": "nominal model",
    "recalibrated": "its numbers moved within tolerances",
    "remainder": "what remains",
}


def waterfall(report: Report) -> Figure | None:
    """From the nominal model to what remains: held-out gap on the left, free-running error on the right."""
    steps = report["waterfall"]
    figure = Figure(figsize=(_WIDTH, 0.9 + 0.42 * len(steps)), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True, gridspec_kw={"width_ratios": [1.25, 1.0]})
    _bars(left, [float(s["gap"]) for s in steps])
    _relative(right, [s["free_running"] for s in steps])
    left.set_yticks(range(len(steps)), [_STEPS.get(s["step"]) or "+ " + plain(s["step"]) for s in steps])
    left.set_ylim(len(steps) - 0.4, -0.6)
    return figure


def _bars(axes: Axes, gaps: list[float]) -> None:
    """Each bar reaches from where the step before ended to where it ends; the first and the last from zero."""
    last = len(gaps) - 1
    for i, gap in enumerate(gaps):
        begin = 0.0 if i in (0, last) else gaps[i - 1]
        colour = BEFORE if i == 0 else QUIET if i == last else AFTER
        axes.barh(i, gap - begin, left=begin, height=0.56, color=colour)
        if 0 < i < last:
            axes.plot([begin, begin], [i - 0.72, i], color=LINE, linewidth=1.0, zorder=0)
        # At the end that the step leads to, where there is room.
        inside = 0 < i < last and min(gap, begin) > 0.15 * max(gaps)
        at, side, way = (min(gap, begin), -6, "right") if inside else (max(gap, begin), 6, "left")
        axes.annotate(
            f"{gap:.1f}", (at, i), (side, 0), textcoords="offset points", ha=way, va="center", fontsize=9, color=INK
        )
    axes.axvline(1.0, color=INK, linewidth=0.9, linestyle=(0, (3, 3)))
    axes.set_xlim(0.0, 1.14 * max(*gaps, 1.2))
    axes.set_xlabel("held-out gap [noise floors]", fontsize=9, color=INK)
    calm(axes, "x")


def _relative(axes: Axes, errors: list[dict[str, float | None]]) -> None:
    """Free-running error in percent of the nominal model's: a dot for each channel, a bar for their median."""
    for i, row in enumerate(errors):
        ratios = [
            100.0 * value / before
            for name, value in row.items()
            if value is not None and (before := errors[0].get(name)) and np.isfinite(value) and np.isfinite(before)
        ]
        if ratios:
            axes.plot(ratios, np.full(len(ratios), i), "o", color=AFTER if i else BEFORE, markersize=5, alpha=0.55)
            middle = float(np.median(ratios))
            axes.plot([middle, middle], [i - 0.28, i + 0.28], color=INK, linewidth=2.0)
        else:
            axes.annotate("breaks down", (0.0, i), (6, 0), textcoords="offset points", va="center", fontsize=9)
    axes.set_xlim(left=0.0)
    axes.set_xlabel("free-running error [% of nominal]", fontsize=9, color=INK)
    calm(axes, "x")


def free_curves(evidence: Evidence) -> Figure | None:
    """Measured, nominal and diagnosed over one free run, each channel with its errors below."""
    curves = evidence.free
    if not curves:
        return None
    count = len(curves)
    figure = Figure(figsize=(_WIDTH, 0.6 + 2.5 * count), layout="constrained")
    grid = figure.subplots(2 * count, 1, squeeze=False, sharex=True, gridspec_kw={"height_ratios": [1.6, 1.0] * count})
    for i, curve in enumerate(curves):
        axes, below = grid[2 * i, 0], grid[2 * i + 1, 0]
        time = curve.time - curve.time[0, 0]
        shown = time <= _SHOWN
        at = _broken(time)
        measured, nominal, diagnosed = (
            _broken(np.where(shown, v, np.nan)) for v in (curve.measured, curve.nominal, curve.diagnosed)
        )
        axes.plot(at, measured, color=MEASURED, linewidth=5, label="measured", solid_capstyle="round")
        axes.plot(at, nominal, color=BEFORE, linewidth=1.4, label="nominal model")
        axes.plot(at, diagnosed, color=AFTER, linewidth=1.4, label="diagnosed model")
        frame_to(axes, measured, nominal, diagnosed)
        small, unit = (1e3, "m" + curve.unit) if curve.unit in ("rad", "m") else (1.0, curve.unit)
        below.axhline(0.0, color=MEASURED, linewidth=3)
        below.plot(at, small * (measured - nominal), color=BEFORE, linewidth=1.0)
        below.plot(at, small * (measured - diagnosed), color=AFTER, linewidth=1.0)
        for part, label in ((axes, f"{curve.channel} [{curve.unit}]"), (below, f"error [{unit}]")):
            calm(part, "y")
            part.tick_params(labelsize=8)
            part.set_ylabel(label.replace(" [1]", ""), fontsize=9, color=INK)
    grid[-1, 0].set_xlabel("s", fontsize=9, color=INK)
    handles, labels = grid[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, ncols=3, frameon=False, fontsize=9, loc="outside upper right")
    return figure


def _broken(values: Array) -> Array:
    """Stretches (nw, ns) in one row, with a gap in the line between them."""
    padded: Array = np.pad(values, ((0, 0), (0, 1)), constant_values=np.nan)
    return padded.reshape(-1)


def free_table(report: Report) -> dict[str, Any]:
    """Free-running error of each channel over all runs: names of the models, and {channel: ([values], unit)}.

    Runs count by their length. None of a model that broke down.
    """
    rows = report["free_running"]
    models = list(dict.fromkeys(r["model"] for r in rows))
    channels = list(dict.fromkeys(name for r in rows for name in r["rmse"]))
    table = {}
    for name in channels:
        values: list[float | None] = []
        for model in models:
            own = [(r["rmse"].get(name), r["duration_s"]) for r in rows if r["model"] == model]
            lost = any(v is None or not np.isfinite(v) for v, _ in own)
            total = sum(d for _, d in own)
            values.append(None if lost else float(np.sqrt(sum(v * v * d for v, d in own) / max(total, 1e-12))))
        table[name] = (values, rows[0]["unit"].get(name, ""))
    return {"models": models, "channels": table, "notes": sorted({r["note"] for r in rows if r.get("note")})}
