"""The figures of the report; each gives one figure, or None where there is nothing to draw."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simgap.report.drawing import draw_robot
from simgap.report.evidence import Curve, Evidence
from simgap.report.plot import (
    AXIS,
    LEGEND,
    ROW,
    SMALL,
    TOP,
    WIDTH,
    Panel,
    cells,
    column_room,
    columns,
    framed,
    legend,
    names_width,
    rows,
)
from simgap.report.style import AFTER, BEFORE, LINE, MEASURED, QUIET, cool, heat
from simgap.report.svg import Drawing

Array = NDArray[np.float64]
Report = dict[str, Any]

_MANY = 14
"""Rows of a map at most; the rest have the smallest gaps."""


def subsystem_shares(report: Report) -> dict[str, float]:
    """Share of the gap of each subsystem, largest first."""
    shares: dict[str, float] = {}
    for row in report["where"]:
        shares[row["subsystem"]] = shares.get(row["subsystem"], 0.0) + row["share"]
    return dict(sorted(shares.items(), key=lambda item: -item[1]))


def robot(report: Report, evidence: Evidence) -> Drawing:
    """The robot with its gap as a heat map."""
    shares = subsystem_shares(report)
    top = max(shares.values(), default=0.0) or 1.0
    warmth = {b: max(shares.get(n, 0.0) for n in names) / top for b, names in evidence.bodies.items()}
    strongest: dict[str, int] = {}
    for body, names in evidence.bodies.items():
        for name in names:
            strongest.setdefault(name, body)
    labels: dict[int, str] = {}
    for name in list(shares)[:5]:
        if name in strongest and shares[name] >= 0.02:
            text = f"{name}  {100 * shares[name]:.0f} %"
            body = strongest[name]
            labels[body] = f"{labels[body]}\n{text}" if body in labels else text
    if report["verdict"] in ("effect", "ambiguous", "partial"):
        return draw_robot(evidence.model, evidence.qpos, warmth, labels, list(evidence.causes))
    return draw_robot(evidence.model, evidence.qpos, warmth, labels)


def phase_map(report: Report) -> Drawing | None:
    """Gap by channel and phase: before, and what is left."""
    rows = report["where"]
    if not rows:
        return None
    before, left = _by_phase(rows), _by_phase(report.get("left", []))
    gap = report["gap"]
    scale_before, scale_left = max(gap["before"] - 1.0, 0.0), max(gap["after"] - 1.0, 0.0)
    channels = sorted(before, key=lambda c: -sum(before[c].values()))[:_MANY]
    known = ("swing", "touch-down", "stance", "standstill", "reversal", "moving", "all")
    present = {p for c in channels for p in before[c]}
    phases = [p for p in known if p in present] + sorted(present - set(known))
    one = _matrix(before, channels, phases) * scale_before
    two = _matrix(left, channels, phases) * scale_left
    top = max(float(np.nanmax(one)), float(np.nanmax(np.nan_to_num(two))), 1e-9)
    begin, titles = names_width(channels), [p.replace("_", "-") for p in phases]
    wide, high = 0.5 * (WIDTH - begin - 24.0), ROW * len(channels)
    drawing = Drawing("phases", WIDTH, LEGEND + high + column_room(titles, wide / len(titles)))
    for start, values, title in ((begin, one, "before"), (begin + wide + 24.0, two, "after")):
        drawing.text(start, 12.0, title, bold=True)
        cells(drawing, (start, LEGEND, wide, high), values, values / top, heat, _short)
        columns(drawing, start, LEGEND + high, wide / len(titles), titles)
    _beside(drawing, begin, LEGEND, ROW, channels)
    return drawing


def _beside(drawing: Drawing, left: float, top: float, row: float, names: list[str], bold: Any = ()) -> None:
    """Names to the left of the rows of a map."""
    for i, name in enumerate(names):
        drawing.text(left - 10.0, top + (i + 0.5) * row, name, anchor="end", bold=name in bold)


def _by_phase(rows: list[dict[str, Any]]) -> dict[str, dict[str, float]]:
    found: dict[str, dict[str, float]] = {}
    for row in rows:
        phases = found.setdefault(row["channel"], {})
        phases[row["phase"]] = phases.get(row["phase"], 0.0) + row["share"]
    return found


def _matrix(table: dict[str, dict[str, float]], rows: list[str], columns: list[str]) -> Array:
    return np.array([[table.get(r, {}).get(c, np.nan) for c in columns] for r in rows])


def _short(value: float) -> str:
    return f"{value:.0f}" if value >= 10 else f"{value:.1f}" if value >= 0.05 else "·"


def band_map(report: Report) -> Drawing | None:
    """Where in frequency each channel's gap lies."""
    rows = report.get("frequency") or []
    if not rows:
        return None
    names = list(dict.fromkeys(r["channel"] for r in rows))[:_MANY]
    edges = list(dict.fromkeys((r["from_hz"], r["to_hz"]) for r in rows))
    table = {(r["channel"], (r["from_hz"], r["to_hz"])): 100 * r["share"] for r in rows}
    values = np.array([[table.get((n, e), np.nan) for e in edges] for n in names])
    titles = [f"{a:g}–{b:g} Hz" if b else f"over {a:g} Hz" for a, b in edges]
    begin, high = names_width(names), ROW * len(names)
    wide = min(110.0, (WIDTH - begin) / len(titles))
    drawing = Drawing("bands", WIDTH, TOP + high + column_room(titles, wide))
    cells(drawing, (begin, TOP, wide * len(titles), high), values, values / 100.0, heat, _short)
    columns(drawing, begin, TOP + high, wide, titles)
    _beside(drawing, begin, TOP, ROW, names)
    return drawing


