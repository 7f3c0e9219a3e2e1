"""The figures of the report; each gives one figure, or None where there is nothing to draw."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from simgap.report.drawing import draw_robot
from simgap.report.evidence import Evidence
from simgap.report.style import AFTER, BEFORE, COOL, HEAT, INK, LINE, MEASURED, QUIET, calm

Array = NDArray[np.float64]
Report = dict[str, Any]

_WIDTH = 9.0
"""[in]"""
_MANY = 14
"""Rows of a map at most; the rest have the smallest gaps."""


def subsystem_shares(report: Report) -> dict[str, float]:
    """Share of the gap of each subsystem, largest first."""
    shares: dict[str, float] = {}
    for row in report["where"]:
        shares[row["subsystem"]] = shares.get(row["subsystem"], 0.0) + row["share"]
    return dict(sorted(shares.items(), key=lambda item: -item[1]))


def robot(report: Report, evidence: Evidence) -> Figure:
    """The robot with its gap as a heat map."""
    shares = subsystem_shares(report)
    top = max(shares.values(), default=0.0) or 1.0
    heat = {b: max(shares.get(n, 0.0) for n in names) / top for b, names in evidence.bodies.items()}
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
        return draw_robot(evidence.model, evidence.qpos, heat, labels, list(evidence.causes))
    return draw_robot(evidence.model, evidence.qpos, heat, labels)


def phase_map(report: Report) -> Figure | None:
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
    figure = Figure(figsize=(_WIDTH, 0.9 + 0.34 * len(channels)), layout="constrained")
    one = _matrix(before, channels, phases) * scale_before
    two = _matrix(left, channels, phases) * scale_left
    top = max(float(np.nanmax(one)), float(np.nanmax(np.nan_to_num(two))), 1e-9)
    pair = figure.subplots(1, 2, sharey=True)
    for axes, values, title in zip(pair, (one, two), ("before", "after"), strict=True):
        _cells(axes, values, top, channels, [p.replace("_", "-") for p in phases])
        axes.set_title(title, fontsize=10, color=INK, loc="left")
    return figure


def _by_phase(rows: list[dict[str, Any]]) -> dict[str, dict[str, float]]:
    found: dict[str, dict[str, float]] = {}
    for row in rows:
        phases = found.setdefault(row["channel"], {})
        phases[row["phase"]] = phases.get(row["phase"], 0.0) + row["share"]
    return found


def _matrix(table: dict[str, dict[str, float]], rows: list[str], columns: list[str]) -> Array:
    return np.array([[table.get(r, {}).get(c, np.nan) for c in columns] for r in rows])


def _cells(axes: Axes, values: Array, top: float, rows: list[str], columns: list[str]) -> None:
    axes.pcolormesh(np.ma.masked_invalid(values), cmap=HEAT, vmin=0.0, vmax=top, edgecolors="white", linewidth=1.5)
    for (i, j), value in np.ndenumerate(values):
        if np.isfinite(value):
            tone = "white" if value > 0.62 * top else INK
            axes.text(j + 0.5, i + 0.5, _short(value), ha="center", va="center", fontsize=8.5, color=tone)
    axes.set_xticks(np.arange(len(columns)) + 0.5, columns)
    axes.set_yticks(np.arange(len(rows)) + 0.5, rows)
    axes.set_ylim(len(rows), 0)
    calm(axes)


def _short(value: float) -> str:
    return f"{value:.0f}" if value >= 10 else f"{value:.1f}" if value >= 0.05 else "·"


def band_map(report: Report) -> Figure | None:
    """Where in frequency each channel's gap lies."""
    rows = report.get("frequency") or []
    if not rows:
        return None
    names = list(dict.fromkeys(r["channel"] for r in rows))[:_MANY]
    edges = list(dict.fromkeys((r["from_hz"], r["to_hz"]) for r in rows))
    table = {(r["channel"], (r["from_hz"], r["to_hz"])): 100 * r["share"] for r in rows}
    values = np.array([[table.get((n, e), np.nan) for e in edges] for n in names])
    figure = Figure(figsize=(_WIDTH * 0.55, 0.8 + 0.34 * len(names)), layout="constrained")
    axes = figure.subplots()
    titles = [f"{a:g}–{b:g} Hz" if b else f"over {a:g} Hz" for a, b in edges]
    _cells(axes, values, 100.0, names, titles)
    return figure


