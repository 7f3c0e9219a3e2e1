"""The pictures of a calibration."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from nermo_sim.calibrate.determined import slopes
from nermo_sim.calibrate.numbers import NUMBERS, Array
from nermo_sim.calibrate.search import Found


def history(found: Found) -> Figure:
    """Least cost after the design and each generation."""
    figure = Figure(figsize=(6.5, 3.5), layout="constrained")
    axes = figure.subplots()
    axes.plot(found.history, "o-")
    axes.axhline(found.baseline.cost, color="0.5", linestyle="--", label="the robot's file")
    axes.set(xlabel="generation (0: the design)", ylabel="mean square miss [half bands]")
    axes.legend()
    return figure


def intervals(rows: list[dict[str, Any]], start: Array) -> Figure:
    """Each number between its bounds: interval, value, and where it began."""
    figure = Figure(figsize=(7.0, 4.0), layout="constrained")
    axes = figure.subplots()
    for index, (row, number) in enumerate(zip(rows, NUMBERS, strict=True)):
        axes.plot([number.share(end) for end in row["ci90"]], [index, index], linewidth=6, alpha=0.4)
        axes.plot(number.share(row["value"]), index, "ko")
        axes.plot(start[index], index, "wo", markeredgecolor="k")
    axes.set_yticks(range(len(rows)), [row["name"] for row in rows])
    axes.set(xlim=(-0.02, 1.02), xlabel="between the bounds (black: found, white: the robot's file, bar: 90 %)")
    return figure


def sensitivities(found: Found) -> Figure:
    """How each number moves each fitted claim, in half bands over its range."""
    claims, gradient, _ = slopes(found)
    figure = Figure(figsize=(9.0, 2.0 + 0.24 * len(claims)), layout="constrained")
    axes = figure.subplots()
    largest = float(np.abs(gradient).max())
    image = axes.imshow(gradient, cmap="RdBu_r", vmin=-largest, vmax=largest, aspect="auto")
    axes.set_xticks(range(len(NUMBERS)), [number.name for number in NUMBERS], rotation=60, ha="right")
    axes.set_yticks(range(len(claims)), claims, fontsize=7)
    figure.colorbar(image, label="half bands over the range")
    return figure
