"""A whole diagnosis of the mouse: channels, model, sites and nuisances put together for the core."""

from __future__ import annotations

import dataclasses
import logging
from collections.abc import Mapping, Sequence
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from nermo_description.parameters import LEGS, RobotParameters
from nermo_description.robots import load_robot
from nermo_gap.protocol.looks import looker
from nermo_gap.protocol.recorded import is_mcap, read
from nermo_gap.protocol.scene import SceneFile, scene_of, segments
from nermo_gap.robots.channels import Channels, resolution, robot_map, servos_report, uncertainty
from nermo_gap.robots.mcap_table import recorded_robot
from nermo_gap.robots.menu import MouseMenu
from nermo_gap.robots.model import diagnosis_spec
from nermo_gap.robots.phases import gait_phases
from nermo_gap.robots.sites import groups, nuisances, worth_a_look
from simgap.analysis.diagnose import Diagnosis, diagnose
from simgap.analysis.options import Options
from simgap.analysis.search import HEAVY
from simgap.data.channels import OutputChannel
from simgap.data.errors import GapInputError
from simgap.data.plant import Plant, build_plant
from simgap.data.recording import Recording, recording_from_table
from simgap.data.setup import AS_MODELLED, Setup
from simgap.simulation.windows import WARM_UP

Array = NDArray[np.float64]

COARSE_STEP = 0.002
"""[s] of the replay where no servo reports; contacts and limits are twice as long as that. What servos report tells
such a step from the twin's own: a knee's torque is three noise floors off in it."""
HORIZON = 0.8
"""[s] of a window: two thirds of a stride. What a fault does to the body adds up from step to step: in windows twice as
long as a third of a stride it shows 1.4 times as far above the noise, and an unchanged mouse is replayed as well."""
WINDOWS = 12
"""A minute of walking repeats itself; these many windows say what there is to say."""
REPORTING_HORIZON, REPORTING_WARM_UP, REPORTING_WINDOWS = 0.4, 0.6, 15
"""[s], [s] and number where servos report: what is wrong with one shows soon, but its integrator remembers for half a
second."""
EFFORT = dataclasses.replace(HEAVY, hopeful=30, survivors=8, finalists=4, swapped=1, twice=True)
"""Every number of a mouse that was built by hand is a little off, and its gait is anything but linear in them."""
LEFT = 1.4
"""[noise floors] that a mouse in the protocol leaves in a channel of the tracker at most where all is explained. Of two
sealed sets (2511262346, 980152843) healthy mice and single faults leave 1.22 at most (24), unknown faults 1.98 to 3.4
(4), and pairs of which one was found 1.5 to 3.6 (3 of 5; of the others the second fault shows nothing)."""
SERVO_JOINTS, CABLE_JOINTS = ("_hip_joint", "_pulley_joint"), ("_knee_joint",)
"""Joints whose servo has an integrator, and joints that a cable holds against a spring."""


def replayed_spec(robot: RobotParameters, reports: bool) -> mujoco.MjSpec:
    """The mouse's model as it is replayed; ``reports``: whether servos report where they are."""
    spec = diagnosis_spec(robot)
    if not reports:
        spec.option.timestep = COARSE_STEP
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    return spec


def robot_plant(robot: RobotParameters, columns: Sequence[str], channels: Channels | None = None) -> Plant:
    """The mouse's nominal model with the channels that a table holds.

    Raises:
        GapInputError: the table commands or measures nothing.
    """
    mapping = robot_map(robot, columns, channels)
    spec = replayed_spec(robot, servos_report(mapping))
    # Sensors that nobody reads cost a tenth of a step.
    read = {row.sensor for row in mapping.outputs}
    for sensor in [s for s in spec.sensors if s.name not in read]:
        spec.delete(sensor)
    plant = build_plant(spec, mapping)
    outputs = tuple(dataclasses.replace(output, subsystem=subsystem(output)) for output in plant.outputs)
    joints = plant.names(mujoco.mjtObj.mjOBJ_JOINT)
    free, late = (frozenset(n for n in joints if n.endswith(ends)) for ends in (CABLE_JOINTS, SERVO_JOINTS))
    return dataclasses.replace(plant, outputs=outputs, free=free, late=late)


def subsystem(output: OutputChannel) -> str:
    """What a channel is about, in the words of the mouse."""
    name = output.name
    leg = next((leg for leg in LEGS if name.startswith(leg)), None)
    if name.startswith("base_"):
        return "body"
    if name.startswith("gyro"):
        return "IMU"
    if leg is not None and name.endswith("encoder"):
        return f"{leg} knee joint"
    if name.startswith("marker_"):
        place = name.removeprefix("marker_").rsplit("_", 1)[0]
        return place.replace("_foot", " foot").replace("_torso", " body")
    servo = name.removesuffix("_position").removesuffix("_torque")
    return f"servo {servo}"


