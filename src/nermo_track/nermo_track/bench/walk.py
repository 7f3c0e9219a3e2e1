"""A walk of the twin whose truth is known: what its servos are told, and where base_link and its feet are."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from nermo_control.controller import Controller
from nermo_control.gait.knowledge_base import GaitParameters
from nermo_control.types import ControlCommand, Posture
from nermo_description.markers import MARKERS
from nermo_description.model import build_model
from nermo_description.parameters import RobotParameters
from nermo_sim.loop import schedule
from nermo_sim.twin import Twin
from nermo_track.bench.studio import Poses

Array = NDArray[np.float64]

Steps = tuple[tuple[float, float, float], ...]
"""From when [s], how fast [m/s], and how sharply it turns [rad/s]; at speed 0 it stands."""
STEPS: Steps = (
    (0.0, 0.0, 0.0),
    (1.0, 0.08, 0.0),
    (4.0, 0.0, 0.0),
    (5.0, 0.06, 0.5),
    (8.5, 0.08, -0.4),
    (12.0, 0.0, 0.0),
)
"""Stands, straight on, stands, curves both ways."""


@dataclass(frozen=True)
class Walk:
    """A walk."""

    time: Array
    """(n,) [s]"""
    command: Array
    """(n, servos) [rad]"""
    position: Array
    """(n, 3) [m] of base_link."""
    rotation: Rotation
    joints: Array | None = None
    """(n, nq) All joints, as MuJoCo's `qpos`; None where only base_link matters."""

    def poses(self, time: Array) -> tuple[Array, Rotation]:
        """Where base_link is at times (m,) [s], between the ticks as well; held before the first and after the last."""
        return _between(self.time, self.position, self.rotation)(time)


def walk(robot: RobotParameters, seconds: float, steps: Steps = STEPS) -> Walk:
    """A walk of the twin for a time [s]. Raises SimulationDivergedError."""
    twin = Twin(robot)
    controller = Controller(robot, GaitParameters(), twin.period_ns)
    says = [
        (t, ControlCommand(0, forward_velocity=speed, turn_rate=turn))
        if speed
        else (t, ControlCommand(0, posture=Posture.STAND))
        for t, speed, turn in steps
    ]
    script = schedule(says)
    ticks = round(seconds * 1e9 / twin.period_ns)
    told, place, turned, joints = [], [], [], []
    for _ in range(ticks):
        sensors, state = twin.sensors(), twin.base_state()
        output = controller.step(
            twin.time_ns, script(twin.time_ns), twin.odometry(), sensors.servo_positions, sensors.imu
        )
        told.append(list(output.servo_positions))
        place.append(state.position)
        turned.append(state.quaternion)
        joints.append(twin.data.qpos.copy())
        twin.step(output.servo_positions)
    time = np.asarray(np.arange(ticks) * twin.period_ns * 1e-9, dtype=np.float64)
    rotation = Rotation.from_quat(np.array(turned), scalar_first=True)
    return Walk(time, np.array(told), np.array(place), rotation, np.array(joints))


def marked(robot: RobotParameters, walked: Walk) -> dict[str, Poses]:
    """Where the places of markers are through a walk, between the ticks as well.

    Raises:
        ValueError: the walk is without joints.
    """
    if walked.joints is None:
        raise ValueError("a walk without joints has no feet")
    model = build_model(robot)
    data = mujoco.MjData(model)
    place, turn = (np.empty((len(MARKERS), len(walked.time), count)) for count in (3, 9))
    for row, joints in enumerate(walked.joints):
        data.qpos[:] = joints
        mujoco.mj_kinematics(model, data)
        for number, (kind, name) in enumerate(MARKERS.values()):
            frame = data.site(name) if kind == "site" else data.body(name)
            place[number, row], turn[number, row] = frame.xpos, frame.xmat
    return {
        name: _between(walked.time, where, Rotation.from_matrix(axes.reshape(-1, 3, 3)))
        for name, where, axes in zip(MARKERS, place, turn, strict=True)
    }


def _between(time: Array, position: Array, rotation: Rotation) -> Poses:
    """Poses at any time; held before the first and after the last."""
    turns = Slerp(time, rotation)

    def at(when: Array) -> tuple[Array, Rotation]:
        within = np.clip(when, time[0], time[-1])
        return np.column_stack([np.interp(within, time, column) for column in position.T]), turns(within)

    return at
