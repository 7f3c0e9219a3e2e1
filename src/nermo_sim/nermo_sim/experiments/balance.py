"""The balance experiment (N 6.1.5, 6.2.3): each leg lifted and swept, with and without balance compensation."""

from __future__ import annotations

import copy
import math
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context
from typing import Any

import mujoco
import numpy as np

from nermo_control.gait.knowledge_base import GaitParameters
from nermo_control.leg_controller import LegController
from nermo_control.legs.kinematics import leg_kinematics
from nermo_control.lift import KNEE_COMPRESSION, LIFT_DURATION, SHIFT_DURATION
from nermo_control.spine.controller import SpineController
from nermo_control.types import LegStates, MotionCommand, MotionOutput, Phase, Posture, SpineModes
from nermo_description.blend import smooth
from nermo_description.model import build_model
from nermo_description.parameters import LEGS, RobotParameters
from nermo_sim.console import cell, console
from nermo_sim.disturbance import Disturbance, DisturbedRun
from nermo_sim.experiments.experiment import Experiment, Facts, Finished
from nermo_sim.experiments.runs import Job, Result, Settings, mean, rounded, spread
from nermo_sim.models import compiled
from nermo_sim.run_table import Moved, Recorder, Recording
from nermo_sim.twin import Twin
from simgap.execution.executors import processors

SWEEP = 0.7
"""Amplitude of the hip servo about its neutral position [rad], N A.4.2."""
LIFT_AT = SHIFT_DURATION
"""Four feet stand, spine bent or not, until the leg is lifted [s]."""
SWEEP_AT, SWEEP_DURATION = 2.3, 2.0
END = 4.6
"""[s]"""
FOUR_FEET = (0.6, 1.0)
"""When the forces on four feet are averaged [s]."""
THREE_FEET = (1.8, 2.3)
"""When the forces on three feet are averaged [s]: lifted, before the sweep."""
LOADED = 0.03
"""Force from which the lifted foot counts as standing [N]: 1 % of the weight."""
BRUSHES = 0.05
"""Share of the time with the leg up in which its foot may touch, or the body be low."""
SETTLED = 0.1
"""[s] After the lift, before anything is judged."""
TIPPED = math.radians(20.0)
"""Tilt beyond which the mouse has tipped over altogether."""
TIPPED_SHARE = 0.5
"""Of what the knee raises the foot: if the body comes down there by more, it has tipped towards the leg. Chosen: the
twin that stands sinks by a tenth of it at most, one that has tipped rests on the foot."""
THESIS_PASSED = {
    **{(leg, True): True for leg in LEGS},
    ("front_left", False): True,
    ("front_right", False): True,
    ("rear_left", False): False,
    ("rear_right", False): False,
}
"""N table 6.5, simulation, by leg and compensation."""
THESIS_REAR_LEFT_N = {False: 0.73, True: 0.16}
"""Load on the rear left foot on four feet before it is lifted [N], N figure 6.16, without and with compensation."""
THESIS_FRONT_RIGHT_N = 0.35
"""Load on the front right foot with compensation [N], N 6.2.3."""
SERIES_EVERY = 4
"""Ticks between two points that are kept for the figures."""


@dataclass(frozen=True, slots=True)
class Case:
    """One cell of N table 6.5."""

    leg: str
    compensation: bool

    @property
    def key(self) -> str:
        """Name of the row."""
        return f"{self.leg} lifted, compensation {'on' if self.compensation else 'off'}"


def cases(quick: bool = False) -> list[Case]:
    """All eight cells."""
    return [Case(leg, compensation) for leg in LEGS for compensation in (False, True)]


def servo_angles(
    case: Case, robot: RobotParameters, parameters: GaitParameters, period_ns: int
) -> Iterator[tuple[float, ...]]:
    """Where the servos are in a lift [rad], in the order of the robot's, tick by tick of a period [ns]; see N 6.1.5."""
    lifted = LEGS.index(case.leg)
    spine, legs = SpineController(robot, parameters, period_ns), LegController(robot)
    x, z = _neutral_feet(parameters)
    flags = tuple(case.compensation and leg == lifted for leg in range(4))
    modes = SpineModes(balance_compensation=True, offset_compensation=True)
    command = MotionCommand(0, 0.0, 0.0, Posture.STAND, "", 0.0, spine_modes=modes)
    hip, knee, bend = (
        tuple(robot.servos).index(name) for name in (f"{case.leg}_hip", f"{case.leg}_knee", "spine_lateral")
    )
    for tick in range(round(END * 1e9 / period_ns)):
        elapsed = tick * period_ns * 1e-9
        servos = [servo.neutral for servo in robot.servos.values()]
        target = spine.step(command, None, x, z, flags)  # type: ignore[arg-type]
        # Without the rear legs' offsets, the bent hip's roll takes the load off the diagonal's neighbours.
        legs.step(x, [height + offset for height, offset in zip(z, target.foot_offsets, strict=True)], servos, [])
        servos[bend] = target.servo_position
        servos[knee] -= KNEE_COMPRESSION[lifted] * smooth((elapsed - LIFT_AT) / LIFT_DURATION)
        servos[hip] += SWEEP * _sweep(elapsed)
        yield tuple(servos)


