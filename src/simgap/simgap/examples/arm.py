"""An arm with a fault that nobody is told of: model, map and log as a user would have them."""

from __future__ import annotations

import csv
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
import yaml

from simgap.blind.robots import ARM, MAPS, commands
from simgap.data.errors import GapInputError
from simgap.data.mapping import parse_map
from simgap.data.plant import build_plant

SECONDS, PERIOD, NOISE = 15.0, 0.005, 3e-4
"""Length and sampling period [s] of the log, and the noise of its encoders [rad]."""


@dataclass(frozen=True)
class Fault:
    """A change of the model, the effect that a diagnosis calls it by, and a sentence."""

    effect: str
    sentence: str
    change: Callable[[mujoco.MjModel], None]


def _rub(model: mujoco.MjModel) -> None:
    model.dof_frictionloss[model.joint("elbow").dofadr] = 0.25


def _weaken(model: mujoco.MjModel) -> None:
    servo = model.actuator("shoulder_servo").id
    model.actuator_gainprm[servo, 0] *= 0.6
    model.actuator_biasprm[servo, 1:3] *= 0.6


def _load(model: mujoco.MjModel) -> None:
    body = model.body("fore").id
    model.body_mass[body] *= 1.5
    model.body_inertia[body] *= 1.5


FAULTS = (
    Fault("coulomb_friction@elbow", "the elbow rubs with 0.25 N m", _rub),
    Fault("servo_gain@shoulder_servo", "the shoulder's servo is 0.6 times as strong", _weaken),
    Fault("mass@fore", "the forearm weighs 0.3 kg more", _load),
)


def make(folder: Path, seed: int) -> Fault:
    """Write `model.xml`, `map.yaml` and `log.csv` into a folder; the fault, its size and the motion come of the seed.

    Raises:
        GapInputError: the folder cannot be written.
    """
    fault = FAULTS[seed % len(FAULTS)]
    plant = build_plant(mujoco.MjSpec.from_string(ARM), parse_map(dict(MAPS["arm"])))
    model, steps = plant.model, round(PERIOD / plant.model.opt.timestep)
    fault.change(model)
    mujoco.mj_setConst(model, mujoco.MjData(model))
    count = round(SECONDS / PERIOD)
    told, data = commands("arm", seed, count, PERIOD), mujoco.MjData(model)
    noise = NOISE * np.random.default_rng(seed).standard_normal((count, len(plant.outputs)))
    header = ["t", *told, *(output.column for output in plant.outputs)]
    rows = []
    for k in range(count):
        for channel in plant.inputs:
            data.ctrl[channel.actuator] = told[channel.column][k] * channel.scale
        mujoco.mj_forward(model, data)
        seen = plant.read(data.sensordata) + noise[k]
        rows.append([f"{v:.9g}" for v in (k * PERIOD, *(column[k] for column in told.values()), *seen)])
        mujoco.mj_step(model, data, steps)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "model.xml").write_text(ARM + "\n", encoding="utf-8")
        (folder / "map.yaml").write_text(yaml.safe_dump(MAPS["arm"], sort_keys=False), encoding="utf-8")
        with (folder / "log.csv").open("w", newline="", encoding="utf-8") as file:
            csv.writer(file).writerows([header, *rows])
    except OSError as error:
        raise GapInputError(f"{folder}: cannot be written ({error.strerror})") from error
    return fault
