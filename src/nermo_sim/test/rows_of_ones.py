"""Rows of the experiments' tables that have a value for every claim."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

NOISE = {f"{a}_{k}_deg": 1.0 for a in ("roll", "pitch", "yaw") for k in ("mean", "sd", "amplitude")}
LOST = {f"{name}_m_s": 1.0 for name in ("slip", "pitch", "yaw", "contact", "legs", "reached", "theory")}
FORCES = {"four_feet_forces_n": [1.0] * 4, "foot_forces_n": [1.0] * 4}
WHAT = {
    "straight-line": {
        **NOISE,
        **{"speed_m_s": 1.0, "theory_m_s": 1.0, "losses": LOST, "cycles": {"spine": [1, 2, 3], "yaw": [1, 3, 2]}},
    },
    "turning": {"radius_m": 1.0, "time_s": 1.0, "theory_radius_m": 1.0, "followed": True},
    "balance": {"passed": True, "thesis_passed": True, "pitch_deg": 1.0, "ground_impact_s": 1.0, **FORCES},
    "maze": {"finished": True, "time_s": 1.0, "thesis_time_s": 1.0, "speed_m_s": 1.0, **NOISE},
}


def rows_of_ones(cases: Sequence[tuple[str, Any]]) -> dict[str, Any]:
    """Tables with a row for each case of an experiment."""
    facts: dict[str, Any] = {
        name: {"rows": [{**asdict(case), **what} for own, case in cases if own == name]} for name, what in WHAT.items()
    }
    for number, row in enumerate(facts["straight-line"]["rows"]):
        row["speed_m_s"] += number  # speeds that are all alike have no correlation
    return facts
