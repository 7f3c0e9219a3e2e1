"""The figures of N chapter 6, redrawn from our data; each function gives one figure, or None without data for it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from nermo_description.parameters import LEGS
from nermo_sim.experiments.lookup import Row, pick, pick_all
from nermo_sim.experiments.orientation import AXES
from nermo_sim.experiments.straight_line import GAITS, STRIDE
from nermo_sim.experiments.turning import FULL_LOCK, RADII, STRATEGIES
from nermo_sim.plots import spreads

WIDTH = 9.0
"""[in]"""


def speeds(facts: dict[str, Any]) -> Figure | None:
    """N figure 6.6: speed by frequency, gait and spine, and by stride."""
    rows = facts["straight-line"]["rows"]
    figure = Figure(figsize=(WIDTH, 4.0), layout="constrained")
    bars, strides = figure.subplots(1, 2)
    kinds = [(gait, spine) for gait in GAITS for spine in (False, True)]
    full = [row for row in rows if row["stride_m"] == STRIDE and row["spine"] == row["offset_compensation"]]
    present = [kind for kind in kinds if pick(full, gait=kind[0], spine=kind[1])]
    frequencies = sorted({row["frequency_hz"] for row in full})
    _bars(
        bars,
        [f"{frequency} Hz" for frequency in frequencies],
        {
            f"{gait.replace('_', ' ')}{', spine' if spine else ''}": [
                pick(full, gait=gait, spine=spine, frequency_hz=frequency) for frequency in frequencies
            ]
            for gait, spine in present
        },
        "speed_m_s",
        "speed_sd_m_s",
    )
    bars.set(ylabel="speed [m/s]", title="By gait and frequency")
    for spine in (False, True):
        chosen = [row for row in rows if (row["gait"], row["frequency_hz"], row["spine"]) == ("trot", 0.8, spine)]
        chosen = sorted((row for row in chosen if row["offset_compensation"] == spine), key=lambda row: row["stride_m"])
        where = [1e3 * row["stride_m"] for row in chosen]
        label = "spine" if spine else "no spine"
        strides.errorbar(where, [r["speed_m_s"] for r in chosen], spreads(chosen), marker="o", label=label)
        strides.plot(where, [r["theory_m_s"] for r in chosen], "--", color=f"C{int(spine)}", alpha=0.5)
    strides.set(xlabel="stride [mm]", ylabel="speed [m/s]", title="Trot at 0.8 Hz (dashed: no slip)")
    _finish(bars, strides)
    return figure


def orientation(facts: dict[str, Any]) -> Figure | None:
    """N figures 6.7 and 6.9: roll, pitch and yaw over two gait cycles."""
    rows = facts["straight-line"]["rows"]
    kinds = (("no spine", False, False), ("spine", True, False), ("spine, offset compensation", True, True))
    figure = Figure(figsize=(WIDTH, 3.4), layout="constrained")
    for axes, name in zip(figure.subplots(1, 3), AXES, strict=True):
        for label, spine, offset in kinds:
            row = pick(rows, gait="trot", frequency_hz=0.8, stride_m=STRIDE, spine=spine, offset_compensation=offset)
            if row is not None and row["cycles"]:
                axes.plot(row["cycles"]["time_s"], row["cycles"][name], label=label)
        axes.set(xlabel="time [s]", title=f"{name} [deg]")
        axes.grid(alpha=0.3)
    figure.axes[0].legend(fontsize="small")
    return figure


def yaw_and_spine(facts: dict[str, Any]) -> Figure | None:
    """N figure 6.8: yaw beside the spine angle."""
    row = pick(
        facts["straight-line"]["rows"],
        gait="trot",
        frequency_hz=0.8,
        stride_m=STRIDE,
        spine=True,
        offset_compensation=True,
    )
    if row is None or not row["cycles"]:
        return None
    figure = Figure(figsize=(0.6 * WIDTH, 3.0), layout="constrained")
    axes = figure.subplots()
    axes.plot(row["cycles"]["time_s"], row["cycles"]["yaw"], label="yaw [deg]")
    axes.plot(row["cycles"]["time_s"], np.degrees(row["cycles"]["spine"]), label="spine servo [deg]")
    axes.set(xlabel="time [s]")
    _finish(axes)
    return figure


def noise(facts: dict[str, Any]) -> Figure | None:
    """N figures A.7 and A.9: deviations of roll, pitch and yaw by gait, frequency and spine."""
    rows = [row for row in facts["straight-line"]["rows"] if row["stride_m"] == STRIDE]
    frequencies = sorted({row["frequency_hz"] for row in rows})
    kinds = {
        "lateral": ("lateral_walk", False, False),
        "walking trot": ("walking_trot", False, False),
        "walking trot, s+o": ("walking_trot", True, True),
        "trot": ("trot", False, False),
        "trot, s": ("trot", True, False),
        "trot, s+o": ("trot", True, True),
    }
    figure = Figure(figsize=(WIDTH, 3.4), layout="constrained")
    for axes, name in zip(figure.subplots(1, 3), AXES, strict=True):
        groups = {
            f"{frequency} Hz": [
                pick(rows, gait=gait, spine=spine, offset_compensation=offset, frequency_hz=frequency)
                for gait, spine, offset in kinds.values()
            ]
            for frequency in frequencies
        }
        _bars(axes, list(kinds), groups, f"{name}_sd_deg")
        axes.tick_params(axis="x", rotation=60)
        axes.set_title(f"{name} deviation [deg]")
    figure.axes[0].legend(fontsize="small")
    return figure


def turning_times(facts: dict[str, Any]) -> Figure | None:
    """N figure 6.12: time on the arcs; what was not followed is left out and marked."""
    rows = facts["turning"]["rows"]
    radii = [radius for radius in RADII if pick(rows, path_radius_m=radius)]
    figure = Figure(figsize=(WIDTH, 3.8), layout="constrained")
    for axes, radius in zip(np.atleast_1d(figure.subplots(1, len(radii))), radii, strict=True):
        chosen = pick_all(rows, path_radius_m=radius)
        names = list(dict.fromkeys((row["gait"], row["frequency_hz"]) for row in chosen))
        groups: dict[str, list[Row | None]] = {
            strategy: [pick(chosen, gait=gait, frequency_hz=f, strategy=strategy) for gait, f in names]
            for strategy in STRATEGIES
        }
        for row in (row for group in groups.values() for row in group if row is not None and not row["followed"]):
            axes.text(names.index((row["gait"], row["frequency_hz"])), 0.5, "failed", rotation=90, color="C3")
        _bars(axes, [f"{gait.replace('_', ' ')} {f} Hz" for gait, f in names], groups, "time_s", "time_sd_s")
        axes.tick_params(axis="x", rotation=60)
        axes.set(title=f"Quarter circle of {radius} m", ylabel="time [s]")
    _finish(*figure.axes)
    return figure


def smallest_radii(facts: dict[str, Any]) -> Figure | None:
    """N figure 6.13: radius of the shoulder axis at full lock."""
    chosen = pick_all(facts["turning"]["rows"], path_radius_m=FULL_LOCK)
    names = list(dict.fromkeys((row["gait"], row["frequency_hz"]) for row in chosen))
    figure = Figure(figsize=(WIDTH, 3.6), layout="constrained")
    axes = figure.subplots()
    groups: dict[str, list[Row | None]] = {
        strategy: [pick(chosen, gait=gait, frequency_hz=f, strategy=strategy) for gait, f in names]
        for strategy in STRATEGIES
    }
    _bars(axes, [f"{gait.replace('_', ' ')} {f} Hz" for gait, f in names], groups, "radius_m", "radius_sd_m")
    axes.tick_params(axis="x", rotation=40)
    axes.set(ylabel="radius [m]")
    _finish(axes)
    return figure


def balance_pitch(facts: dict[str, Any]) -> Figure | None:
    """N figure 6.15: pitch while each leg is lifted."""
    rows = facts["balance"]["rows"]
    figure = Figure(figsize=(WIDTH, 3.4), layout="constrained")
    for axes, pair in zip(figure.subplots(1, 2), ("front", "rear"), strict=True):
        for row in (row for row in rows if row["leg"].startswith(pair) and row["series"]):
            label = f"{row['leg'].replace('_', ' ')}, {'SBC' if row['compensation'] else 'no SBC'}"
            style = "-" if row["compensation"] else "--"
            axes.plot(row["series"]["time_s"], row["series"]["pitch_deg"], style, label=label)
        axes.set(xlabel="time [s]", ylabel="pitch, nose down [deg]", title=f"{pair} legs lifted")
    _finish(*figure.axes)
    return figure


def foot_forces(facts: dict[str, Any]) -> Figure | None:
    """N figure 6.16: foot forces in the rear left test; below, all four feet over time."""
    rows = pick_all(facts["balance"]["rows"], leg="rear_left")
    if len(rows) < 2:
        return None
    figure = Figure(figsize=(WIDTH, 6.0), layout="constrained")
    grid = figure.subplot_mosaic([["bars", "bars"], ["off", "on"]])
    categories = {"4 feet": "four_feet_forces_n", "3 feet": "foot_forces_n"}
    labels = [f"{count}, {'SBC' if row['compensation'] else 'no SBC'}" for count in categories for row in rows]
    values = np.array([row[key] for key in categories.values() for row in rows])
    for leg, name in enumerate(LEGS):
        grid["bars"].bar(np.arange(len(labels)) + 0.2 * (leg - 1.5), values[:, leg], 0.18, label=name.replace("_", " "))
    grid["bars"].set_xticks(range(len(labels)), labels)
    grid["bars"].set(ylabel="force [N]", title="Rear left leg")
    for row in rows:
        axes = grid["on" if row["compensation"] else "off"]
        if row["series"]:
            for leg, name in enumerate(LEGS):
                axes.plot(row["series"]["time_s"], row["series"]["foot_forces_n"][leg], label=name.replace("_", " "))
        title = "with compensation" if row["compensation"] else "without compensation"
        axes.set(xlabel="time [s]", ylabel="force [N]", title=title)
    _finish(*figure.axes)
    return figure


def maze_tracks(facts: dict[str, Any]) -> Figure | None:
    """N figure 6.19: tracks of the shoulder axis through the maze."""
    rows = [row for row in facts["maze"]["rows"] if row["track_m"]]
    if not rows:
        return None
    figure = Figure(figsize=(WIDTH, 4.2), layout="constrained")
    for axes, row in zip(np.atleast_1d(figure.subplots(1, len(rows))), rows, strict=True):
        axes.plot(*np.transpose(row["path_m"]), "--", color="0.6", label="path")
        axes.plot(*np.transpose(row["track_m"]), linewidth=1.0, label="shoulder axis")
        axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal", title="spine" if row["spine"] else "no spine")
    _finish(*figure.axes)
    return figure


FIGURES: tuple[tuple[str, Callable[[dict[str, Any]], Figure | None]], ...] = (
    ("Straight-line speed (N figure 6.6)", speeds),
    ("Orientation over two gait cycles, trot at 0.8 Hz (N figures 6.7, 6.9)", orientation),
    ("Yaw and spine angle (N figure 6.8)", yaw_and_spine),
    ("Orientation noise (N figures A.7, A.9)", noise),
    ("Time on arcs (N figure 6.12)", turning_times),
    ("Smallest radius (N figure 6.13)", smallest_radii),
    ("Pitch in the balance test (N figure 6.15)", balance_pitch),
    ("Foot forces in the balance test (N figure 6.16)", foot_forces),
    ("Tracks through the maze (N figure 6.19)", maze_tracks),
)
"""Title and function, in the order of the report."""


def _bars(
    axes: Axes, names: Sequence[str], groups: dict[str, list[Row | None]], quantity: str, spread: str | None = None
) -> None:
    """Grouped bars: one colour a group, one place a name; None leaves a gap."""
    width = 0.8 / max(1, len(groups))
    for number, (label, rows) in enumerate(groups.items()):
        where = [place + (number - 0.5 * (len(groups) - 1)) * width for place, row in enumerate(rows) if row]
        kept = [row for row in rows if row]
        single = all(row.get("repeats", 2) < 2 for row in kept)
        errors = None if spread is None or single else np.nan_to_num([row[spread] for row in kept])
        heights = np.nan_to_num(np.array([row[quantity] for row in kept], dtype=np.float64))
        axes.bar(where, heights, 0.9 * width, yerr=errors, label=label)
    axes.set_xticks(range(len(names)), names)


def _finish(*axes: Axes) -> None:
    for one in axes:
        one.grid(alpha=0.3)
        if one.get_legend_handles_labels()[0]:
            one.legend(fontsize="small")
