"""The straight line on the real mouse (N 6.1.3, table 6.1; 6.2.1, figure 6.11)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from itertools import product
from pathlib import Path

from nermo_control.types import ControlCommand, SpineModes, TrajectoryMode
from nermo_sim.experiments.claims.board import SPEEDS, Claims
from nermo_sim.experiments.claims.walking import mean_of_all, robot, walk
from nermo_sim.experiments.experiment import Row
from nermo_sim.experiments.lookup import quotient
from nermo_sim.experiments.on_robot import OnRobot, Said, Way
from nermo_sim.experiments.runs import Result, Settings, full_speed
from nermo_sim.experiments.straight_line import EXPERIMENT, FREQUENCIES, STRIDE, THESIS_SPEEDS, Case, measure

DISTANCE = 1.5
"""[m], N 6.1.3: "due to space constraints"."""
ROOM = 1.3
"""Times the distance that a run lasts longer than one of the no-slip speed. N's slowest robot made 0.83 of that."""
SETTING_OFF = 1.0
"""[s] More, for the first steps out of the stand. Chosen."""
PRINTED_FREQUENCY = 0.67
"""[Hz] at which N prints speeds of its robot, there as 0.6 Hz; table 6.1 has no 0.6."""
THESIS_ROBOT = {("trot", PRINTED_FREQUENCY, False): 0.067, ("trot", PRINTED_FREQUENCY, True): 0.077}
"""[m/s] N 6.2.1, of Nermo-Lite. N draws the others (figure 6.11) and prints how they stand to each other."""
OVER_TWIN = {("lateral_walk", False): 0.95, ("trot", False): 0.88, ("trot", True): 0.94}
"""The robot's speed over the twin's by gait and spine, N 6.2.1: "on average 5 % slower", 12 %, 6 %."""


def cases(quick: bool = False) -> list[Case]:
    """N's of table 6.1: trot and lateral walk at each frequency, the trot with the spine too; quick: at 0.67 Hz.

    Table 6.1 has a normalised stride of 0.8 for the robot; its printed speeds are above what 0.8 can do without slip,
    and A.4.2 has "the maximum theoretical stride length of 0.06 m": so here, as on the twin.
    """
    frequencies = (PRINTED_FREQUENCY,) if quick else FREQUENCIES
    kinds = (("trot", False), ("trot", True), ("lateral_walk", False))
    return [Case(gait, frequency, STRIDE, spine, spine) for (gait, spine), frequency in product(kinds, frequencies)]


def _name(case: Case) -> str:
    return f"{case.gait}_{case.frequency_hz:g}Hz_{'spine' if case.spine else 'no_spine'}"


def _place(case: Case, settings: Settings) -> str:
    distance = settings.distance
    return (
        f"put the mouse on the start line, nose across it, heading for the end line {distance:g} m ahead; "
        f"{ROOM * distance:.1f} m of rubber mat before it"
    )


def _played(case: Case, settings: Settings) -> Said:
    return Said(
        ControlCommand(
            0,
            forward_velocity=full_speed(settings, case.gait, case.frequency_hz),
            trajectory_mode=TrajectoryMode.STRAIGHT_LINE,
            gait=case.gait,
            gait_frequency=case.frequency_hz,
            spine_modes=SpineModes(stride_extension=case.spine, offset_compensation=case.offset_compensation),
        )
    )


def _seconds(case: Case, settings: Settings) -> float:
    return SETTING_OFF + ROOM * settings.distance / full_speed(settings, case.gait, case.frequency_hz)


def _measure(case: Case, way: Way, settings: Settings) -> Result:
    walked = way.until(settings.distance)
    reached = bool(walked.along()[-1] >= settings.distance)
    return {**measure(walked, case.frequency_hz), "reached": reached}


def _thesis(case: Case) -> Row:
    return {
        "thesis_robot_speed_m_s": THESIS_ROBOT.get((case.gait, case.frequency_hz, case.spine)),
        "thesis_twin_speed_m_s": THESIS_SPEEDS.get((case.gait, case.frequency_hz, case.stride_m, case.spine)),
    }


def _claims(rows: Sequence[Row]) -> list[Row]:
    claims = Claims()
    robot(claims, rows)
    topic = claims.about("robot over twin", "robot")
    for (gait, spine), thesis in OVER_TWIN.items():
        of_gait = [walk(rows, gait, frequency, spine) for frequency in FREQUENCIES]
        shares = [quotient(row, row, "speed_m_s", "twin_speed_m_s") for row in of_gait]
        words = f"robot over twin: {gait.replace('_', ' ')}, {'spine' if spine else 'no spine'}, mean [1]"
        topic.number(words, thesis, mean_of_all(shares), SPEEDS)
    return claims.rows


def _picture(rows: Sequence[Row], path: Path) -> None:
    from nermo_sim.plots import plot_on_robot

    plot_on_robot(rows, path)


ON_ROBOT = OnRobot(
    experiment=EXPERIMENT,
    distance=DISTANCE,
    cases=cases,
    name=_name,
    place=_place,
    played=_played,
    seconds=_seconds,
    measure=_measure,
    measured=("speed_m_s", "roll_sd_deg", "pitch_sd_deg", "yaw_sd_deg"),
    every=("reached",),
    describe=asdict,
    thesis=_thesis,
    claims=_claims,
    picture=_picture,
)
