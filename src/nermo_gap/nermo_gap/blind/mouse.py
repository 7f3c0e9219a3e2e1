"""The mouse as a robot of the blind check: its model as one MJCF, what a camera sees of it, its own walking commands.

Only making cases needs the packages imported here; diagnosing reads the model and the map from files like any robot's.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nermo_control.gait.knowledge_base import GaitParameters
from nermo_control.types import ControlCommand
from nermo_description.model import build_spec
from nermo_description.one_file import one_file
from nermo_description.parameters import LEGS
from nermo_description.robots import load_robot
from nermo_sim.loop import Loop, schedule
from simgap.blind.cases import HEAVY, Robot

Array = NDArray[np.float64]

NAME = "nermo_lite"


@cache
def xml() -> str:
    """The twin without its skins, in one file."""
    return one_file(build_spec(load_robot(NAME), "flat"))


@cache
def _servos() -> tuple[str, ...]:
    return tuple(load_robot(NAME).servos)


def mapping() -> dict[str, Any]:
    """Commands in, and what a camera beside the walkway sees: the torso's pose, hips and knees."""
    angles = [f"{leg}_{joint}_joint" for leg in LEGS for joint in ("hip", "knee")]
    return {
        "time": {"column": "t", "unit": "s"},
        "inputs": [{"column": f"{s}_cmd", "unit": "rad", "actuator": s, "kind": "position"} for s in _servos()],
        "outputs": [
            *[{"column": n, "unit": "rad", "joint": n, "quantity": "position"} for n in angles],
            *[{"column": a, "unit": "m", "body": "torso", "quantity": "position", "component": a} for a in "xyz"],
            *[
                {"column": f"q{a}", "unit": "1", "body": "torso", "quantity": "orientation", "component": a}
                for a in "wxyz"
            ],
        ],
    }


def walk(seed: int, n: int, period: float) -> dict[str, Array]:
    """Servo commands of a walk at changing speed, as the mouse's own controller gives them on the nominal twin."""
    rng = np.random.default_rng(seed)
    times = [0.2, *np.sort(rng.uniform(2.0, n * period, 3))]
    says = [(float(t), ControlCommand(0, forward_velocity=float(rng.uniform(0.04, 0.1)))) for t in times]
    recording = Loop.build(load_robot(NAME), GaitParameters()).run(schedule(says), n * period)
    commands = np.asarray(recording.commands, float)
    return {f"{s}_cmd": commands[:n, i] for i, s in enumerate(_servos())}


def nermo_lite() -> Robot:
    """The mouse for the blind check; it takes minutes a case. Its camera is noisier than the small robots' sensors."""
    return Robot(NAME, xml(), mapping(), {}, walk, noise=5.0, share=HEAVY)
