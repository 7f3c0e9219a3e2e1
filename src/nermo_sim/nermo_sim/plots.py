"""Pictures of runs and of experiment tables, as PNG files."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from nermo_description.parameters import LEGS
from nermo_sim.run_table import Recording

Array = NDArray[np.float64]


def plot_run(recording: Recording, path: Path, title: str, window: float = 2.5) -> None:
    """Track, orientation and gait diagram of a run; the latter two over its last `window` seconds."""
    figure = Figure(figsize=(9.0, 8.0), layout="constrained")
    track, orientation, gait = figure.subplots(3, 1)
    figure.suptitle(title)
    _track(track, recording)
    _orientation(orientation, recording, window)
    _gait_diagram(gait, recording, window)
    figure.savefig(path, dpi=120)


def _track(axes: Axes, recording: Recording) -> None:
    position = recording.position
    axes.plot(position[:, 0], 1e3 * position[:, 1])
    axes.set(xlabel="x [m]", ylabel="y [mm]", title="Track of base_link")
    axes.grid(alpha=0.3)


def _orientation(axes: Axes, recording: Recording, window: float) -> None:
    last = recording.time >= recording.time[-1] - window
    for name, angle in zip(("roll", "pitch", "yaw"), np.degrees(recording.roll_pitch_yaw[last]).T, strict=True):
        axes.plot(recording.time[last], angle, label=name)
    axes.set(xlabel="time [s]", ylabel="angle [deg]", title="Orientation")
    axes.grid(alpha=0.3)
    axes.legend(loc="upper right")


def _gait_diagram(axes: Axes, recording: Recording, window: float) -> None:
    last = recording.time >= recording.time[-1] - window
    time = recording.time[last]
    draw_gait(axes, time, recording.phases[last] == 0, recording.foot_forces[last])
    axes.set(title=f"Gait: {GAIT_KEY}", xlim=(time[0], time[-1]))


GAIT_KEY = "planned stance (grey), load (blue; darkest: half the weight)"
"""What `draw_gait` shows, for a title."""


def draw_gait(axes: Axes, time: Array, planned: NDArray[np.bool_], load: Array) -> None:
    """Bars of each leg: stance as planned, and below it how much the foot carries.

    No threshold decides what is contact: a foot that drags or bounces is seen to do so.

    Args:
        axes: Where to draw.
        time: (n,) [s], rising.
        planned: (n, 4), whether the leg shall stand.
        load: (n, 4), vertical force [N].
    """
    full = 0.5 * float(load.sum(axis=1).mean())
    edges = np.append(time, time[-1] + np.median(np.diff(time)))
    for row in range(len(LEGS)):
        where = list(planned[:, row])
        axes.fill_between(time, row - 0.4, row - 0.1, where=where, step="post", color="0.75", linewidth=0.0)
        axes.pcolormesh(edges, [row - 0.1, row + 0.4], load[None, :, row], cmap="Blues", vmin=0.0, vmax=full or 1.0)
    axes.set(xlabel="time [s]", yticks=range(len(LEGS)), yticklabels=[leg.replace("_", " ") for leg in LEGS])
    axes.invert_yaxis()


def plot_speeds(rows: Sequence[dict[str, Any]], path: Path) -> None:
    """Speed by frequency and gait, and by stride length, as N figure 6.6."""
    figure = Figure(figsize=(10.0, 4.5), layout="constrained")
    by_frequency, by_stride = figure.subplots(1, 2)
    longest = max(row["stride_m"] for row in rows)
    kinds = dict.fromkeys(map(_kind, rows))
    for index, kind in enumerate(kinds):
        gait, spine, offsets = kind
        of_gait = [row for row in rows if _kind(row) == kind]
        full = [row for row in of_gait if row["stride_m"] == longest]
        label = f"{gait.replace('_', ' ')}, spine {'with offsets' if offsets else 'on' if spine else 'off'}"
        _speeds(by_frequency, full, "frequency_hz", label, f"C{index}")
        strides = [row for row in of_gait if row["frequency_hz"] == 0.8]
        if len(strides) > 1:
            _speeds(by_stride, strides, "stride_m", label, f"C{index}")
    by_frequency.set(xlabel="gait frequency [Hz]", ylabel="speed [m/s]", title="Dashed: no-slip theory, x: thesis")
    by_stride.set(xlabel="stride length [m]", ylabel="speed [m/s]", title="At 0.8 Hz")
    for axes in (by_frequency, by_stride):
        axes.grid(alpha=0.3)
        axes.set_ylim(bottom=0.0)
        if axes.lines:
            axes.legend()
    figure.savefig(path, dpi=120)


def _kind(row: dict[str, Any]) -> tuple[str, bool, bool]:
    """Runs that one line joins: gait, spine, and whether offsets make up for the hip's roll in it."""
    return row["gait"], row["spine"], row["offset_compensation"]


