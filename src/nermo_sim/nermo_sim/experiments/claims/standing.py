"""Claims about balance on three feet (N 6.2.3)."""

from __future__ import annotations

from typing import Any

import numpy as np

from nermo_description.parameters import LEGS
from nermo_sim.experiments import balance
from nermo_sim.experiments.claims.board import DEVIATIONS, FORCES, RADII_AND_TIMES, Claims
from nermo_sim.experiments.lookup import Row, pick, value


def lifts(claims: Claims, facts: dict[str, Any]) -> None:
    """Which lifts pass, and what they do to the pitch."""
    rows = facts["rows"]
    for row in rows:
        claims.about("balance table").words(
            f"balance: {_cell(row)}: {'pass' if row['thesis_passed'] else 'fail'}",
            lambda row=row: row["passed"] == row["thesis_passed"],  # type: ignore[misc]
            ours="pass" if row["passed"] else "fail",
        )
    if "com_interval_m" in facts:
        interval = facts["com_interval_m"]
        claims.about("fore-aft COM", "own").words(
            "the balance table holds over an interval of the fore-aft COM", lambda: interval is not None, interval
        )
    for pair, thesis in (("front", 0.7), ("rear", 0.27)):
        without, with_it = (
            [abs(row["pitch_deg"]) for row in rows if row["leg"].startswith(pair) and row["compensation"] == on]
            for on in (False, True)
        )
        if without and with_it:
            ratio = float(np.mean(with_it) / np.mean(without))
            claims.about(f"pitch of {pair} lifts").number(
                f"pitch change with over without compensation, {pair} lifts [1]", thesis, ratio, DEVIATIONS
            )
    for leg, thesis in (("rear_right", 1.2), ("rear_left", 1.75)):
        impact = value(pick(rows, leg=leg, compensation=False), "ground_impact_s")
        claims.about("ground impact").number(
            f"ground impact of the failed lift, {leg.replace('_', ' ')} [s]", thesis, impact, RADII_AND_TIMES
        )


def loads(claims: Claims, rows: list[Row]) -> None:
    """Forces on the feet when the rear left one is to be lifted (N figure 6.16)."""
    plain, helped = (pick(rows, leg="rear_left", compensation=on) for on in (False, True))
    if plain is None or helped is None:
        return
    rear_left, front_right = LEGS.index("rear_left"), LEGS.index("front_right")
    before, after = (row["four_feet_forces_n"] for row in (plain, helped))
    thesis, front = balance.THESIS_REAR_LEFT_N, balance.THESIS_FRONT_RIGHT_N
    rear = claims.about("load on the rear left foot")
    rear.number("rear left load on four feet, no compensation [N]", thesis[False], before[rear_left], FORCES)
    rear.number("rear left load on four feet, compensation [N]", thesis[True], after[rear_left], FORCES)
    rear.words("compensation takes load off the rear left foot", lambda: after[rear_left] < before[rear_left])
    claims.about("load on the front right foot").number(
        "front right load on four feet, compensation [N]", front, after[front_right], FORCES
    )
    three = helped["foot_forces_n"]
    on_diagonal = (three[0] + three[3]) / sum(three)
    claims.about("load on the diagonal").words(
        "rear left lifted, compensation: most of the load on the diagonal front left, rear right",
        lambda: on_diagonal > 0.5,
        ours=round(on_diagonal, 3),
    )


def robot(claims: Claims, rows: list[Row]) -> None:
    """N's real robot needs compensation for every lift (table 6.5)."""
    for row in rows:
        claims.about("balance table", "robot").words(
            f"robot: balance: {_cell(row)}: {'pass' if row['compensation'] else 'fail'}",
            lambda row=row: row["passed"] == row["compensation"],  # type: ignore[misc]
            ours="pass" if row["passed"] else "fail",
        )


def _cell(row: Row) -> str:
    return f"{row['leg'].replace('_', ' ')}, {'with' if row['compensation'] else 'without'} compensation"
