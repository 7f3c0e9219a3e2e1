"""The main numbers: thesis theory, thesis twin, thesis robot, ours, and the ratio of ours to the thesis's twin."""

from __future__ import annotations

import math
from typing import Any

from nermo_sim.experiments.claims.walking import walk
from nermo_sim.experiments.lookup import Row, pick, value
from nermo_sim.experiments.straight_line import STRIDE
from nermo_sim.experiments.turning import FULL_LOCK


def comparison(facts: dict[str, Any]) -> list[Row]:
    """Thesis theory, thesis twin, thesis robot, ours, and the ratio of ours to the thesis's twin."""
    straight, turning, balanced, mazes = (
        facts[name]["rows"] for name in ("straight-line", "turning", "balance", "maze")
    )
    table: list[Row] = []

    def add(quantity: str, theory: float | None, twin: float | None, robot: float | None, ours: float | None) -> None:
        if ours is not None and not math.isnan(ours):
            ratio = ours / twin if twin else None
            table.append(
                {"quantity": quantity, "theory": theory, "twin": twin, "robot": robot, "ours": ours, "ratio": ratio}
            )

    def speed(gait: str, frequency: float, spine: bool, stride: float = STRIDE) -> float | None:
        return value(walk(straight, gait, frequency, spine, stride), "speed_m_s")

    add("trot 0.8 Hz, no spine [m/s]", 0.096, 0.086, None, speed("trot", 0.8, False))
    add("trot 0.8 Hz, spine [m/s]", 0.12, 0.105, None, speed("trot", 0.8, True))
    add("trot 0.67 Hz, no spine [m/s]", 0.0804, 0.076, 0.067, speed("trot", 0.67, False))
    add("trot 0.67 Hz, spine [m/s]", 0.1005, 0.082, 0.077, speed("trot", 0.67, True))
    add("lateral walk 0.8 Hz [m/s]", 0.0706, 0.068, 0.064, speed("lateral_walk", 0.8, False))
    add("spine alone, 0.8 Hz [m/s]", 0.024, 0.019, None, speed("trot", 0.8, True, 0.0))
    for strategy, theory, twin in (("leg", 0.151, 0.174), ("mix", 0.134, 0.135)):
        row = pick(turning, gait="trot", frequency_hz=0.67, strategy=strategy, path_radius_m=FULL_LOCK)
        add(f"radius, {strategy}, trot 0.67 Hz [m]", theory, twin, None, value(row, "radius_m"))
    for frequency, twin in ((0.5, 0.49), (0.8, 0.96)):
        row = pick(turning, gait="lateral_walk", frequency_hz=frequency, strategy="spine", path_radius_m=FULL_LOCK)
        add(f"radius, spine, lateral walk {frequency} Hz [m]", None, twin, None, value(row, "radius_m"))
    for strategy, twin, robot in (("spine", 13.0, 15.5), ("leg", 18.4, 22.0), ("mix", 14.5, 16.3)):
        row = pick(turning, gait="trot", frequency_hz=0.67, strategy=strategy, path_radius_m=0.5)
        add(f"0.5 m arc, {strategy}, trot 0.67 Hz [s]", None, twin, robot, value(row, "time_s"))
    passed = sum(row["passed"] == row["thesis_passed"] for row in balanced)
    robot_cells = sum(row["passed"] == row["compensation"] for row in balanced)
    add("balance cells as in the thesis's twin", None, 8, None, passed)
    add("balance cells as in the thesis's robot (it needs compensation always)", None, 6, 8, robot_cells)
    for spine in (False, True):
        row, name = pick(mazes, spine=spine), "spine" if spine else "no spine"
        if row is not None and row["finished"] and row["thesis_time_s"]:
            add(f"maze, {name} [s]", None, row["thesis_time_s"], None, row["time_s"])
            for quantity in ("speed_m_s", "roll_sd_deg", "pitch_sd_deg"):
                unit = "m/s" if quantity == "speed_m_s" else "deg"
                label = quantity.removesuffix("_m_s").removesuffix("_deg").replace("_sd", " deviation")
                add(f"maze, {name}, {label} [{unit}]", None, row[f"thesis_{quantity}"], None, row[quantity])
    return table
