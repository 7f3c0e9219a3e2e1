"""What N claims in chapter 6, row by row beside ours: {claim, thesis, ours, ratio, band, within}.

A number is within its band where the ratio ours / thesis is (`band` is a pair); a claim in words is either true of ours
or not (`thesis` is true, `band` null). A claim whose data a quick run does not have is left out. With the spine means
stride extension with offset compensation, unless said otherwise.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from nermo_description.parameters import LEGS
from nermo_sim.experiments import balance, maze
from nermo_sim.experiments.lookup import Row, pick, pick_all
from nermo_sim.experiments.straight_line import FREQUENCIES, GAITS, STRIDE
from nermo_sim.experiments.turning import FULL_LOCK, RADII, STRATEGIES

Band = tuple[float, float]
SPEEDS: Band = (0.85, 1.15)
RADII_AND_TIMES: Band = (0.8, 1.25)
DEVIATIONS: Band = (1.0 / 1.5, 1.5)
THEORY: Band = (0.95, 1.05)
FORCES: Band = (1.0 / 1.5, 1.5)
"""The issue sets none for forces and shares: the one of the deviations."""


class Claims:
    """Collects the rows; a claim of which a part is missing is left out."""

    def __init__(self) -> None:
        self.rows: list[Row] = []

    def number(self, claim: str, thesis: float, ours: float | None, band: Band, of_ours: Band | None = None) -> None:
        """A number of N. of_ours: a band for our value itself, where that is how the target is set."""
        if ours is None or math.isnan(ours):
            return
        ratio = ours / thesis
        within = of_ours[0] <= ours <= of_ours[1] if of_ours else band[0] <= ratio <= band[1]
        shown = [of_ours[0] / thesis, of_ours[1] / thesis] if of_ours else list(band)
        self._add(claim, thesis, float(ours), float(ratio), shown, within)

    def words(self, claim: str, holds: Callable[[], bool | None], ours: Any = None) -> None:
        """A claim in words. `holds` may fail for want of rows, then there is no row."""
        try:
            within = holds()
        except (TypeError, KeyError):
            return
        if within is not None:
            self._add(claim, True, bool(within) if ours is None else ours, None, None, bool(within))

    def _add(self, claim: str, thesis: Any, ours: Any, ratio: float | None, band: Any, within: bool) -> None:
        row = {"claim": claim, "thesis": thesis, "ours": ours, "ratio": ratio, "band": band, "within": within}
        self.rows.append(row)


def summary(facts: dict[str, Any]) -> list[Row]:
    """All claims of N 6.2 and what the tables of the experiments say about them."""
    claims = Claims()
    _straight_line(claims, facts["straight-line"]["rows"])
    _orientation(claims, facts["straight-line"]["rows"])
    _turning(claims, facts["turning"]["rows"])
    _balance(claims, facts["balance"])
    _maze(claims, facts["maze"]["rows"])
    _theory(claims, facts["straight-line"]["rows"])
    _gaze(claims, facts.get("gaze", {}).get("rows", []))
    return claims.rows


def _walk(rows: Sequence[Row], gait: str, frequency: float, spine: bool, stride: float = STRIDE) -> Row | None:
    return pick(rows, gait=gait, frequency_hz=frequency, stride_m=stride, spine=spine, offset_compensation=spine)


def _value(row: Row | None, name: str) -> float | None:
    return None if row is None else row[name]


def _over(a: Row | None, b: Row | None, name: str) -> float | None:
    """Quotient of a quantity in two rows."""
    return None if a is None or b is None else float(a[name] / b[name])


def _straight_line(claims: Claims, rows: Sequence[Row]) -> None:
    fast, with_spine, lateral = (_walk(rows, *case) for case in _FASTEST)
    alone, slow = _walk(rows, "trot", 0.8, True, 0.0), [_walk(rows, "trot", 0.5, spine) for spine in (False, True)]
    claims.number("no-slip speed of the trot at 0.8 Hz, no spine [m/s]", 0.096, _value(fast, "theory_m_s"), THEORY)
    claims.number("no-slip speed of the trot at 0.8 Hz, spine [m/s]", 0.12, _value(with_spine, "theory_m_s"), THEORY)
    claims.number("speed of the trot at 0.8 Hz, no spine [m/s]", 0.086, _value(fast, "speed_m_s"), SPEEDS)
    claims.number("speed of the trot at 0.8 Hz, spine [m/s]", 0.105, _value(with_spine, "speed_m_s"), SPEEDS)
    claims.number("speed of the spine alone, stride 0 [m/s]", 0.019, _value(alone, "speed_m_s"), SPEEDS)
    gain, slow_gain = _over(with_spine, fast, "speed_m_s"), _over(slow[1], slow[0], "speed_m_s")
    claims.number("speed with spine over without, trot 0.8 Hz [1]", 1.22, gain, SPEEDS, of_ours=(1.15, 1.30))
    claims.number("speed with spine over without, trot 0.5 Hz [1]", 1.05, slow_gain, SPEEDS)
    claims.words("the spine gains more at 0.8 Hz than at 0.5 Hz", lambda: gain > slow_gain)  # type: ignore[operator]
    claims.number("trot over lateral walk at 0.8 Hz, no spine [1]", 1.27, _over(fast, lateral, "speed_m_s"), SPEEDS)
    claims.number("trot over lateral walk at 0.8 Hz, spine [1]", 1.48, _over(with_spine, lateral, "speed_m_s"), SPEEDS)
    for frequency in FREQUENCIES:
        speeds = [_value(_walk(rows, gait, frequency, False), "speed_m_s") for gait in GAITS]
        if None not in speeds:
            claims.words(
                f"trot > walking trot > lateral walk in speed at {frequency} Hz",
                lambda speeds=speeds: speeds[0] > speeds[1] > speeds[2],  # type: ignore[misc]
            )
    by_stride = sorted((row["stride_m"], row["speed_m_s"]) for row in rows if _is_trot(row, 0.8, False))
    if len(by_stride) > 2:
        claims.words("speed rises linearly with the stride (r > 0.98)", lambda: _correlation(by_stride) > 0.98)
    growth = {gait: _over(_walk(rows, gait, 0.8, False), _walk(rows, gait, 0.5, False), "speed_m_s") for gait in GAITS}
    for gait in GAITS[:2]:
        claims.number(f"{gait}: speed at 0.8 over 0.5 Hz, linear in frequency [1]", 1.6, growth[gait], SPEEDS)
    claims.words(
        "the lateral walk's speed grows less with frequency than the trots' (it saturates)",
        lambda: growth["lateral_walk"] < 0.95 * min(growth["trot"], growth["walking_trot"]),  # type: ignore[operator,type-var]
    )


_FASTEST = (("trot", 0.8, False), ("trot", 0.8, True), ("lateral_walk", 0.8, False))


def _is_trot(row: Row, frequency: float, spine: bool) -> bool:
    return (row["gait"], row["frequency_hz"], row["spine"]) == ("trot", frequency, spine)


def _correlation(pairs: Sequence[tuple[float, float]]) -> float:
    return float(np.corrcoef(np.asarray(pairs).T)[0, 1])


def _orientation(claims: Claims, rows: Sequence[Row]) -> None:
    fast, spine = _walk(rows, "trot", 0.8, False), _walk(rows, "trot", 0.8, True)
    bare = pick(rows, gait="trot", frequency_hz=0.8, stride_m=STRIDE, spine=True, offset_compensation=False)
    for name, thesis in (("yaw_amplitude_deg", 1.5), ("yaw_sd_deg", 2.86), ("roll_sd_deg", 1.33)):
        ratio = _over(spine, fast, name)
        claims.number(f"{_label(name)} with spine over without, trot 0.8 Hz [1]", thesis, ratio, DEVIATIONS)
        claims.words(f"the spine raises the {_label(name)}", lambda ratio=ratio: ratio > 1.0)  # type: ignore[misc]
    claims.words(
        "roll stays within 8 deg in the trot at 0.8 Hz, spine or not",
        lambda: max(fast["roll_amplitude_deg"], spine["roll_amplitude_deg"]) <= 8.0,  # type: ignore[index]
        ours=None if spine is None else round(spine["roll_amplitude_deg"], 2),
    )
    claims.words(
        "pitch deviation under 2 deg in all gaits",
        lambda: max(row["pitch_sd_deg"] for row in rows) < 2.0,
        ours=round(max(row["pitch_sd_deg"] for row in rows), 2),
    )
    claims.number("mean pitch, nose down, trot 0.8 Hz [deg]", 0.5, _value(fast, "pitch_mean_deg"), DEVIATIONS)
    for name, thesis in (("roll_amplitude_deg", 0.875), ("roll_sd_deg", 0.85)):
        ratio = _over(spine, bare, name)
        claims.number(f"{_label(name)} with offset compensation over without [1]", thesis, ratio, DEVIATIONS)
        claims.words(f"offset compensation lowers the {_label(name)}", lambda ratio=ratio: ratio < 1.0)  # type: ignore[misc]
    claims.words(
        "offset compensation leaves the yaw deviation alone (20 %)",
        lambda: abs(_over(spine, bare, "yaw_sd_deg") - 1.0) < 0.2,  # type: ignore[operator]
    )
    claims.words(
        "offset compensation leaves the pitch deviation alone (20 %)",
        lambda: abs(_over(spine, bare, "pitch_sd_deg") - 1.0) < 0.2,  # type: ignore[operator]
    )
    claims.words(
        "roll noise grows with each frequency step, trot",
        lambda: _rising([_walk(rows, "trot", frequency, False)["roll_sd_deg"] for frequency in FREQUENCIES]),  # type: ignore[index]
    )
    claims.words(
        "roll noise grows with a lower duty factor at 0.8 Hz",
        lambda: _rising([_walk(rows, gait, 0.8, False)["roll_sd_deg"] for gait in GAITS[::-1]]),  # type: ignore[index]
    )
    shorter = _walk(rows, "trot", 0.8, False, 0.048)
    claims.words("stride 0.8 to 1.0 raises the pitch deviation", lambda: _over(fast, shorter, "pitch_sd_deg") > 1.0)  # type: ignore[operator]
    claims.words("the spine raises the pitch deviation", lambda: _over(spine, fast, "pitch_sd_deg") > 1.0)  # type: ignore[operator]
    if spine is not None and spine["cycles"]:
        pairs = list(zip(spine["cycles"]["spine"], spine["cycles"]["yaw"], strict=True))
        claims.words(
            "yaw follows the spine angle (|r| > 0.8)",
            lambda: abs(_correlation(pairs)) > 0.8,
            ours=round(_correlation(pairs), 3),
        )
    claims.words(
        "roll and yaw deviation are smallest without spine",
        lambda: all(_over(spine, fast, f"{axis}_sd_deg") > 1.0 for axis in ("roll", "yaw")),  # type: ignore[operator]
    )


def _label(name: str) -> str:
    axis, kind, _ = name.split("_")
    return f"{axis} {'deviation' if kind == 'sd' else kind}"


def _rising(values: Sequence[float]) -> bool:
    return all(a < b for a, b in itertools.pairwise(values))


def _turning(claims: Claims, rows: Sequence[Row]) -> None:
    def lock(gait: str, frequency: float, strategy: str) -> Row | None:
        return pick(rows, gait=gait, frequency_hz=frequency, strategy=strategy, path_radius_m=FULL_LOCK)

    def arc(gait: str, frequency: float, strategy: str, radius: float) -> Row | None:
        return pick(rows, gait=gait, frequency_hz=frequency, strategy=strategy, path_radius_m=radius)

    leg, mix = lock("trot", 0.67, "leg"), lock("trot", 0.67, "mix")
    claims.number("predicted leg radius [m]", 0.151, _value(leg, "theory_radius_m"), THEORY)
    claims.number("predicted mix radius [m]", 0.134, _value(mix, "theory_radius_m"), THEORY)
    claims.number("leg radius, trot 0.67 Hz [m]", 0.174, _value(leg, "radius_m"), RADII_AND_TIMES)
    claims.number("mix radius, trot 0.67 Hz [m]", 0.135, _value(mix, "radius_m"), RADII_AND_TIMES)
    claims.number("mix over leg radius, trot 0.67 Hz [1]", 0.725, _over(mix, leg, "radius_m"), RADII_AND_TIMES)
    locked = [row for row in rows if row["path_radius_m"] == FULL_LOCK]
    best = min((row["radius_m"] for row in locked if row["strategy"] == "mix"), default=None)
    claims.number("best mix radius [m]", 0.12, best, RADII_AND_TIMES)
    lateral = {frequency: lock("lateral_walk", frequency, "spine") for frequency in (0.5, 0.8)}
    claims.number("spine radius, lateral walk 0.5 Hz [m]", 0.49, _value(lateral[0.5], "radius_m"), RADII_AND_TIMES)
    claims.number("spine radius, lateral walk 0.8 Hz [m]", 0.96, _value(lateral[0.8], "radius_m"), RADII_AND_TIMES)
    claims.words(
        "spine turning in the lateral walk widens with frequency",
        lambda: _over(lateral[0.8], lateral[0.5], "radius_m") > 1.1,  # type: ignore[operator]
    )
    for gait, frequency, thesis in (("trot", 0.5, 0.375), ("lateral_walk", 0.8, 0.1)):
        ratio = _over(lock(gait, frequency, "mix"), lock(gait, frequency, "spine"), "radius_m")
        claims.number(f"mix over spine radius, {gait} {frequency} Hz [1]", thesis, ratio, RADII_AND_TIMES)
    combinations = {(row["gait"], row["frequency_hz"]) for row in locked}
    claims.words(
        "mix turns most tightly and the spine least, in every gait and at every frequency",
        lambda: all(
            lock(*each, "mix")["radius_m"] < lock(*each, "leg")["radius_m"] < lock(*each, "spine")["radius_m"]  # type: ignore[index]
            for each in combinations
        ),
    )
    times: dict[str, float | None] = {
        strategy: _value(arc("trot", 0.67, strategy, 0.5), "time_s") for strategy in STRATEGIES
    }
    for strategy, thesis in (("spine", 13.0), ("leg", 18.4), ("mix", 14.5)):
        claims.number(f"0.5 m arc, trot 0.67 Hz, {strategy} [s]", thesis, times[strategy], RADII_AND_TIMES)
    claims.words(
        "0.5 m arc, trot 0.67 Hz: spine faster than mix faster than leg",
        lambda: times["spine"] < times["mix"] < times["leg"],  # type: ignore[operator]
    )
    saved = None if times["leg"] is None or times["spine"] is None else 1.0 - times["spine"] / times["leg"]
    claims.number("share of time that spine turning saves, 0.5 m, trot 0.67 Hz [1]", 0.29, saved, DEVIATIONS)
    arcs = {(row["gait"], row["frequency_hz"], row["path_radius_m"]) for row in rows if row["path_radius_m"]}

    def ordered(each: tuple[str, float, float]) -> bool:
        taken = [arc(each[0], each[1], strategy, each[2]) for strategy in ("spine", "mix", "leg")]
        followed = [row["time_s"] for row in taken if row is not None and row["followed"]]
        return _rising(followed)

    if len(arcs) > 2:
        claims.words(
            "spine turning fastest, then mix, then leg, on every arc that is followed",
            lambda: all(map(ordered, arcs)),
            ours=f"{sum(map(ordered, arcs))} of {len(arcs)}",
        )
        for gait, most in (("trot", 0.01), ("walking_trot", 0.03)):
            ratio = _over(arc(gait, 0.5, "mix", 1.0), arc(gait, 0.5, "spine", 1.0), "time_s")
            claims.number(f"mix over spine time, 1.0 m, {gait} 0.5 Hz [1]", 1.0 + most, ratio, (0.95, 1.05))
        claims.words(
            "turning is faster at a higher frequency",
            lambda: all(
                _rising([-arc(gait, f, strategy, radius)["time_s"] for f in FREQUENCIES])  # type: ignore[index]
                for gait in GAITS
                for strategy in STRATEGIES
                for radius in RADII
                if all(arc(gait, f, strategy, radius)["followed"] for f in FREQUENCIES)  # type: ignore[index]
            ),
        )
    failed = [row for row in rows if row["path_radius_m"] and not row["followed"]]
    claims.words(
        "the only failed arc is spine, lateral walk, 0.8 Hz, 0.5 m",
        lambda: (
            [(row["gait"], row["frequency_hz"], row["strategy"], row["path_radius_m"]) for row in failed]
            == [("lateral_walk", 0.8, "spine", 0.5)]
        ),
        ours="; ".join(f"{r['strategy']}, {r['gait']}, {r['frequency_hz']} Hz, {r['path_radius_m']} m" for r in failed)
        or "none failed",
    )


def _balance(claims: Claims, facts: dict[str, Any]) -> None:
    rows = facts["rows"]
    for row in rows:
        claims.words(
            f"balance: {row['leg'].replace('_', ' ')}, {'with' if row['compensation'] else 'without'} compensation: "
            f"{'pass' if row['thesis_passed'] else 'fail'}",
            lambda row=row: row["passed"] == row["thesis_passed"],  # type: ignore[misc]
            ours="pass" if row["passed"] else "fail",
        )
    interval = facts.get("com_interval_m")
    claims.words("the balance table holds over an interval of the fore-aft COM", lambda: interval is not None, interval)
    plain, helped = (pick(rows, leg="rear_left", compensation=value) for value in (False, True))
    if plain is not None and helped is not None:
        rear_left, front_right = LEGS.index("rear_left"), LEGS.index("front_right")
        before, after = (row["four_feet_forces_n"] for row in (plain, helped))
        thesis = balance.THESIS_REAR_LEFT_N
        claims.number("rear left load on four feet, no compensation [N]", thesis[False], before[rear_left], FORCES)
        claims.number("rear left load on four feet, compensation [N]", thesis[True], after[rear_left], FORCES)
        claims.words("compensation takes load off the rear left foot", lambda: after[rear_left] < before[rear_left])
        front = balance.THESIS_FRONT_RIGHT_N
        claims.number("front right load on four feet, compensation [N]", front, after[front_right], FORCES)
        three = helped["foot_forces_n"]
        claims.words(
            "rear left lifted, compensation: most of the load on the diagonal front left, rear right",
            lambda: three[0] + three[3] > 0.5 * sum(three),
            ours=round((three[0] + three[3]) / sum(three), 3),
        )
    for pair, thesis_left in (("front", 0.7), ("rear", 0.27)):
        without, with_it = (
            [abs(row["pitch_deg"]) for row in rows if row["leg"].startswith(pair) and row["compensation"] == on]
            for on in (False, True)
        )
        if without and with_it:
            ratio = float(np.mean(with_it) / np.mean(without))
            claims.number(
                f"pitch change with over without compensation, {pair} lifts [1]", thesis_left, ratio, DEVIATIONS
            )


def _maze(claims: Claims, rows: Sequence[Row]) -> None:
    plain, spine = pick(rows, spine=False), pick(rows, spine=True)
    claims.words("the maze is finished with and without spine", lambda: plain["finished"] and spine["finished"])  # type: ignore[index]
    if (
        plain is None
        or spine is None
        or plain["thesis_time_s"] is None
        or not (plain["finished"] and spine["finished"])
    ):
        return
    for row, name in ((plain, "no spine"), (spine, "spine")):
        thesis = maze.THESIS[row["spine"]]
        claims.number(f"maze time, {name} [s]", thesis["time_s"], row["time_s"], RADII_AND_TIMES)
        claims.number(f"maze speed, {name} [m/s]", thesis["speed_m_s"], row["speed_m_s"], SPEEDS)
        claims.number(f"maze pitch deviation, {name} [deg]", thesis["pitch_sd_deg"], row["pitch_sd_deg"], DEVIATIONS)
        claims.number(f"maze roll deviation, {name} [deg]", thesis["roll_sd_deg"], row["roll_sd_deg"], DEVIATIONS)
    gain = 1.0 - spine["time_s"] / plain["time_s"]
    claims.number("maze: share of time that the spine saves [1]", 0.28, gain, SPEEDS, of_ours=(0.20, 0.36))
    claims.number(
        "maze: roll deviation with spine over without [1]", 1.34, _over(spine, plain, "roll_sd_deg"), DEVIATIONS
    )
    claims.words("maze: the spine raises the roll deviation", lambda: spine["roll_sd_deg"] > plain["roll_sd_deg"])
    claims.words("maze: the spine raises the pitch deviation", lambda: spine["pitch_sd_deg"] > plain["pitch_sd_deg"])


def _theory(claims: Claims, rows: Sequence[Row]) -> None:
    fast = _walk(rows, "trot", 0.8, False)
    if fast is None or not fast["losses"]:
        return
    losses = fast["losses"]
    claims.number("speed over theory, trot 0.8 Hz, no spine [1]", 0.9, _over_theory(fast), SPEEDS)
    parts = {name: losses[f"{name}_m_s"] for name in ("slip", "pitch", "yaw", "contact", "legs")}
    claims.words(
        "slip is the largest part of what is lost against theory",
        lambda: max(parts, key=lambda name: parts[name]) == "slip",
        ours=max(parts, key=lambda name: parts[name]),
    )
    claims.words(
        "the measured losses add up to theory less reached speed (5 % of theory)",
        lambda: abs(losses["reached_m_s"] - fast["speed_m_s"]) < 0.05 * losses["theory_m_s"],
        ours=round(losses["reached_m_s"], 4),
    )


def _gaze(claims: Claims, rows: Sequence[Row]) -> None:
    for axis, robot, mode in (("yaw", "nermo_lite", "spine"), ("yaw", "nermo", "imu"), ("pitch", "nermo", "imu")):
        ratio = _over(pick(rows, robot=robot, gaze=mode), pick(rows, robot=robot, gaze="off"), f"head_{axis}_sd_deg")
        if ratio is not None:
            claims.words(
                f"{robot}: the neck lowers the {axis} deviation of the head's cameras (N 7.1.2)",
                lambda ratio=ratio: ratio < 1.0,  # type: ignore[misc]
                ours=round(ratio, 3),
            )


def _over_theory(row: Row) -> float:
    return float(row["speed_m_s"] / row["theory_m_s"])


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
        return _value(_walk(straight, gait, frequency, spine, stride), "speed_m_s")

    add("trot 0.8 Hz, no spine [m/s]", 0.096, 0.086, None, speed("trot", 0.8, False))
    add("trot 0.8 Hz, spine [m/s]", 0.12, 0.105, None, speed("trot", 0.8, True))
    add("trot 0.67 Hz, no spine [m/s]", 0.0804, 0.076, 0.067, speed("trot", 0.67, False))
    add("trot 0.67 Hz, spine [m/s]", 0.1005, 0.082, 0.077, speed("trot", 0.67, True))
    add("lateral walk 0.8 Hz [m/s]", 0.0706, 0.068, 0.064, speed("lateral_walk", 0.8, False))
    add("spine alone, 0.8 Hz [m/s]", 0.024, 0.019, None, speed("trot", 0.8, True, 0.0))
    for strategy, theory, twin in (("leg", 0.151, 0.174), ("mix", 0.134, 0.135)):
        row = pick(turning, gait="trot", frequency_hz=0.67, strategy=strategy, path_radius_m=FULL_LOCK)
        add(f"radius, {strategy}, trot 0.67 Hz [m]", theory, twin, None, _value(row, "radius_m"))
    for frequency, twin in ((0.5, 0.49), (0.8, 0.96)):
        row = pick(turning, gait="lateral_walk", frequency_hz=frequency, strategy="spine", path_radius_m=FULL_LOCK)
        add(f"radius, spine, lateral walk {frequency} Hz [m]", None, twin, None, _value(row, "radius_m"))
    for strategy, twin, robot in (("spine", 13.0, 15.5), ("leg", 18.4, 22.0), ("mix", 14.5, 16.3)):
        row = pick(turning, gait="trot", frequency_hz=0.67, strategy=strategy, path_radius_m=0.5)
        add(f"0.5 m arc, {strategy}, trot 0.67 Hz [s]", None, twin, robot, _value(row, "time_s"))
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


__all__ = ["Claims", "comparison", "pick_all", "summary"]
