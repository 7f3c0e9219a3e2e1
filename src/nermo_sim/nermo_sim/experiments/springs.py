"""How far knees and ankles give way while a foot stands loaded: the compliance of N's compliant legs (N 4.2, 7.2.1).

A knee gives way by what it is bent more than its tendon holds it to (5.18): the load has then taken over all of the
spring's pretension. An ankle gives way from its rest angle.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from nermo_control.types import Phase
from nermo_description.blocks.leg import knee_angle
from nermo_description.parameters import LEGS, RobotParameters
from nermo_sim.experiments.losses import TOUCHING
from nermo_sim.run_table import Recording

JOINTS = tuple(f"{pair}_{joint}" for pair in ("front", "rear") for joint in ("knee", "ankle"))
TOUCH_DOWN, LIFT_OFF = "touch_down", "lift_off"
"""The first and the last quarter of a stance."""


def spring_deflections(recording: Recording, model: mujoco.MjModel, robot: RobotParameters) -> dict[str, float]:
    """Deflections [deg] of each kind of joint in loaded stance, both sides together: mean and 95th percentile, and the
    means in the first and the last quarter of a stance.

    Where there is no loaded stance they are 0.
    """
    standing = (recording.phases == int(Phase.STANCE)) & (recording.foot_forces > TOUCHING)
    found: dict[str, list[NDArray[np.float64]]] = {joint: [] for joint in JOINTS}
    shares: dict[str, list[NDArray[np.float64]]] = {joint: [] for joint in JOINTS}
    for number, leg in enumerate(LEGS):
        pair, rows = leg.split("_")[0], standing[:, number]
        parameters = robot.front_leg if pair == "front" else robot.rear_leg
        pulley, knee, ankle = (
            _angles(recording, model, f"{leg}_{name}")[rows]
            for name in ("knee_pulley_joint", "knee_joint", "ankle_joint")
        )
        held = np.array([knee_angle(parameters, q2) for q2 in pulley])
        found[f"{pair}_knee"].append(np.abs(knee - held))
        found[f"{pair}_ankle"].append(np.abs(ankle - parameters.ankle_angle))
        for joint in ("knee", "ankle"):
            shares[f"{pair}_{joint}"].append(stance_shares(recording.phases[:, number])[rows])
    result: dict[str, float] = {}
    for joint, parts in found.items():
        degrees, share = np.degrees(np.concatenate(parts)), np.concatenate(shares[joint])
        result[f"{joint}_yield_mean_deg"] = float(degrees.mean()) if len(degrees) else 0.0
        result[f"{joint}_yield_p95_deg"] = float(np.percentile(degrees, 95.0)) if len(degrees) else 0.0
        for name, quarter in ((TOUCH_DOWN, share < 0.25), (LIFT_OFF, share >= 0.75)):
            result[f"{joint}_yield_{name}_deg"] = float(degrees[quarter].mean()) if quarter.any() else 0.0
    return result


def stance_shares(phases: NDArray[np.int8]) -> NDArray[np.float64]:
    """How much of its stance has passed at each of a leg's ticks, in [0, 1); NaN in swing.

    phases: of one leg, (n,). Stances that the recording cuts count as they are.
    """
    result = np.full(len(phases), np.nan)
    ticks = np.flatnonzero(phases == int(Phase.STANCE))
    for stance in np.split(ticks, np.flatnonzero(np.diff(ticks) > 1) + 1):
        result[stance] = np.arange(len(stance)) / max(len(stance), 1)
    return result


def _angles(recording: Recording, model: mujoco.MjModel, joint: str) -> Any:
    # The state starts with the time, then come the positions.
    return recording.states[:, 1 + int(model.joint(joint).qposadr[0])]
