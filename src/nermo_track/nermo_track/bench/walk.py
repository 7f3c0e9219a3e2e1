"""A walk of the twin whose truth is known: what its servos are told, and where base_link is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from nermo_control.controller import Controller
from nermo_control.gait.knowledge_base import GaitParameters
from nermo_control.types import ControlCommand, Posture
from nermo_description.parameters import RobotParameters
from nermo_sim.loop import schedule
from nermo_sim.twin import Twin

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
        within = np.clip(time, self.time[0], self.time[-1])
        place = np.column_stack([np.interp(within, self.time, column) for column in self.position.T])
        return place, Slerp(self.time, self.rotation)(within)


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
