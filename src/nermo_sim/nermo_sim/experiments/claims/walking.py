"""Claims about the straight line: speed, orientation noise, and what is lost against theory (N 6.2.1, 7.2.1).

With the spine means stride extension with offset compensation, unless said otherwise.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from nermo_sim.experiments.claims.board import DEVIATIONS, SPEEDS, THEORY, Claims
from nermo_sim.experiments.lookup import Row, pick, quotient, value
from nermo_sim.experiments.straight_line import FREQUENCIES, GAITS, STRIDE

PITCH_WITHIN = 1.5
"""How near to N's the mean pitch must come [deg]: a ratio says nothing of a mean so near to 0."""


def walk(rows: Sequence[Row], gait: str, frequency: float, spine: bool, stride: float = STRIDE) -> Row | None:
    """The row of a walk."""
    return pick(rows, gait=gait, frequency_hz=frequency, stride_m=stride, spine=spine, offset_compensation=spine)


def speeds(claims: Claims, rows: Sequence[Row]) -> None:
    """Of the gaits, with and without the spine."""
    fast, spine = walk(rows, "trot", 0.8, False), walk(rows, "trot", 0.8, True)
    lateral, alone = walk(rows, "lateral_walk", 0.8, False), walk(rows, "trot", 0.8, True, 0.0)
    theory = claims.about("no-slip speed", "theory")
    theory.number("no-slip speed of the trot at 0.8 Hz, no spine [m/s]", 0.096, value(fast, "theory_m_s"), THEORY)
    theory.number("no-slip speed of the trot at 0.8 Hz, spine [m/s]", 0.12, value(spine, "theory_m_s"), THEORY)

    trot = claims.about("trot speed")
    trot.number("speed of the trot at 0.8 Hz, no spine [m/s]", 0.086, value(fast, "speed_m_s"), SPEEDS)
    trot.number(
        "speed over theory, trot 0.8 Hz, no spine [1]", 0.9, quotient(fast, fast, "speed_m_s", "theory_m_s"), SPEEDS
    )
    with_spine = claims.about("trot speed with spine")
    with_spine.number("speed of the trot at 0.8 Hz, spine [m/s]", 0.105, value(spine, "speed_m_s"), SPEEDS)
    gain = quotient(spine, fast, "speed_m_s")
    with_spine.number("speed with spine over without, trot 0.8 Hz [1]", 1.22, gain, SPEEDS, of_ours=(1.15, 1.30))
    medium = {on: value(walk(rows, "trot", 0.67, on), "speed_m_s") for on in (False, True)}
    claims.about("trot speed at 0.67 Hz").number(
        "speed of the trot at 0.67 Hz, no spine [m/s]", 0.076, medium[False], SPEEDS
    )
    claims.about("trot speed at 0.67 Hz with spine").number(
        "speed of the trot at 0.67 Hz, spine [m/s]", 0.082, medium[True], SPEEDS
    )
    alone_speed = value(alone, "speed_m_s")
    claims.about("spine alone").number("speed of the spine alone, stride 0 [m/s]", 0.019, alone_speed, SPEEDS)
    slow = claims.about("spine gain at 0.5 Hz")
    slow_gain = quotient(walk(rows, "trot", 0.5, True), walk(rows, "trot", 0.5, False), "speed_m_s")
    slow.number("speed with spine over without, trot 0.5 Hz [1]", 1.05, slow_gain, SPEEDS)
    slow.words("the spine gains more at 0.8 Hz than at 0.5 Hz", lambda: gain > slow_gain)  # type: ignore[operator]
    walking = claims.about("trot over lateral walk")
    walking.number("trot over lateral walk at 0.8 Hz, no spine [1]", 1.27, quotient(fast, lateral, "speed_m_s"), SPEEDS)
    walking.number("trot over lateral walk at 0.8 Hz, spine [1]", 1.48, quotient(spine, lateral, "speed_m_s"), SPEEDS)
    _growth(claims, rows)