def spreads(rows: Sequence[dict[str, Any]]) -> list[float] | None:
    """Deviations of the speeds [m/s], for error bars; None where every run was made once, and has none."""
    several = [row["repeats"] > 1 for row in rows]
    if not any(several):
        return None
    return [row["speed_sd_m_s"] if repeated else 0.0 for row, repeated in zip(rows, several, strict=True)]


def _speeds(axes: Axes, rows: Sequence[dict[str, Any]], over: str, label: str, color: str) -> None:
    rows = sorted(rows, key=lambda row: float(row[over]))
    where = [row[over] for row in rows]
    axes.errorbar(where, [row["speed_m_s"] for row in rows], spreads(rows), marker="o", label=label, color=color)
    axes.plot(where, [row["theory_m_s"] for row in rows], "--", color=color, alpha=0.5)
    printed = [(row[over], row["thesis_m_s"]) for row in rows if row["thesis_m_s"] is not None]
    if printed:
        axes.plot(*zip(*printed, strict=True), "x", color=color, markersize=10)


def plot_on_robot(rows: Sequence[dict[str, Any]], path: Path) -> None:
    """Speed by frequency of a real mouse (full; both uncertainties), its twin (hollow) and N's robot (crosses)."""
    figure = Figure(figsize=(7.0, 4.5), layout="constrained")
    axes = figure.subplots()
    for index, kind in enumerate(dict.fromkeys(map(_kind, rows))):
        of_gait = sorted((row for row in rows if _kind(row) == kind), key=lambda row: float(row["frequency_hz"]))
        label = f"{kind[0].replace('_', ' ')}, spine {'on' if kind[1] else 'off'}"
        color = f"C{index}"
        axes.errorbar(*_known(of_gait, ""), marker="o", label=label, color=color, capsize=3)
        axes.errorbar(*_known(of_gait, "twin_"), marker="s", mfc="none", ls="--", alpha=0.6, color=color, capsize=3)
        axes.plot(*_known(of_gait, "thesis_robot_")[:2], "x", color=color, markersize=10)
    title = "full: robot, hollow: its twin, x: the thesis's robot"
    axes.set(xlabel="gait frequency [Hz]", ylabel="speed [m/s]", title=title)
    axes.grid(alpha=0.3)
    axes.set_ylim(bottom=0.0)
    axes.legend()
    figure.savefig(path, dpi=120)


def _known(rows: Sequence[dict[str, Any]], whose: str) -> tuple[list[float], list[float], list[float]]:
    """Frequencies [Hz], speeds and their deviations [m/s] of the rows that have a speed of this one's."""
    known = [row for row in rows if row[f"{whose}speed_m_s"] is not None]
    parts = (f"{whose}scatter_speed_m_s", f"{whose}tracker_speed_m_s")
    wide = [math.hypot(*(row.get(part) or 0.0 for part in parts)) for row in known]
    return [row["frequency_hz"] for row in known], [row[f"{whose}speed_m_s"] for row in known], wide


def plot_bars_on_robot(
    rows: Sequence[dict[str, Any]], path: Path, quantity: str, label: str, names: Sequence[str], title: str
) -> None:
    """A quantity by row of a real mouse (both uncertainties), its twin, and N's two where N prints them."""
    figure = Figure(figsize=(max(7.0, 1.3 * len(rows)), 4.5), layout="constrained")
    axes = figure.subplots()
    whom = {"": "robot", "twin_": "its twin", "thesis_robot_": "the thesis's robot", "thesis_twin_": "its twin, N"}
    there = {whose: who for whose, who in whom.items() if f"{whose}{quantity}" in rows[0]}
    for index, (whose, who) in enumerate(there.items()):
        known = [(place, row) for place, row in enumerate(rows) if row[f"{whose}{quantity}"] is not None]
        parts = (f"{whose}scatter_{quantity}", f"{whose}tracker_{quantity}")
        wide = [math.hypot(*(row.get(part) or 0.0 for part in parts)) for _, row in known]
        where = [place + 0.2 * (index - 0.5 * (len(there) - 1)) for place, _ in known]
        axes.bar(where, [row[f"{whose}{quantity}"] for _, row in known], 0.18, yerr=wide, label=who, capsize=3)
    axes.set_xticks(range(len(rows)), names)
    axes.set(ylabel=label, title=title)
    figure.legend(loc="outside lower center", ncols=len(there))  # bars may reach anywhere
    figure.savefig(path, dpi=120)