def ranking(evidence: Evidence) -> Drawing | None:
    """What each hypothesis gains over nominal numbers alone, with its interval."""
    ranked = evidence.ranking
    if not ranked:
        return None
    names, chosen = [r.name for r in ranked], [r.name for r in ranked if r.chosen]
    low, high = min(0.0, *(r.low for r in ranked)), max(0.0, *(r.high for r in ranked))
    edge = 0.04 * (high - low or 1.0)
    drawing = Drawing("ranking", WIDTH, TOP + ROW * len(names) + AXIS)
    panel = rows(drawing, names, (names_width(names, bold=True), WIDTH - 12.0), (low - edge, high + edge))
    panel.x_axis(f"gain over the nominal model with its tolerances [{evidence.unit}]")
    panel.upright(0.0)
    panel.names(names, chosen)
    for i, rank in enumerate(ranked):
        colour = AFTER if rank.chosen else QUIET
        panel.stroke((rank.low, i), (rank.high, i), colour, 3.0)
        panel.dot(rank.gain, i, colour, 6.0 if rank.chosen else 4.5)
    return drawing


def alternatives(report: Report) -> Drawing:
    """The held-out gap of every way to explain the recording."""
    gap, beside = report["gap"], report["baselines"]
    bars = [
        ("nominal model", beside["nominal"]["gap"], BEFORE),
        ("nominal model, its numbers refitted within tolerances", gap["nuisances_only"], QUIET),
    ]
    if beside.get("fit_everything"):
        bars.append(("every number of the model fitted at once, freely", beside["fit_everything"]["gap"], QUIET))
    best = beside.get("best_in_sample") or {}
    if best.get("effect"):
        bars.append((f"best single effect in sample: {best['effect']}", best["gap"], QUIET))
    bars.append(("this diagnosis", gap["after"], AFTER))
    names = [b[0] for b in bars]
    drawing = Drawing("alternatives", WIDTH, TOP + ROW * len(bars) + AXIS)
    panel = _gaps(drawing, names, [b[1] for b in bars], TOP)
    for i, (_, value, colour) in enumerate(bars):
        panel.stroke((1.0, i), (value, i), LINE, 5.0)
        panel.dot(value, i, colour, 6.0)
        panel.note(value, i, f"{value:.2f}", 12.0)
    return drawing


def channels(report: Report) -> Drawing | None:
    """Held-out gap of every channel, before and after."""
    table = report["gap"].get("by_channel") or {}
    if not table:
        return None
    names = sorted(table, key=lambda n: -table[n]["before"])[:_MANY]
    drawing = Drawing("channels", WIDTH, LEGEND + ROW * len(names) + AXIS)
    panel = _gaps(drawing, names, [table[n][when] for n in names for when in ("before", "after")], LEGEND)
    for i, name in enumerate(names):
        before, after = table[name]["before"], table[name]["after"]
        panel.stroke((before, i), (after, i), LINE, 5.0)
        panel.dot(before, i, BEFORE)
        panel.dot(after, i, AFTER)
    legend(drawing, panel.left, [("before", BEFORE), ("after", AFTER)], dots=True)
    return drawing


