"""Figures of C chapter 3, redrawn from our data."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure

WIDTH = 9.0
"""[in]"""


def footsteps(facts: dict[str, Any]) -> Figure:
    """C figures 3.5 and 3.8: displacement over change and step; a point a repeat, the surface their mean."""
    rows = facts["rows"]
    names = list(dict.fromkeys(row["controller"] for row in rows))
    figure = Figure(figsize=(WIDTH, 4.2), layout="constrained")
    for number, name in enumerate(names):
        own = [row for row in rows if row["controller"] == name]
        changes, steps = sorted({row["delta_m"] for row in own}), sorted({row["step"] for row in own})
        axes = figure.add_subplot(1, len(names), number + 1, projection="3d")
        means = np.full((len(changes), len(steps)), np.nan)
        for i, change in enumerate(changes):
            for j, step in enumerate(steps):
                values = [row["displacement_m"] for row in own if (row["delta_m"], row["step"]) == (change, step)]
                if values:
                    means[i, j] = np.mean(values)
        x, y = np.meshgrid(1e3 * np.array(changes), steps, indexing="ij")
        axes.plot_surface(x, y, 1e3 * means, cmap="viridis", alpha=0.7)
        axes.scatter(
            [1e3 * row["delta_m"] for row in own],
            [row["step"] for row in own],
            [1e3 * row["displacement_m"] for row in own],
            s=4,
            color="k",
        )
        fit = facts["fit"][name]
        axes.set(xlabel="shortened by [mm]", ylabel="step", zlabel="displacement [mm]")
        axes.set_title(
            f"{name}: R2 {fit['r2']:.2f}, first step right in {100.0 * fit['first_step_right']:.0f} %", fontsize="small"
        )
    return figure


def pushes(facts: dict[str, Any]) -> Figure:
    """Runs that survive a push, and when they have recovered, over the push."""
    rows = facts["rows"]
    figure = Figure(figsize=(WIDTH, 3.6), layout="constrained")
    survived, recovery = figure.subplots(1, 2)
    for kind, loads in dict.fromkeys((row["coordination"], row["loads"]) for row in rows):
        own = [row for row in rows if (row["coordination"], row["loads"]) == (kind, loads)]
        label = kind if loads == "-" else f"{kind}, {loads} loads"
        survived.plot(
            [row["push_n"] for row in own], [row["survived"] / row["runs"] for row in own], "o-", alpha=0.8, label=label
        )
        known = [row for row in own if row["recovery_s"] is not None]
        recovery.plot([row["push_n"] for row in known], [row["recovery_s"] for row in known], "o-", alpha=0.8)
    survived.set(xlabel="push for 0.1 s [N]", ylabel="did not fall", ylim=(-0.03, 1.03))
    recovery.set(xlabel="push for 0.1 s [N]", ylabel="recovered after [s]")
    survived.legend(fontsize="small")
    for axes in (survived, recovery):
        axes.grid(alpha=0.3)
    return figure


def gap_crossings(facts: dict[str, Any]) -> Figure:
    """Gaps crossed over their width, with 95 % intervals, and below the footfalls of all runs against one gap."""
    rows, runs = facts["rows"], facts["runs"]
    changes, widths = list(dict.fromkeys(row["change"] for row in rows)), sorted({row["width_m"] for row in rows})
    kinds = list(dict.fromkeys(row["controller"] for row in rows))
    figure = Figure(figsize=(WIDTH, 3.2 + 2.8 * len(kinds)), layout="constrained")
    grid = figure.add_gridspec(1 + len(kinds), len(changes))
    shares = figure.add_subplot(grid[0, :])
    for number, change in enumerate(changes):
        for kind, style in zip(kinds, ("o-", "s--"), strict=False):
            own = [row for row in rows if (row["change"], row["controller"]) == (change, kind)]
            rate = np.array([row["rate"] for row in own])
            bars = np.abs([[row["rate_low"] for row in own], [row["rate_high"] for row in own]] - rate)
            places = [1e3 * row["width_m"] + 0.4 * number - 0.4 + 0.15 * kinds.index(kind) for row in own]
            shares.errorbar(places, rate, bars, fmt=style, color=f"C{number}", capsize=3, label=f"{kind}, {change}")
    shares.set(xlabel="width of the gap [mm]", ylabel="crossed", ylim=(-0.03, 1.03))
    shares.legend(fontsize="small", ncols=len(kinds))
    shares.grid(alpha=0.3)
    width = widths[len(widths) // 2]
    for line, kind in enumerate(kinds):
        for number, change in enumerate(changes):
            axes = figure.add_subplot(grid[1 + line, number])
            own = [run for run in runs if (run["controller"], run["change"], run["width_m"]) == (kind, change, width)]
            _crossings(axes, sorted(own, key=lambda run: run["gap_m"][0]), width)
            axes.set_title(f"{kind}, {change}: {1e3 * width:g} mm", fontsize="small")
    return figure


def _crossings(axes: Any, runs: list[dict[str, Any]], width: float) -> None:
    """A line a run, a bar where a foot stood: fore legs dark, hind legs light, a cross where a foot was in the gap."""
    axes.axvspan(0.0, 1e3 * width, color="0.8")
    colours = {"front_left": "C0", "front_right": "C3", "rear_left": "#8fc1e8", "rear_right": "#f0a0a0"}
    for line, run in enumerate(runs):
        for footfall in run["footfalls"]:
            low, high = footfall["mm"]
            middle, half = 0.5 * (low + high), max(0.5 * (high - low), 3.0)
            axes.plot([middle - half, middle + half], [line, line], color=colours[footfall["leg"]], lw=3.0)
        if not run["crossed"]:
            axes.plot(0.5e3 * width, line, "kx", ms=5)
    axes.set(xlim=(-320.0, 320.0), xlabel="from the near edge [mm]", yticks=[])


def transitions(facts: dict[str, Any]) -> Figure:
    """C figure 3.7: phases relative to the rear left leg over time, or lags of the footfalls, and the gaits' names."""
    sweeps = list(dict.fromkeys(_sweep(row) for row in facts["rows"]))
    figure = Figure(figsize=(WIDTH, 2.6 * len(sweeps) + 0.6), layout="constrained")
    grid = np.atleast_1d(figure.subplots(len(sweeps), 1))
    for axes, sweep in zip(grid, sweeps, strict=True):
        rows = [row for row in facts["rows"] if _sweep(row) == sweep]
        compensation, running, repeat = sweep
        for leg, label in enumerate(("front left", "front right", "rear right")):
            known = [row for row in rows if row["lags"] and row["lags"][leg] is not None]
            lags = [2.0 * np.pi * row["lags"][leg] for row in known]
            axes.plot([row["omega_rad_s"] for row in known], lags, "o", color=f"C{leg}", label=label)
        _phases(axes, facts, sweep, [row["omega_rad_s"] for row in rows])
        for row in rows:
            axes.text(row["omega_rad_s"], 6.4, row["gait"].replace("_", " "), rotation=60, fontsize=7, ha="left")
        axes.set(xlabel="excitation [rad/s]", ylabel="behind rear left [rad]", ylim=(0.0, 2.0 * np.pi))
        axes.set_title(
            f"compensation {'on' if compensation else 'off'}{', running start' * running}, run {repeat}",
            loc="left",
            fontsize="small",
            pad=42,
        )
        axes.grid(alpha=0.3)
    if grid[0].get_legend_handles_labels()[0]:
        grid[0].legend(fontsize="small", loc="lower right")
    return figure


def _sweep(row: dict[str, Any]) -> tuple[bool, bool, int]:
    return row["compensation"], row["running_start"], row["repeat"]


def _phases(axes: Any, facts: dict[str, Any], sweep: tuple[bool, bool, int], levels: list[float]) -> None:
    """The oscillators' differences, over the excitation that time stands for."""
    for one in facts.get("series", []):
        if _sweep(one) != sweep or len(one["phases"]) < 2:
            continue
        table = np.array(one["phases"])
        hold = table[-1, 0] / len(levels)
        step = levels[1] - levels[0] if len(levels) > 1 else 1.0
        place = levels[0] + step * (table[:, 0] / hold - 0.5)
        for leg, column in enumerate((1, 2, 4)):
            # A foot that touches down later is behind in phase.
            behind = (table[:, 3] - table[:, column]) % (2.0 * np.pi)
            axes.plot(place, behind, ",", color=f"C{leg}", alpha=0.5)