def ranking(evidence: Evidence) -> Figure | None:
    """What each hypothesis gains on held-out data, with its interval."""
    ranked = evidence.ranking
    if not ranked:
        return None
    figure = Figure(figsize=(_WIDTH, 0.7 + 0.33 * len(ranked)), layout="constrained")
    axes = figure.subplots()
    for i, rank in enumerate(ranked):
        colour = AFTER if rank.chosen else QUIET
        axes.plot([rank.low, rank.high], [i, i], color=colour, linewidth=2.2, solid_capstyle="round")
        axes.plot(rank.gain, i, "o", color=colour, markersize=8 if rank.chosen else 6)
    axes.axvline(0.0, color=INK, linewidth=0.8)
    axes.set_yticks(range(len(ranked)), [r.name for r in ranked])
    axes.set_ylim(len(ranked) - 0.4, -0.6)
    for label, rank in zip(axes.get_yticklabels(), ranked, strict=True):
        label.set_fontweight("bold" if rank.chosen else "normal")
    axes.set_xlabel("gain over the nominal model with its tolerances, on held-out data [nats]", fontsize=9, color=INK)
    calm(axes, "x")
    return figure


def alternatives(report: Report) -> Figure:
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
    figure = Figure(figsize=(_WIDTH, 0.6 + 0.36 * len(bars)), layout="constrained")
    axes = figure.subplots()
    for i, (_, value, colour) in enumerate(bars):
        axes.plot([1.0, value], [i, i], color=LINE, linewidth=4, zorder=1)
        axes.plot(value, i, "o", color=colour, markersize=9)
        axes.annotate(
            f"{value:.2f}", (value, i), (9, 0), textcoords="offset points", va="center", fontsize=9, color=INK
        )
    _noise_floor(axes)
    axes.set_yticks(range(len(bars)), [b[0] for b in bars])
    axes.set_ylim(len(bars) - 0.4, -0.6)
    _log_gap(axes, [b[1] for b in bars])
    calm(axes, "x")
    return figure


