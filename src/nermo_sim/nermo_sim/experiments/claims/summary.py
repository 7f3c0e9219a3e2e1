"""All claims of N 6.2, and what the tables of the experiments say about them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from nermo_sim.experiments.claims import mazes, standing, turning, walking
from nermo_sim.experiments.claims.board import Claims
from nermo_sim.experiments.lookup import Row, pick, quotient


def summary(facts: dict[str, Any]) -> list[Row]:
    """One row a claim; those whose data is missing are left out."""
    claims = Claims()
    straight, turns = facts["straight-line"]["rows"], facts["turning"]["rows"]
    walking.speeds(claims, straight)
    walking.orientation(claims, straight)
    turning.radii(claims, turns)
    turning.arcs(claims, turns)
    standing.lifts(claims, facts["balance"])
    standing.loads(claims, facts["balance"]["rows"])
    mazes.twin(claims, facts["maze"]["rows"])
    walking.losses(claims, straight)
    walking.robot(claims, straight)
    turning.robot(claims, turns)
    standing.robot(claims, facts["balance"]["rows"])
    _gaze(claims, facts.get("gaze", {}).get("rows", []))
    return claims.rows


def _gaze(claims: Claims, rows: Sequence[Row]) -> None:
    """N 7.1.2 proposes it and prints no number."""
    for axis, robot, mode in (("yaw", "nermo_lite", "spine"), ("yaw", "nermo", "imu"), ("pitch", "nermo", "imu")):
        on, off = (pick(rows, robot=robot, gaze=each) for each in (mode, "off"))
        ratio = quotient(on, off, f"head_{axis}_sd_deg")
        if ratio is not None:
            claims.about("gaze", "own").words(
                f"{robot}: the neck lowers the {axis} deviation of the head's cameras (N 7.1.2)",
                lambda ratio=ratio: ratio < 1.0,  # type: ignore[misc]
                ours=round(ratio, 3),
            )