def _growth(claims: Claims, rows: Sequence[Row]) -> None:
    """With gait, stride and frequency."""
    order = claims.about("order of the gaits")
    for frequency in FREQUENCIES:
        found = [value(walk(rows, gait, frequency, False), "speed_m_s") for gait in GAITS]
        if None not in found:
            order.words(
                f"trot > walking trot > lateral walk in speed at {frequency} Hz",
                lambda found=found: found[0] > found[1] > found[2],  # type: ignore[misc]
            )
    trots = [row for row in rows if (row["gait"], row["frequency_hz"], row["spine"]) == ("trot", 0.8, False)]
    by_stride = sorted((row["stride_m"], row["speed_m_s"]) for row in trots)
    if len(by_stride) > 2:
        claims.about("speed with stride").words(
            "speed rises linearly with the stride (r > 0.98)", lambda: _correlation(by_stride) > 0.98
        )
    growth = {gait: quotient(walk(rows, gait, 0.8, False), walk(rows, gait, 0.5, False), "speed_m_s") for gait in GAITS}
    linear = claims.about("speed with frequency")
    for gait in GAITS[:2]:
        linear.number(f"{gait}: speed at 0.8 over 0.5 Hz, linear in frequency [1]", 1.6, growth[gait], SPEEDS)
    claims.about("saturation of the lateral walk").words(
        "the lateral walk's speed grows less with frequency than the trots' (it saturates)",
        lambda: growth["lateral_walk"] < 0.95 * min(growth["trot"], growth["walking_trot"]),  # type: ignore[operator,type-var]
    )


def orientation(claims: Claims, rows: Sequence[Row]) -> None:
    """Noise of roll, pitch and yaw."""
    fast, spine = walk(rows, "trot", 0.8, False), walk(rows, "trot", 0.8, True)
    numbers = {"yaw": (("yaw_amplitude_deg", 1.5), ("yaw_sd_deg", 2.86)), "roll": (("roll_sd_deg", 1.33),)}
    for axis, quantities in numbers.items():
        topic = claims.about(f"{axis} with spine")
        for name, thesis in quantities:
            ratio = quotient(spine, fast, name)
            topic.number(f"{_label(name)} with spine over without, trot 0.8 Hz [1]", thesis, ratio, DEVIATIONS)
            topic.words(f"the spine raises the {_label(name)}", lambda ratio=ratio: ratio > 1.0)  # type: ignore[misc]
    if spine is not None and spine["cycles"]:
        pairs = list(zip(spine["cycles"]["spine"], spine["cycles"]["yaw"], strict=True))
        claims.about("yaw with spine").words(
            "yaw follows the spine angle (|r| > 0.8)",
            lambda: abs(_correlation(pairs)) > 0.8,
            ours=round(_correlation(pairs), 3),
        )
    claims.about("range of roll").words(
        "roll stays within 8 deg in the trot at 0.8 Hz, spine or not",
        lambda: max(fast["roll_amplitude_deg"], spine["roll_amplitude_deg"]) <= 8.0,  # type: ignore[index]
        ours=None if spine is None else round(spine["roll_amplitude_deg"], 2),
    )
    claims.about("pitch deviation").words(
        "pitch deviation under 2 deg in all gaits",
        lambda: max(row["pitch_sd_deg"] for row in rows) < 2.0 if rows else None,
        ours=round(max((row["pitch_sd_deg"] for row in rows), default=0.0), 2),
    )
    near = (0.5 - PITCH_WITHIN, 0.5 + PITCH_WITHIN)
    mean_pitch = value(fast, "pitch_mean_deg")
    claims.about("mean pitch").number(
        "mean pitch, nose down, trot 0.8 Hz [deg]", 0.5, mean_pitch, DEVIATIONS, of_ours=near
    )
    _offsets(claims, rows)
    _roll(claims, rows)
    _pitch(claims, rows)


def _offsets(claims: Claims, rows: Sequence[Row]) -> None:
    """What offset compensation changes, at N's 0.67 Hz (figures 6.9(b), A.9)."""
    spine = walk(rows, "trot", 0.67, True)
    bare = pick(rows, gait="trot", frequency_hz=0.67, stride_m=STRIDE, spine=True, offset_compensation=False)
    roll, others = claims.about("roll with offset compensation"), claims.about("pitch and yaw with offset compensation")
    for name, thesis in (("roll_amplitude_deg", 0.875), ("roll_sd_deg", 0.85)):
        ratio = quotient(spine, bare, name)
        roll.number(f"{_label(name)} with offset compensation over without [1]", thesis, ratio, DEVIATIONS)
        roll.words(f"offset compensation lowers the {_label(name)}", lambda ratio=ratio: ratio < 1.0)  # type: ignore[misc]
    for axis in ("yaw", "pitch"):
        others.words(
            f"offset compensation leaves the {axis} deviation alone (20 %)",
            lambda axis=axis: abs(quotient(spine, bare, f"{axis}_sd_deg") - 1.0) < 0.2,  # type: ignore[misc,operator]
        )


