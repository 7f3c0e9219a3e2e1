"""Claims about the way through a maze (N 6.2.4)."""

from __future__ import annotations

from collections.abc import Sequence

from nermo_sim.experiments import maze
from nermo_sim.experiments.claims.board import DEVIATIONS, RADII_AND_TIMES, SPEEDS, Claims
from nermo_sim.experiments.lookup import Row, pick, quotient


def twin(claims: Claims, rows: Sequence[Row]) -> None:
    """Times, speeds and deviations of N's twin, and what its robot gains in a smaller maze."""
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
    robot(claims, rows)
    for axis, raised in (("pitch", 1.67), ("roll", 1.34)):
        topic, ratio = claims.about(f"maze {axis}"), quotient(spine, plain, f"{axis}_sd_deg")
        topic.number(f"maze: {axis} deviation with spine over without [1]", raised, ratio, DEVIATIONS)
        topic.words(f"maze: the spine raises the {axis} deviation", lambda ratio=ratio: ratio > 1.0)  # type: ignore[misc]


def robot(claims: Claims, rows: Sequence[Row]) -> None:
    """N's real robot "took 32 % less time" with the spine, in a smaller maze; both must have come to its end."""
    share = quotient(pick(rows, spine=True, finished=True), pick(rows, spine=False, finished=True), "time_s")
    gain = None if share is None else 1.0 - share
    claims.about("robot's maze", "robot").number(
        "robot: share of time that the spine saves in a (smaller) maze [1]", 0.32, gain, DEVIATIONS
    )