def _gaps(drawing: Drawing, names: list[str], values: list[float], top: float) -> Panel:
    """Rows on a logarithmic axis of gaps, with the noise floor."""
    ends = (min(0.8, 0.9 * max(min(values), 0.05)), 1.6 * max(*values, 1.2))
    panel = rows(drawing, names, (names_width(names), WIDTH - 44.0), ends, top=top, logarithmic=True)
    panel.x_axis("held-out gap [noise floors]; the dashed line is as good as repeating the experiment")
    panel.upright(1.0, dashed=True)
    panel.names(names)
    return panel


def curves(evidence: Evidence) -> Drawing | None:
    """Measured, nominal and corrected, in windows that were not used to fit."""
    if not evidence.curves:
        return None
    count = max(len(c) for c in evidence.curves.values())
    begin, high, below = 72.0, 104.0, 18.0
    pitch = (WIDTH - begin + 38.0) / count
    top = LEGEND + 18.0
    drawing = Drawing("curves", WIDTH, top + (high + below) * len(evidence.curves) - below + AXIS)
    for r, ((name, unit), windows) in enumerate(evidence.curves.items()):
        last = r == len(evidence.curves) - 1
        for c, window in enumerate(windows):
            place = (begin + c * pitch, top + r * (high + below), pitch - 46.0, high)
            panel = _window(drawing, place, window)
            panel.y_axis((name if unit == "1" else f"{name} [{unit}]") if c == 0 else "")
            panel.x_axis("s" if last else "", grid=False, texts=last)
            if r == 0:
                drawing.text(place[0], top - 13.0, f"from {window.start}", size=SMALL, fill=QUIET)
            for values, colour, width in (
                (window.measured, MEASURED, 6.0),
                (window.nominal, BEFORE, 1.8),
                (window.after, AFTER, 1.8),
            ):
                panel.line(window.time, values, colour, width)
    three_models(drawing, begin, "with what was found")
    return drawing


def _window(drawing: Drawing, place: tuple[float, float, float, float], window: Curve) -> Panel:
    span = (float(window.time[0]), float(window.time[-1]))
    return Panel(drawing, place, span, framed(window.measured, window.nominal, window.after))


def three_models(drawing: Drawing, left: float, after: str) -> None:
    """The legend of curves of what was measured and two models."""
    entries = [("measured", MEASURED), ("nominal model", BEFORE), (after, AFTER)]
    legend(drawing, left, entries, thick=(6.0, 2.0, 2.0))


def isolability(report: Report) -> Drawing | None:
    """Angles between what effects change: small ones cannot be told apart."""
    table = report.get("isolability") or {}
    names = table.get("effects") or []
    if len(names) < 2:
        return None
    values = np.array(table["angle_deg"], float)
    np.fill_diagonal(values, np.nan)
    found = [n["name"] + "@" + n["site"] for n in report["effects"]]
    return _square("isolability", values, 1.0 - values / 90.0, names, cool, found)


def confusion(report: Report) -> Drawing | None:
    """Simulated: how often each effect, if it were true, would be given each name."""
    table = (report.get("isolability") or {}).get("confusion") or {}
    names = table.get("effects") or []
    values = np.array(table.get("probability") or [], float)
    if len(names) < 2 or values.shape != (len(names), len(names)):
        return None
    return _square("confusion", 100.0 * values, values, names, heat, [])


def _square(
    name: str, values: Array, shares: Array, names: list[str], colour: Callable[[float], str], bold: list[str]
) -> Drawing:
    begin = names_width(names, bold=bool(bold))
    wide, high = min(64.0, (WIDTH - begin) / len(names)), 27.0
    bottom = TOP + high * len(names)
    drawing = Drawing(name, WIDTH, bottom + column_room(names, wide))
    cells(drawing, (begin, TOP, wide * len(names), high * len(names)), values, shares, colour, lambda v: f"{v:.0f}")
    columns(drawing, begin, bottom, wide, names, bold)
    _beside(drawing, begin, TOP, high, names, bold)
    return drawing