def options_for(
    plant: Plant,
    robot: RobotParameters,
    columns: Sequence[str],
    base: Options | None = None,
    said: Mapping[str, float] | None = None,
) -> Options:
    """How to diagnose this plant.

    ``base`` carries what does not depend on the robot, ``said`` what sensors say of their own columns (`uncertainty`).
    """
    base = base or Options()
    reports = servos_report(plant.map)
    least = resolution(columns)
    least |= {column: max(sd, least.get(column, 0.0)) for column, sd in (said or {}).items()}
    return dataclasses.replace(
        base,
        finer=1,  # `robot_plant` has chosen.
        groups=groups(plant.model),
        keep=worth_a_look(plant),
        nuisances=nuisances,
        max_windows=base.max_windows or (REPORTING_WINDOWS if reports else WINDOWS),
        horizon=REPORTING_HORIZON if reports else HORIZON,
        warm_up=REPORTING_WARM_UP if reports else base.warm_up,
        resolution=least,
        phases=gait_phases,
        menu=MouseMenu(robot),
        # Whoever is in a hurry has no time to look twice, and servos that report say where to look.
        effort=base.effort or (None if reports or base.budget is not None else EFFORT),
    )


def diagnose_robot(
    tables: Sequence[dict[str, Array]],
    robot: RobotParameters,
    options: Options | None = None,
    channels: Channels | None = None,
    sources: Sequence[str] = (),
    reference: Sequence[dict[str, Array]] = (),
    stands: Sequence[Setup | None] = (),
) -> Diagnosis:
    """Diagnose recordings of the mouse, each a table as `mcap_table` and `simulate` give it.

    ``reference``: recordings of the same mouse when it was well; then the fault is what is new. ``stands``: what each
    recording, the references last, has hung in.

    Raises:
        GapInputError: the tables cannot be used.
    """
    every = [*tables, *reference]
    columns = [c for c in tables[0] if all(c in t for t in every)]
    plant = robot_plant(robot, columns, channels)
    names = list(sources) or [f"recording {i}" for i in range(len(every))]
    plant, recordings = placed(plant, every, list(stands) or [None] * len(every), names)
    well = recordings[len(tables) :]
    options = dataclasses.replace(options_for(plant, robot, columns, options, uncertainty(every)), reference=well)
    # The twin tells of simulations that break down; here some candidates are meant to.
    log = logging.getLogger("nermo_sim.twin")
    level = log.level
    log.setLevel(logging.CRITICAL)
    try:
        found = diagnose(recordings[: len(tables)], plant, options)
    finally:
        log.setLevel(level)
    return found


def warm_up_of(reports: bool) -> float:
    """[s] before a window in which the model is held to the measurement; more where servos report."""
    return REPORTING_WARM_UP if reports else WARM_UP


def placed(
    plant: Plant, tables: Sequence[dict[str, Array]], stands: Sequence[Setup | None], names: Sequence[str]
) -> tuple[Plant, list[Recording]]:
    """The plant with the stands that the recordings hung in, and the recordings, each in its own.

    Raises:
        GapInputError: a table lacks what the plant's map names.
    """
    setups = (AS_MODELLED, *dict.fromkeys(stand for stand in stands if stand is not None))
    recordings = [recording_from_table(t, plant, n) for t, n in zip(tables, names, strict=True)]
    for recording, stand in zip(recordings, stands, strict=True):
        recording.setup = np.full(len(recording.time), 0.0 if stand is None else float(setups.index(stand)))
    return dataclasses.replace(plant, setups=setups), recordings


def diagnose_recordings(
    paths: Sequence[Path], robot: str | None, options: Options | None = None, reference: Sequence[Path] = ()
) -> Diagnosis:
    """Diagnose recordings of the mouse: MCAPs, or tables with the columns of `channels`.

    ``robot`` is a name or a parameter file; where None, what the recordings say, or nermo_lite. ``reference``:
    recordings of the same mouse when it was well.

    Raises:
        GapInputError: a recording cannot be used.
        ParameterError: the robot's parameters cannot be read.
    """
    now = [folder for path in paths for folder in segments(path)]
    well = [folder for path in reference for folder in segments(path)]
    every, scenes = [*now, *well], [scene_of(path) for path in (*now, *well)]
    said = {name for path, scene in zip(every, scenes, strict=True) if (name := _robot_of(path, scene))}
    if robot is None and len(said) > 1:
        raise GapInputError(f"the recordings are of different robots ({', '.join(sorted(said))})")
    parameters = load_robot(robot or next(iter(said), "nermo_lite"))
    read_now, read_well = read(now, scenes[: len(now)], parameters), read(well, scenes[len(now) :], parameters)
    if read_now.looks and (not well or read_now.looks == read_well.looks):
        reports = Channels.of(parameters).servos
        options = dataclasses.replace(options or Options(), cut=looker(read_now.looks, warm_up_of(reports)))
        if not reports and not any(column.startswith("marker_") for column in read_now.tables[0]):
            options = dataclasses.replace(options, left=LEFT)
    found = diagnose_robot(
        read_now.tables,
        parameters,
        options,
        sources=[str(p) for p in every],
        reference=read_well.tables,
        stands=[*read_now.stands, *read_well.stands],
    )
    told = {path: scene.slow_motion for path, scene in zip(every, scenes, strict=True) if scene}
    slow = [f"{path}: {sentence}" for path, sentence in told.items() if sentence]
    found.report["warnings"] = [*slow, *found.report["warnings"]]
    found.report["robot_file"] = robot or parameters.name
    return found


def _robot_of(path: Path, scene: SceneFile | None) -> str | None:
    """The robot that a recording says it is of."""
    if scene is not None:
        return scene.robot
    return recorded_robot(path) if is_mcap(path) else None
