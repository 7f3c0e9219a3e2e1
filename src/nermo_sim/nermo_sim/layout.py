"""Where in a compiled model the things with agreed names stand, looked up once so that a control tick only indexes."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from nermo_description.parameters import LEGS

Indices = NDArray[np.intp]


class ModelError(ValueError):
    """The model lacks something that the twin needs."""


class ModelLayout:
    """Indices of servos, sensors, feet and frames of one model.

    Raises ModelError where an actuator, sensor, site or geom with an agreed name is missing.
    """

    def __init__(self, model: mujoco.MjModel, servos: Sequence[str]) -> None:
        self.servos = tuple(servos)
        self.actuators: Indices = np.array([_find(model, mujoco.mjtObj.mjOBJ_ACTUATOR, name) for name in servos])
        self.servo_position = self._sensors(model, [f"{name}_position" for name in servos])
        self.servo_velocity = self._sensors(model, [f"{name}_velocity" for name in servos])
        self.servo_torque = self._sensors(model, [f"{name}_torque" for name in servos])
        self.foot_force = self._sensors(model, [f"{leg}_foot_force" for leg in LEGS])
        self.knee_encoder = self._sensors(model, [f"{leg}_knee_encoder" for leg in LEGS])
        self.orientation = self._sensors(model, ["imu_orientation"])
        self.gyro = self._sensors(model, ["imu_gyro"])
        self.accelerometer = self._sensors(model, ["imu_accelerometer"])
        self.base_site = _find(model, mujoco.mjtObj.mjOBJ_SITE, "base_link")
        self.base_body = int(model.site_bodyid[self.base_site])
        self.foot_of_geom = {
            _find(model, mujoco.mjtObj.mjOBJ_GEOM, f"{leg}_foot"): number for number, leg in enumerate(LEGS)
        }
        self.root_position = int(model.jnt_qposadr[_find(model, mujoco.mjtObj.mjOBJ_JOINT, "root")])
        hinges = [joint for joint in range(model.njnt) if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE]
        self.joints = tuple(mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_JOINT, joint) for joint in hinges)
        self.joint_position: Indices = np.array([model.jnt_qposadr[joint] for joint in hinges])
        self.joint_velocity: Indices = np.array([model.jnt_dofadr[joint] for joint in hinges])
        self.keyframes = {model.key(number).name: number for number in range(model.nkey)}

    @staticmethod
    def _sensors(model: mujoco.MjModel, names: Sequence[str]) -> Indices:
        indices: list[int] = []
        for name in names:
            sensor = _find(model, mujoco.mjtObj.mjOBJ_SENSOR, name)
            start = int(model.sensor_adr[sensor])
            indices.extend(range(start, start + int(model.sensor_dim[sensor])))
        return np.array(indices)


def _find(model: mujoco.MjModel, kind: mujoco.mjtObj, name: str) -> int:
    number = mujoco.mj_name2id(model, kind, name)
    if number < 0:
        raise ModelError(f"the model has no {kind.name.removeprefix('mjOBJ_').lower()} named {name!r}")
    return int(number)