def _neutral_feet(parameters: GaitParameters) -> tuple[list[float], list[float]]:
    """X and z [m] of the feet in their leg planes, in the stand."""
    strides = [parameters.stride(leg) for leg in range(4)]
    return [one.neutral_stride_position for one in strides], [one.neutral_stance_height for one in strides]


def lift(
    case: Case,
    robot: RobotParameters,
    model: mujoco.MjModel,
    settings: Settings,
    run: DisturbedRun | None = None,
    twin: Twin[Any] | None = None,
) -> Recording:
    """Lifts and sweeps one leg of a standing mouse."""
    twin = twin or Twin(robot, model=copy.copy(model))
    if run is not None:
        run.begin()
    lifted, begin = LEGS.index(case.leg), twin.time_ns
    recorder = Recorder(twin, round(END * 1e9 / twin.period_ns))
    for servos in servo_angles(case, robot, settings.gait_parameters, twin.period_ns):
        if run is not None:
            run.tick()
        elapsed = (twin.time_ns - begin) * 1e-9
        recorder.add(twin.step(servos), MotionOutput(servos, _legs_up(twin.time_ns, lifted, elapsed)))
    return recorder.recording()


def _sweep(elapsed: float) -> float:
    """Once forth and back, in [-1, 1]."""
    share = (elapsed - SWEEP_AT) / SWEEP_DURATION
    return math.sin(2.0 * math.pi * share) if 0.0 < share < 1.0 else 0.0


def _legs_up(stamp: int, lifted: int, elapsed: float) -> LegStates:
    """The lifted leg swings, for the recording."""
    up = elapsed >= LIFT_AT
    phases = tuple(Phase.SWING if up and leg == lifted else Phase.STANCE for leg in range(4))
    rest = (0.0, 0.0, 0.0, 0.0)
    none = (False, False, False, False)
    return LegStates(stamp, phases, rest, rest, none, phases, stamp, rest, rest, rest, rest, 0.0, 1.0)  # type: ignore[arg-type]


def measure(recording: Recording, case: Case) -> Result:
    """Passed: from shortly after the lift on, the lifted foot carries nothing and the mouse does not tip over."""
    lifted = LEGS.index(case.leg)
    time, angles = recording.time, recording.roll_pitch_yaw
    after = time >= LIFT_AT + LIFT_DURATION + SETTLED
    tilt = np.abs(angles[:, :2]).max(axis=1)
    # A foot that only brushes the ground carries no weight: a tenth of a second of load is needed.
    loaded = recording.foot_forces[after, lifted] > LOADED
    stands = bool(loaded.mean() > BRUSHES)
    pitch = np.degrees(angles[:, 1])
    four, three = ((time >= a) & (time < b) for a, b in (FOUR_FEET, THREE_FEET))
    touched = time[after][loaded]
    return {
        "passed": not stands and bool(tilt.max() < TIPPED),
        "loaded_share": float(loaded.mean()),
        "ground_impact_s": float(touched[0]) if stands else None,
        "foot_forces_n": rounded(recording.foot_forces[three].mean(axis=0)),
        "four_feet_forces_n": rounded(recording.foot_forces[four].mean(axis=0)),
        "pitch_deg": _pitch_change(recording),
        "pitch_four_feet_deg": float(pitch[four].mean()),
        "pitch_peak_deg": float(np.abs(pitch[time >= LIFT_AT] - pitch[four].mean()).max()),
        "tilt_peak_deg": _tilt_peak(recording),
    }


