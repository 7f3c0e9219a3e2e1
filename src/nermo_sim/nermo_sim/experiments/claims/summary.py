"""All claims of N 6.2, and what the tables of the experiments say about them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from nermo_sim.experiments import maze
from nermo_sim.experiments.claims import standing, turning, walking
from nermo_sim.experiments.claims.board import DEVIATIONS, RADII_AND_TIMES, SPEEDS, Claims
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
    _maze(claims, facts["maze"]["rows"])
    walking.losses(claims, straight)
    walking.robot(claims, straight)
    turning.robot(claims, turns)
    standing.robot(claims, facts["balance"]["rows"])
    _gaze(claims, facts.get("gaze", {}).get("rows", []))
    return claims.rows


def _maze(claims: Claims, rows: Sequence[Row]) -> None:
    plain, spine = pick(rows, spine=False), pick(rows, spine=True)
    claims.about("maze finished").words(
        "the maze is finished with and without spine",
        lambda: plain["finished"] and spine["finished"],  # type: ignore[index]
    )
    if plain is None or spine is None or plain["thesis_time_s"] is None:
        return
    if not (plain["finished"] and spine["finished"]):
        return
    for row, name in ((plain, "no spine"), (spine, "spine")):
        thesis, pace = maze.THESIS[row["spine"]], claims.about(f"maze time, {name}")
        pace.number(f"maze time, {name} [s]", thesis["time_s"], row["time_s"], RADII_AND_TIMES)
        pace.number(f"maze speed, {name} [m/s]", thesis["speed_m_s"], row["speed_m_s"], SPEEDS)
        for axis in ("pitch", "roll"):
            deviation = f"{axis}_sd_deg"
            claims.about(f"maze {axis}").number(
                f"maze {axis} deviation, {name} [deg]", thesis[deviation], row[deviation], DEVIATIONS
            )
    gain = 1.0 - spine["time_s"] / plain["time_s"]
    claims.about("maze time, spine").number(
        "maze: share of time that the spine saves [1]", 0.28, gain, SPEEDS, of_ours=(0.20, 0.36)
    )
    claims.about("robot's maze", "robot").number(
        "robot: share of time that the spine saves in a (smaller) maze [1]", 0.32, gain, DEVIATIONS
    )
    for axis, raised in (("pitch", 1.67), ("roll", 1.34)):
        topic, ratio = claims.about(f"maze {axis}"), quotient(spine, plain, f"{axis}_sd_deg")
        topic.number(f"maze: {axis} deviation with spine over without [1]", raised, ratio, DEVIATIONS)
        topic.words(f"maze: the spine raises the {axis} deviation", lambda ratio=ratio: ratio > 1.0)  # type: ignore[misc]


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
