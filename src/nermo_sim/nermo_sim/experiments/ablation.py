"""What each spine function is worth: each one switched off alone, read from the tables of the experiments.

A quantity on which a function cannot act is None: nothing but turning acts at full lock (5.45), and the balance test
stands.
"""

from __future__ import annotations

from typing import Any

from nermo_control.spine.functions import SPINE_FUNCTIONS
from nermo_sim.experiments.lookup import pick


def ablation(facts: dict[str, Any]) -> list[dict[str, Any]]:
    """One row with all functions on, then one for each function off: trot, 0.8 Hz straight on, 0.67 Hz turning."""
    return [_row(facts, off) for off in (None, *SPINE_FUNCTIONS)]


def _row(facts: dict[str, Any], off: str | None) -> dict[str, Any]:
    straight = pick(
        facts["straight-line"]["rows"],
        gait="trot",
        frequency_hz=0.8,
        stride_m=0.06,
        spine=off != "stride_extension",
        offset_compensation=off not in ("stride_extension", "offset_compensation"),
    )
    strategy = "leg" if off == "turning" else "mix"
    turning = facts["turning"]["rows"]
    lock = pick(turning, gait="trot", frequency_hz=0.67, strategy=strategy, path_radius_m=0.0)
    arc = pick(turning, gait="trot", frequency_hz=0.67, strategy=strategy, path_radius_m=0.5)
    lifts = [row for row in facts["balance"]["rows"] if row["compensation"] == (off != "balance_compensation")]
    walks = off in (None, "stride_extension", "offset_compensation")
    return {
        "off": off,
        "speed_m_s": straight["speed_m_s"] if straight and walks else None,
        "roll_sd_deg": straight["roll_sd_deg"] if straight and walks else None,
        "pitch_sd_deg": straight["pitch_sd_deg"] if straight and walks else None,
        "radius_m": lock["radius_m"] if lock and off in (None, "turning") else None,
        "arc_time_s": arc["time_s"] if arc and off in (None, "turning") else None,
        "lifts_passed": sum(row["passed"] for row in lifts) if off in (None, "balance_compensation") else None,
    }
