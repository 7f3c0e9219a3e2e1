"""Figures of C chapters 2 and 3, redrawn from our data."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure

WIDTH = 9.0
"""[in]"""
_MODELS = {
    "constraints": "closed loops by constraints",
    "minimal": "minimal coordinates",
    "massless": "mass-less, look-up table",
    "massless_friction": "mass-less, friction and cable",
}


def largest_steps(facts: dict[str, Any]) -> Figure:
    """C figures 2.5 and 2.10 in one, and 2.6: largest stable step and time of a step."""
    figure = Figure(figsize=(WIDTH, 4.2), layout="constrained")
    steps, costs = figure.subplots(1, 2)
    rows = facts["rows"]
    for number, kind in enumerate(dict.fromkeys(_kind(row) for row in rows)):
        own = [row for row in rows if _kind(row) == kind and row["largest_step_s"]]
        label, style = f"{_MODELS[kind[0]]}, {kind[1].replace('_', '-')}", f"C{number}"
        label += "" if kind[2] == 1.0 else ", toe rings"
        ratios = [row["stiffness_ratio"] for row in own]
        steps.plot(ratios, [row["largest_step_s"] for row in own], "o-", color=style, label=label)
        costs.plot(ratios, [row["step_cost_s"] for row in own], "o-", color=style)
    for model, marker in (("constraints", "s"), ("minimal", "^"), ("massless", "D")):
        said = {row["stiffness_ratio"]: row["thesis_step_s"] for row in rows if row["model"] == model}
        said = {ratio: step for ratio, step in said.items() if step is not None}
        steps.plot(list(said), list(said.values()), marker, color="0.4", label=f"C, {_MODELS[model]}")
        cost = next((row["thesis_cost_s"] for row in rows if row["model"] == model), None)
        if cost is not None:
            costs.plot([1.0], [cost], marker, color="0.4")
    steps.set(yscale="log", xlabel="stiffness over the robot's", ylabel="largest stable step [s]")
    costs.set(yscale="log", xlabel="stiffness over the robot's", ylabel="time of a step of four legs [s]")
    for axes in (steps, costs):
        axes.grid(alpha=0.3, which="both")
    figure.legend(*steps.get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize="small")
    return figure


def _kind(row: dict[str, Any]) -> tuple[str, str, float]:
    return row["model"], row["integrator"], row["toe_friction_ratio"]


def leg_force(facts: dict[str, Any]) -> Figure:
    """C figure 2.9: force of a leg over length and foot angle, and over length alone."""
    found = facts["leg_force"]
    lengths, angles = 1e3 * np.asarray(found["lengths_m"]), np.degrees(found["angles_rad"])
    force = np.asarray(found["force_n"])
    figure = Figure(figsize=(WIDTH, 4.0), layout="constrained")
    surface, line = figure.add_subplot(1, 2, 1, projection="3d"), figure.add_subplot(1, 2, 2)
    x, y = np.meshgrid(lengths, angles, indexing="ij")
    surface.plot_surface(x, y, np.where(force > -2.0, force, np.nan), cmap="viridis", linewidth=0.2)
    surface.set(xlabel="length [mm]", ylabel="foot angle [deg]", zlabel="force [N]")
    line.plot(lengths, found["free_toe_force_n"], "k", label="toe free")
    for column in range(len(angles) // 4, len(angles), len(angles) // 4):
        line.plot(lengths, force[:, column], label=f"foot at {angles[column]:.0f} deg")
    line.set(xlabel="length [mm]", ylabel="force [N]", ylim=(-1.0, None))
    line.set_title(
        f"largest stiffness {found['largest_stiffness_n_m']:.0f} N/m, toe free "
        f"{found['largest_stiffness_free_toe_n_m']:.0f} N/m (C: {found['thesis_stiffness_n_m']:.0f})",
        fontsize="small",
    )
    line.grid(alpha=0.3)
    line.legend(fontsize="small")
    return figure


POWERS = {
    "windings_w": "heat in the windings",
    "leg_friction_w": "friction in struts and toes",
    "contact_w": "feet on the ground",
    "stops_w": "stops and cables",
    "loops_w": "open loops",
}
"""Where the energy goes."""


def energy(facts: dict[str, Any]) -> Figure | None:
    """Mean powers of the trot with each model."""
    rows = [row for row in facts["transport"] if not row["fell"]]
    if not rows:
        return None
    figure = Figure(figsize=(0.8 * WIDTH, 3.4), layout="constrained")
    axes = figure.subplots()
    left = np.zeros(len(rows))
    names = [
        f"{_MODELS[row['model']]}\nmechanical {row['mechanical']:.2f}, electrical {row['electrical']:.2f}"
        for row in rows
    ]
    for key, label in POWERS.items():
        values = np.array([max(row.get(key, 0.0), 0.0) for row in rows])
        axes.barh(names, values, left=left, label=label)
        left += values
    axes.set(xlabel="power [W]", title="Cost of transport and where the energy goes")
    axes.legend(fontsize="small")
    return figure
