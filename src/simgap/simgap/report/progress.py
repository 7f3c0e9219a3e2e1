"""How far each step of a diagnosis goes: the waterfall, and free runs."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from simgap.report.evidence import Evidence
from simgap.report.figures import three_models
from simgap.report.plot import AXIS, LEGEND, ROW, TOP, WIDTH, Panel, framed, names_width, rows
from simgap.report.sentences import plain
from simgap.report.style import AFTER, BEFORE, INK, LINE, MEASURED, QUIET
from simgap.report.svg import Drawing

Array = NDArray[np.float64]
Report = dict[str, Any]

_SHOWN = 20.0
"""[s] of a free run that are drawn."""
_STEPS = {
    "nominal": "nominal model",
    "recalibrated": "its numbers moved within tolerances",
    "remainder": "what remains",
}


def waterfall(report: Report) -> Drawing:
    """From the nominal model to what remains: held-out gap on the left, free-running error on the right."""
    steps = report["waterfall"]
    names = [_STEPS.get(s["step"]) or "+ " + plain(s["step"]) for s in steps]
    begin = names_width(names)
    middle = begin + 0.56 * (WIDTH - begin)
    drawing = Drawing("waterfall", WIDTH, TOP + ROW * len(steps) + AXIS)
    gaps = [float(s["gap"]) for s in steps]
    left = rows(drawing, names, (begin, middle - 20.0), (0.0, 1.14 * max(*gaps, 1.2)))
    left.x_axis("held-out gap [noise floors]")
    left.names(names)
    _bars(left, gaps)
    errors = [_relative(s["free_running"], steps[0]["free_running"]) for s in steps]
    far = max((r for row in errors for r in row), default=100.0)
    right = rows(drawing, names, (middle + 20.0, WIDTH - 14.0), (0.0, 1.05 * max(far, 100.0)))
    right.x_axis("free-running error [% of nominal]")
    _dots(right, errors)
    return drawing


def _bars(panel: Panel, gaps: list[float]) -> None:
    """Each bar reaches from where the step before ended to where it ends; the first and the last from zero."""
    last = len(gaps) - 1
    for i, gap in enumerate(gaps):
        begin = 0.0 if i in (0, last) else gaps[i - 1]
        if 0 < i < last:
            panel.stroke((begin, i - 0.7), (begin, i), LINE, 1.2)
        panel.bar(begin, gap, i, BEFORE if i == 0 else QUIET if i == last else AFTER)
        # At the end that the step leads to, where there is room.
        inside = 0 < i < last and min(gap, begin) > 0.15 * max(gaps)
        panel.note(min(gap, begin) if inside else max(gap, begin), i, f"{gap:.1f}", -7.0 if inside else 7.0)
    panel.upright(1.0, dashed=True)


def _relative(errors: dict[str, float | None], nominal: dict[str, float | None]) -> list[float]:
    """Free-running error in percent of the nominal model's, of the channels where neither broke down."""
    return [
        100.0 * value / before
        for name, value in errors.items()
        if value is not None and (before := nominal.get(name)) and np.isfinite(value) and np.isfinite(before)
    ]


def _dots(panel: Panel, errors: list[list[float]]) -> None:
    """A dot for each channel, a bar for their median."""
    for i, ratios in enumerate(errors):
        for ratio in ratios:
            panel.dot(ratio, i, AFTER if i else BEFORE, 4.0, opacity=0.55)
        if ratios:
            middle = float(np.median(ratios))
            panel.stroke((middle, i - 0.28), (middle, i + 0.28), INK, 2.4)
        else:
            panel.note(0.0, i, "breaks down")


def free_curves(evidence: Evidence) -> Drawing | None:
    """Measured, nominal and diagnosed over one free run, each channel with its errors below."""
    curves = evidence.free
    if not curves:
        return None
    begin, high, low, between = 72.0, 140.0, 84.0, 20.0
    pitch = high + low + 2.0 * between
    drawing = Drawing("free", WIDTH, LEGEND + pitch * len(curves) - between + AXIS)
    for i, curve in enumerate(curves):
        top = LEGEND + i * pitch
        time = curve.time - curve.time[0, 0]
        at, shown = _broken(time), time <= _SHOWN
        measured, nominal, diagnosed = (
            _broken(np.where(shown, v, np.nan)) for v in (curve.measured, curve.nominal, curve.diagnosed)
        )
        span = (0.0, min(float(np.nanmax(time)), _SHOWN))
        small, unit = (1e3, "m" + curve.unit) if curve.unit in ("rad", "m") else (1.0, curve.unit)
        errors = [small * (measured - v) for v in (nominal, diagnosed)]
        above = Panel(drawing, (begin, top, WIDTH - begin - 8.0, high), span, framed(measured, nominal, diagnosed))
        below = Panel(
            drawing, (begin, top + high + between, WIDTH - begin - 8.0, low), span, _around(errors, small * measured)
        )
        for panel, label in ((above, f"{curve.channel} [{curve.unit}]"), (below, f"error [{unit}]")):
            panel.y_axis(label.replace(" [1]", ""))
            last = i == len(curves) - 1 and panel is below
            panel.x_axis((f"s of run {curve.run}" if curve.run else "s") if last else "", grid=False, texts=last)
        above.line(at, measured, MEASURED, 6.0)
        below.stroke((span[0], 0.0), (span[1], 0.0), MEASURED, 3.0)
        for panel, pair in ((above, [nominal, diagnosed]), (below, errors)):
            for values, colour in zip(pair, (BEFORE, AFTER), strict=True):
                panel.line(at, values, colour, 1.5 if panel is above else 1.2)
    three_models(drawing, begin, "diagnosed model")
    return drawing


def _around(errors: list[Array], measured: Array) -> tuple[float, float]:
    """From where to where errors are shown: all of them, and zero, but no further than the motion itself reaches."""
    known = np.concatenate([e[np.isfinite(e)] for e in errors] + [np.zeros(1)])
    reach = 1.2 * float(np.ptp(measured[np.isfinite(measured)])) if np.isfinite(measured).any() else 1.0
    low, high = max(float(known.min()), -reach), min(float(known.max()), reach)
    edge = 0.06 * (high - low) or 1.0
    return low - edge, high + edge


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
