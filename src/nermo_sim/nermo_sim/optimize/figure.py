"""The picture of a search."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure


def draw_front(path: Path, front: Sequence[dict[str, Any]], baseline: dict[str, Any], best: dict[str, Any]) -> Path:
    """Speed against deviation of roll: the front, the thesis's parameters and the best for the stated cost."""
    figure = Figure(figsize=(6.5, 4.5), layout="constrained")
    axes = figure.subplots()
    axes.plot([row["roll_sd_deg"] for row in front], [row["speed_m_s"] for row in front], "o-", label="front")
    for row, mark, name in ((baseline, "s", "the thesis's parameters"), (best, "*", "best for the stated cost")):
        axes.plot(row["roll_sd_deg"], row["speed_m_s"], mark, markersize=10, label=name)
    axes.set(xlabel="deviation of roll [deg]", ylabel="speed [m/s]", title="Speed against roll noise")
    axes.grid(alpha=0.3)
    axes.legend()
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=120)
    return path