def channels(report: Report) -> Figure | None:
    """Held-out gap of every channel, before and after."""
    table = report["gap"].get("by_channel") or {}
    if not table:
        return None
    names = sorted(table, key=lambda n: -table[n]["before"])[:_MANY]
    figure = Figure(figsize=(_WIDTH, 0.7 + 0.34 * len(names)), layout="constrained")
    axes = figure.subplots()
    for i, name in enumerate(names):
        before, after = table[name]["before"], table[name]["after"]
        axes.plot([before, after], [i, i], color=LINE, linewidth=4, zorder=1)
        axes.plot(before, i, "o", color=BEFORE, markersize=8, label="before" if i == 0 else None)
        axes.plot(after, i, "o", color=AFTER, markersize=8, label="after" if i == 0 else None)
    _noise_floor(axes)
    _log_gap(axes, [table[n][when] for n in names for when in ("before", "after")])
    axes.set_yticks(range(len(names)), names)
    axes.set_ylim(len(names) - 0.4, -0.6)
    axes.legend(frameon=False, fontsize=9, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    calm(axes, "x")
    return figure


def _noise_floor(axes: Axes) -> None:
    axes.axvline(1.0, color=INK, linewidth=0.9, linestyle=(0, (3, 3)))


def _log_gap(axes: Axes, values: list[float]) -> None:
    """A logarithmic axis of gaps with round numbers."""
    low, high = min(0.8, 0.9 * max(min(values), 0.05)), 1.6 * max(*values, 1.2)
    axes.set_xscale("log")
    axes.set_xlim(low, high)
    ticks = [m * 10.0**e for e in range(-2, 6) for m in (1, 2, 5)]
    ticks = [t for t in ticks if low <= t <= high][:: 1 if high / low < 3e3 else 3]
    axes.set_xticks(ticks, [f"{t:g}" for t in ticks])
    axes.minorticks_off()
    axes.set_xlabel(
        "held-out gap [noise floors]; the dashed line is as good as repeating the experiment", fontsize=9, color=INK
    )


def curves(evidence: Evidence) -> Figure | None:
    """Measured, nominal and corrected, in windows that were not used to fit."""
    if not evidence.curves:
        return None
    rows, columns = len(evidence.curves), max(len(c) for c in evidence.curves.values())
    figure = Figure(figsize=(_WIDTH, 0.5 + 1.55 * rows), layout="constrained")
    grid = figure.subplots(rows, columns, squeeze=False, sharex=True)
    for r, ((name, unit), windows) in enumerate(evidence.curves.items()):
        for c in range(columns):
            axes = grid[r, c]
            if c >= len(windows):
                axes.axis("off")
                continue
            w = windows[c]
            axes.plot(w.time, w.measured, color=MEASURED, linewidth=5, label="measured", solid_capstyle="round")
            axes.plot(w.time, w.nominal, color=BEFORE, linewidth=1.6, label="nominal model")
            axes.plot(w.time, w.after, color=AFTER, linewidth=1.6, label="with what was found")
            frame_to(axes, w.measured, w.nominal, w.after)
            calm(axes, "y")
            axes.tick_params(labelsize=8)
            if c == 0:
                axes.set_ylabel(f"{name} [{unit}]" if unit else name, fontsize=9, color=INK)
            if r == 0:
                axes.set_title(f"from {w.start:.1f} s", fontsize=9, color=QUIET, loc="left")
            if r == rows - 1:
                axes.set_xlabel("s", fontsize=9, color=INK)
    handles, labels = grid[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, ncols=3, frameon=False, fontsize=9, loc="outside upper right")
    return figure


def frame_to(axes: Axes, *series: Array) -> None:
    """Let no run-away simulation decide the scale."""
    measured = series[0][np.isfinite(series[0])]
    if not len(measured):
        return
    low, high = float(measured.min()), float(measured.max())
    reach = 1.2 * max(high - low, 1e-9)
    everything = np.concatenate([s[np.isfinite(s)] for s in series])
    axes.set_ylim(
        max(float(everything.min()), low - reach) - 0.06 * reach,
        min(float(everything.max()), high + reach) + 0.06 * reach,
    )


def isolability(report: Report) -> Figure | None:
    """Angles between what effects change: small ones cannot be told apart."""
    table = report.get("isolability") or {}
    names = table.get("effects") or []
    if len(names) < 2:
        return None
    values = np.array(table["angle_deg"], float)
    return _square(values, names, 90.0, COOL, [n["name"] + "@" + n["site"] for n in report["effects"]])


def confusion(report: Report) -> Figure | None:
    """Simulated: how often each effect, if it were true, would be given each name."""
    table = (report.get("isolability") or {}).get("confusion") or {}
    names = table.get("effects") or []
    values = np.array(table.get("probability") or [], float)
    if len(names) < 2 or values.shape != (len(names), len(names)):
        return None
    return _square(100 * values, names, 100.0, HEAT, [])


def _square(values: Array, names: list[str], top: float, colours: Any, bold: list[str]) -> Figure:
    n = len(names)
    figure = Figure(figsize=(_WIDTH, min(1.8 + 0.36 * n, 8.0)), layout="constrained")
    axes = figure.subplots()
    axes.pcolormesh(values, cmap=colours, vmin=0.0, vmax=top, edgecolors="white", linewidth=1.2)
    for (i, j), value in np.ndenumerate(values):
        if i != j or colours is HEAT:
            dark = value > 0.6 * top if colours is HEAT else value < 0.5 * top
            axes.text(
                j + 0.5, i + 0.5, f"{value:.0f}", ha="center", va="center", fontsize=7.5, color="white" if dark else INK
            )
    axes.set_xticks(np.arange(n) + 0.5, names, rotation=40, ha="right")
    axes.set_yticks(np.arange(n) + 0.5, names)
    for label in (*axes.get_xticklabels(), *axes.get_yticklabels()):
        label.set_fontweight("bold" if label.get_text() in bold else "normal")
    axes.invert_yaxis()
    calm(axes)
    axes.tick_params(labelsize=8)
    return figure