def foot_raise(leg: str, robot: RobotParameters, parameters: GaitParameters) -> float:
    """[m] by which the pulled knee raises a foot in its leg plane, from the stand and without the sweep."""
    number = LEGS.index(leg)
    x, z = _neutral_feet(parameters)
    pair, of_pair = ("front", robot.front_leg) if number < 2 else ("rear", robot.rear_leg)
    kinematics = leg_kinematics(of_pair, pair)  # type: ignore[arg-type]
    hip, knee, _ = kinematics.inverse(x[number], z[number])
    return kinematics.forward(hip, knee - KNEE_COMPRESSION[number])[1] - kinematics.forward(hip, knee)[1]


def upright(moved: Moved, leg: str, robot: RobotParameters, parameters: GaitParameters) -> Result:
    """Whether and how long the body stayed up, told by its pose alone: what a camera can judge of N 6.1.5.

    The corner above the lifted leg must not come down on it: it has tipped once that hip is lower than on four feet by
    more than `TIPPED_SHARE` of what the knee raises the foot, or the body tilts by `TIPPED`, for more than `BRUSHES` of
    the time. `up_s` is the time [s] from the lift to there, or to the last row; `sunk_mm` how much lower that hip is on
    three feet. None of what was not seen.
    """
    time, angles, mine = moved.time, moved.roll_pitch_yaw, np.array(robot.hip_positions[LEGS.index(leg)])
    pitch, roll = angles[:, 1], angles[:, 0]
    # The height of a point of the body, by the third row of the rotation that yaw, pitch and roll make.
    up = np.column_stack([-np.sin(pitch), np.cos(pitch) * np.sin(roll), np.cos(pitch) * np.cos(roll)])
    height = moved.position[:, 2] + up @ mine
    four, three = ((time >= a) & (time < b) for a, b in (FOUR_FEET, THREE_FEET))
    after = (time >= LIFT_AT + LIFT_DURATION + SETTLED) & (time < END)
    if not (four.any() and three.any()):
        return {"up_s": None, "sunk_mm": None, "pitch_deg": None, "tilt_peak_deg": _tilt_peak(moved), "tipped": None}
    sunk = height[four].mean() - height[after]
    low = sunk > TIPPED_SHARE * foot_raise(leg, robot, parameters)
    low |= np.abs(angles[after, :2]).max(axis=1) >= TIPPED
    tipped = bool(low.mean() > BRUSHES)
    return {
        "up_s": float(time[after][low][0] if tipped else time[after][-1]) - LIFT_AT,
        "sunk_mm": 1e3 * float(height[four].mean() - height[three].mean()),
        "pitch_deg": _pitch_change(moved),
        "tilt_peak_deg": _tilt_peak(moved),
        "tipped": tipped,
    }


def _pitch_change(moved: Moved) -> float:
    """[deg] From four feet to three, before the sweep."""
    four, three = ((moved.time >= a) & (moved.time < b) for a, b in (FOUR_FEET, THREE_FEET))
    pitch = np.degrees(moved.roll_pitch_yaw[:, 1])
    return float(pitch[three].mean() - pitch[four].mean())


def _tilt_peak(moved: Moved) -> float:
    """[deg] Of roll or pitch, in all of a lift."""
    return float(np.degrees(np.abs(moved.roll_pitch_yaw[:, :2]).max()))


def run(job: Job[Case]) -> Result:
    """One cell, once."""
    robot = job.settings.mouse
    model = compiled(robot)
    twin = Twin(robot, model=model)
    recording = lift(job.case, robot, model, job.settings, DisturbedRun(twin, _gentle(job.settings), job.seed), twin)
    result = {
        **upright(recording, job.case.leg, robot, job.settings.gait_parameters),
        **measure(recording, job.case),
    }
    if job.repeat == 0:
        rows = slice(None, None, SERIES_EVERY)
        result["series"] = {
            "time_s": rounded(recording.time[rows]),
            "pitch_deg": rounded(np.degrees(recording.roll_pitch_yaw[rows, 1]), 3),
            "foot_forces_n": rounded(recording.foot_forces[rows].T),
        }
    return result


def _gentle(settings: Settings) -> Disturbance:
    """First pose and ground differ from run to run; nobody pushes a mouse on three feet."""
    return replace(settings.disturbance, push=0.0)


