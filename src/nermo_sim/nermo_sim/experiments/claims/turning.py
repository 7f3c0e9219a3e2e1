"""Claims about turning (N 6.2.2)."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Sequence

from nermo_sim.experiments.claims.board import DEVIATIONS, RADII_AND_TIMES, THEORY, Claims
from nermo_sim.experiments.lookup import Row, pick, quotient, value
from nermo_sim.experiments.straight_line import FREQUENCIES, GAITS
from nermo_sim.experiments.turning import FULL_LOCK, RADII, STRATEGIES


class _Rows:
    def __init__(self, rows: Sequence[Row]) -> None:
        self.all = rows
        self.locked = [row for row in rows if row["path_radius_m"] == FULL_LOCK]

    def lock(self, gait: str, frequency: float, strategy: str) -> Row | None:
        return pick(self.locked, gait=gait, frequency_hz=frequency, strategy=strategy)

    def arc(self, gait: str, frequency: float, strategy: str, radius: float) -> Row | None:
        return pick(self.all, gait=gait, frequency_hz=frequency, strategy=strategy, path_radius_m=radius)

    def times(self) -> dict[str, float | None]:
        """Of the 0.5 m arc of N table 6.4, by strategy."""
        return {strategy: value(self.arc("trot", 0.67, strategy, 0.5), "time_s") for strategy in STRATEGIES}


def radii(claims: Claims, table: Sequence[Row]) -> None:
    """At full lock."""
    rows = _Rows(table)
    leg, mix = rows.lock("trot", 0.67, "leg"), rows.lock("trot", 0.67, "mix")
    theory, lock = claims.about("predicted radius", "theory"), claims.about("radius at full lock")
    theory.number("predicted leg radius [m]", 0.151, value(leg, "theory_radius_m"), THEORY)
    theory.number("predicted mix radius [m]", 0.134, value(mix, "theory_radius_m"), THEORY)
    lock.number("leg radius, trot 0.67 Hz [m]", 0.174, value(leg, "radius_m"), RADII_AND_TIMES)
    lock.number("mix radius, trot 0.67 Hz [m]", 0.135, value(mix, "radius_m"), RADII_AND_TIMES)
    lock.number("mix over leg radius, trot 0.67 Hz [1]", 0.725, quotient(mix, leg, "radius_m"), RADII_AND_TIMES)
    best = min((row["radius_m"] for row in rows.locked if row["strategy"] == "mix"), default=None)
    lock.number("best mix radius [m]", 0.12, best, RADII_AND_TIMES)

    spine = claims.about("spine radius of the lateral walk")
    lateral = {frequency: rows.lock("lateral_walk", frequency, "spine") for frequency in (0.5, 0.8)}
    spine.number("spine radius, lateral walk 0.5 Hz [m]", 0.49, value(lateral[0.5], "radius_m"), RADII_AND_TIMES)
    spine.number("spine radius, lateral walk 0.8 Hz [m]", 0.96, value(lateral[0.8], "radius_m"), RADII_AND_TIMES)
    spine.words(
        "spine turning in the lateral walk widens with frequency",
        lambda: quotient(lateral[0.8], lateral[0.5], "radius_m") > 1.1,  # type: ignore[operator]
    )
    mixed = claims.about("mix over spine radius")
    for gait, frequency, thesis in (("trot", 0.5, 0.375), ("lateral_walk", 0.8, 0.1)):
        ratio = quotient(rows.lock(gait, frequency, "mix"), rows.lock(gait, frequency, "spine"), "radius_m")
        mixed.number(f"mix over spine radius, {gait} {frequency} Hz [1]", thesis, ratio, RADII_AND_TIMES)
    tried = Counter((row["gait"], row["frequency_hz"]) for row in rows.locked)
    combinations = [each for each, strategies in tried.items() if strategies == len(STRATEGIES)]

    def tightest_first(each: tuple[str, float]) -> bool:
        found = [rows.lock(*each, strategy)["radius_m"] for strategy in ("mix", "leg", "spine")]  # type: ignore[index]
        return _rising(found)

    if combinations:
        claims.about("order of the radii").words(
            "mix turns most tightly and the spine least, in every gait and at every frequency",
            lambda: all(map(tightest_first, combinations)),
        )


def arcs(claims: Claims, table: Sequence[Row]) -> None:
    """Time on them, and who leaves them."""
    rows = _Rows(table)
    times = rows.times()
    half_metre = claims.about("0.5 m arc")
    for strategy, thesis in (("spine", 13.0), ("leg", 18.4), ("mix", 14.5)):
        half_metre.number(f"0.5 m arc, trot 0.67 Hz, {strategy} [s]", thesis, times[strategy], RADII_AND_TIMES)
    half_metre.words(
        "0.5 m arc, trot 0.67 Hz: spine faster than mix faster than leg",
        lambda: times["spine"] < times["mix"] < times["leg"],  # type: ignore[operator]
    )
    half_metre.number(
        "share of time that spine turning saves, 0.5 m, trot 0.67 Hz [1]", 0.29, _saved(times), DEVIATIONS
    )
    walked = {(row["gait"], row["frequency_hz"], row["path_radius_m"]) for row in table if row["path_radius_m"]}

    def ordered(each: tuple[str, float, float]) -> bool:
        taken = [rows.arc(each[0], each[1], strategy, each[2]) for strategy in ("spine", "mix", "leg")]
        return _rising([row["time_s"] for row in taken if row is not None and row["followed"]])

    if len(walked) > 2:
        claims.about("order on the arcs").words(
            "spine turning fastest, then mix, then leg, on every arc that is followed",
            lambda: all(map(ordered, walked)),
            ours=f"{sum(map(ordered, walked))} of {len(walked)}",
        )
        _one_metre(claims, rows)
    failed = [row for row in table if row["path_radius_m"] and not row["followed"]]
    claims.about("arcs that fail").words(
        "the only failed arc is spine, lateral walk, 0.8 Hz, 0.5 m",
        lambda: (
            [(row["gait"], row["frequency_hz"], row["strategy"], row["path_radius_m"]) for row in failed]
            == [("lateral_walk", 0.8, "spine", 0.5)]
            if walked
            else None
        ),
        ours="; ".join(f"{r['strategy']}, {r['gait']}, {r['frequency_hz']} Hz, {r['path_radius_m']} m" for r in failed)
        or "none failed",
    )


def _one_metre(claims: Claims, rows: _Rows) -> None:
    for gait, most in (("trot", 0.01), ("walking_trot", 0.03)):
        mix, spine = (rows.arc(gait, 0.5, strategy, 1.0) for strategy in ("mix", "spine"))
        claims.about("1.0 m arc").number(
            f"mix over spine time, 1.0 m, {gait} 0.5 Hz [1]", 1.0 + most, quotient(mix, spine, "time_s"), (0.95, 1.05)
        )

    def faster(gait: str, strategy: str, radius: float) -> bool:
        each = [rows.arc(gait, frequency, strategy, radius) for frequency in FREQUENCIES]
        walked = [row for row in each if row is not None]
        return not all(row["followed"] for row in walked) or _rising([-row["time_s"] for row in walked])

    claims.about("turning with frequency").words(
        "turning is faster at a higher frequency",
        lambda: all(faster(*each) for each in itertools.product(GAITS, STRATEGIES, RADII)),
    )


def robot(claims: Claims, table: Sequence[Row]) -> None:
    """N's real robot on the 0.5 m arc (table 6.4)."""
    rows, topic = _Rows(table), claims.about("0.5 m arc", "robot")
    times = rows.times()
    for strategy, thesis in (("spine", 15.5), ("leg", 22.0), ("mix", 16.3)):
        topic.number(f"robot: 0.5 m arc, trot 0.67 Hz, {strategy} [s]", thesis, times[strategy], RADII_AND_TIMES)
    topic.number("robot: share of time that spine turning saves, 0.5 m [1]", 0.295, _saved(times), DEVIATIONS)
    spine = rows.arc("trot", 0.67, "spine", 0.5)
    topic.words("robot: spine turning does not follow the 0.5 m arc", lambda: not spine["followed"])  # type: ignore[index]


def _saved(times: dict[str, float | None]) -> float | None:
    spine, leg = times["spine"], times["leg"]
    return None if spine is None or leg is None else 1.0 - spine / leg


def _rising(values: Sequence[float]) -> bool:
    return all(a < b for a, b in itertools.pairwise(values))