def _roll(claims: Claims, rows: Sequence[Row]) -> None:
    """Its growth with frequency and duty factor."""
    trots = [walk(rows, "trot", frequency, False) for frequency in FREQUENCIES]
    steps = claims.about("roll with frequency")
    steps.words(
        "roll noise grows with each frequency step, trot",
        lambda: _rising([row["roll_sd_deg"] for row in trots]),  # type: ignore[index]
    )
    for (before, slow), (after, fast) in itertools.pairwise(zip(FREQUENCIES, trots, strict=True)):
        steps.number(
            f"roll deviation at {after} over {before} Hz, trot [1]", 1.2, quotient(fast, slow, "roll_sd_deg"), SPEEDS
        )
    claims.about("roll with duty factor").words(
        "roll noise grows with a lower duty factor at 0.8 Hz",
        lambda: _rising([walk(rows, gait, 0.8, False)["roll_sd_deg"] for gait in GAITS[::-1]]),  # type: ignore[index]
    )


def _pitch(claims: Claims, rows: Sequence[Row]) -> None:
    """Its growth with stride and spine."""
    full, shorter = walk(rows, "trot", 0.8, False), walk(rows, "trot", 0.8, False, 0.048)
    spine = walk(rows, "trot", 0.8, True)
    stride = claims.about("pitch with stride")
    ratio = quotient(full, shorter, "pitch_sd_deg")
    stride.words("stride 0.8 to 1.0 raises the pitch deviation", lambda: ratio > 1.0)  # type: ignore[operator]
    for name in ("pitch_sd_deg", "pitch_amplitude_deg"):
        stride.number(f"{_label(name)}, stride 1.0 over 0.8 [1]", 1.5, quotient(full, shorter, name), DEVIATIONS)
    with_spine = claims.about("pitch with spine")
    raised = quotient(spine, full, "pitch_sd_deg")
    with_spine.words("the spine raises the pitch deviation", lambda: raised > 1.0)  # type: ignore[operator]
    amplitude = quotient(spine, full, "pitch_amplitude_deg")
    with_spine.number("pitch amplitude with spine over without, stride 1.0 [1]", 2.0, amplitude, DEVIATIONS)


def losses(claims: Claims, rows: Sequence[Row]) -> None:
    """What takes the trot's speed."""
    fast = walk(rows, "trot", 0.8, False)
    if fast is None or not fast["losses"]:
        return
    lost = fast["losses"]
    parts = {name: lost[f"{name}_m_s"] for name in ("slip", "pitch", "yaw", "contact", "legs")}
    largest = max(parts, key=lambda name: parts[name])
    claims.about("slip").words(
        "slip is the largest part of what is lost against theory", lambda: largest == "slip", ours=largest
    )
    claims.about("losses", "own").words(
        "the measured losses add up to theory less reached speed (5 % of theory)",
        lambda: abs(lost["reached_m_s"] - fast["speed_m_s"]) < 0.05 * lost["theory_m_s"],
        ours=round(lost["reached_m_s"], 4),
    )


def robot(claims: Claims, rows: Sequence[Row]) -> None:
    """What N's real robot walked (N 6.2.1, figure 6.11)."""
    topic = claims.about("speed", "robot")
    for spine, thesis in ((False, 0.067), (True, 0.077)):
        ours = value(walk(rows, "trot", 0.67, spine), "speed_m_s")
        topic.number(f"robot: trot 0.67 Hz, {'spine' if spine else 'no spine'} [m/s]", thesis, ours, SPEEDS)
    gains = [quotient(walk(rows, "trot", f, True), walk(rows, "trot", f, False), "speed_m_s") for f in FREQUENCIES]
    ahead = [
        quotient(walk(rows, "trot", f, False), walk(rows, "lateral_walk", f, False), "speed_m_s") for f in FREQUENCIES
    ]
    # "by 15 % to 22 % depending on the gait frequency"; "on average 11 %".
    topic.number("robot: speed with spine over without, mean of all frequencies [1]", 1.185, mean_of_all(gains), SPEEDS)
    topic.number("robot: trot over lateral walk, mean of all frequencies [1]", 1.11, mean_of_all(ahead), SPEEDS)


def mean_of_all(values: Sequence[float | None]) -> float | None:
    """Their mean; None where one is missing."""
    return None if None in values else float(np.mean(values))  # type: ignore[arg-type]


def _correlation(pairs: Sequence[tuple[float, float]]) -> float:
    return float(np.corrcoef(np.asarray(pairs).T)[0, 1])


def _label(name: str) -> str:
    axis, kind, _ = name.split("_")
    return f"{axis} {'deviation' if kind == 'sd' else kind}"


def _rising(values: Sequence[float]) -> bool:
    return all(a < b for a, b in itertools.pairwise(values))