def table(cases: Sequence[Case], settings: Settings, robot: RobotParameters, results: list[list[Result]]) -> list[Any]:
    """One row a cell, with the keys of the JSON contract."""
    rows = []
    for case, runs in zip(cases, results, strict=True):
        forces = {
            name: rounded(np.mean([one[name] for one in runs], axis=0))
            for name in ("foot_forces_n", "four_feet_forces_n")
        }
        measured = (
            "pitch_deg",
            "pitch_four_feet_deg",
            "pitch_peak_deg",
            "tilt_peak_deg",
            "ground_impact_s",
            "loaded_share",
        )
        rows.append(
            {
                "leg": case.leg,
                "compensation": case.compensation,
                "repeats": len(runs),
                "passed": all(one["passed"] for one in runs),
                "runs_passed": sum(one["passed"] for one in runs),
                "thesis_passed": THESIS_PASSED[case.leg, case.compensation],
                **forces,
                **{name: mean(runs, name) for name in measured},
                "pitch_sd_deg": spread(runs, "pitch_deg"),
                "series": next((one["series"] for one in runs if "series" in one), None),
            }
        )
    return rows


# The fore-aft COM


COM_RANGE = (0.008, 0.008)
"""How far behind and ahead of the robot's own parameter is searched [m]."""
COM_RESOLUTION = 2.5e-4
"""[m]"""


def com_interval(settings: Settings, workers: int = 2) -> dict[str, Any]:
    """The interval of `masses.front_com[0]` [m] over which all eight cells come out as in N, by bisection.

    Undisturbed. Both ends are found at once, in two processes. None where they do not hold for the robot as it is.
    """
    robot = settings.mouse
    own = robot.masses.front_com[0]
    share = robot.front_mass / robot.masses.total
    facts: dict[str, Any] = {"com_parameter_m": own, "com_resolution_m": COM_RESOLUTION}
    if not table_holds(settings, own):
        return {"com_interval_m": None, "total_com_interval_m": None, **facts}
    jobs = [(settings, own, own - COM_RANGE[0]), (settings, own, own + COM_RANGE[1])]
    if workers > 1:
        with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
            low, high = pool.map(_bisect, jobs)
    else:
        low, high = map(_bisect, jobs)
    return {
        "com_interval_m": [low, high],
        # The rear torso and the spine stay: the total COM moves by the front's share of the mass.
        "total_com_interval_m": [total_com(robot) + share * (end - own) for end in (low, high)],
        **facts,
    }


def total_com(robot: RobotParameters) -> float:
    """Place of the whole COM ahead of base_link, in the stand, by (5.34) [m]."""
    model = compiled(robot)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("stand").id)
    mujoco.mj_forward(model, data)
    base = data.site("base_link")
    return float((data.subtree_com[0] - base.xpos) @ base.xmat.reshape(3, 3)[:, 0])


def table_holds(settings: Settings, front_com: float, which: Iterable[Case] | None = None) -> bool:
    """Whether all cells come out as in N with the front COM at this place [m] ahead of base_link."""
    robot = settings.mouse
    _, *rest = robot.masses.front_com
    masses = robot.masses.model_copy(update={"front_com": (front_com, *rest)})
    robot = robot.model_copy(update={"masses": masses})
    model = build_model(robot)
    return all(
        measure(lift(case, robot, model, settings), case)["passed"] == THESIS_PASSED[case.leg, case.compensation]
        for case in which or cases()
    )


def _bisect(job: tuple[Settings, float, float]) -> float:
    """The last value at which the table holds, between one at which it does and one beyond."""
    settings, good, bad = job
    while abs(bad - good) > COM_RESOLUTION:
        middle = 0.5 * (good + bad)
        if table_holds(settings, middle):
            good = middle
        else:
            bad = middle
    return good


COM_KEY = "com interval"


def _further(done: Finished[Case]) -> Facts:
    if COM_KEY not in done.log:
        done.log.add(COM_KEY, com_interval(done.settings, done.workers or processors()))
    return dict(done.log[COM_KEY])


def _notes(facts: Facts) -> None:
    console.print(f"front COM from {cell(facts['com_interval_m'])} m ahead of base_link: the table holds")


EXPERIMENT = Experiment(
    name="balance",
    title="Balance (N 6.2.3)",
    help="""Each leg lifted and swept, with and without balance compensation (N 6.1.5, 6.2.3).

    Also finds the interval of the fore-aft COM over which the table comes out as the thesis's.

    With --target the lifts are done on a mouse, with --film, then or later, it is told whether it tipped.

    \b
    nermo experiment balance
    nermo experiment balance --json balance.json
    nermo experiment balance --target serial --port /dev/ttyUSB0 --calibration my_robot.yaml --out today
    nermo experiment balance --film films --camera camera.yaml --out today
    """,
    columns=("leg", "compensation", "passed", "thesis_passed", "foot_forces_n", "pitch_deg"),
    cases=cases,
    run=run,
    table=table,
    tail="rigid",
    further=_further,
    notes=_notes,
)
