"""A run in NumPy arrays: written tick by tick, read by quantity, kept as one .npz file."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

from nermo_control.types import MotionOutput
from nermo_description.parameters import LEGS
from nermo_sim.divergence import STATE
from nermo_sim.sensor_data import SensorData
from nermo_sim.twin import Twin

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]


class Moved(Protocol):
    """How a body moved, whoever saw it: a simulation, or a camera."""

    @property
    def time(self) -> Array:
        """(n,) [s], from the first row."""

    @property
    def position(self) -> Array:
        """(n, 3) [m], of base_link in the world."""

    @property
    def roll_pitch_yaw(self) -> Array:
        """(n, 3) [rad], of base_link; yaw without jumps. Positive pitch is nose down (REP-103)."""


class Recorder:
    """Fills preallocated arrays; `recording` hands out what has been filled so far."""

    def __init__(self, twin: Twin[Any], ticks: int) -> None:
        self._twin = twin
        self._states = np.zeros((ticks, mujoco.mj_stateSize(twin.model, STATE)))
        self._sensors = np.zeros((ticks, twin.model.nsensordata))
        self._commands = np.zeros((ticks, len(twin.layout.servos)))
        self._phases = np.zeros((ticks, len(LEGS)), dtype=np.int8)
        self._stamps = np.zeros(ticks, dtype=np.int64)
        self._count = 0

    def add(self, sensors: SensorData, output: MotionOutput) -> None:
        """Keeps one tick: the sensor data after a step and the command that led to it."""
        row = self._count
        mujoco.mj_getState(self._twin.model, self._twin.data, self._states[row], STATE)
        self._sensors[row] = sensors.values
        self._commands[row] = output.servo_positions
        self._phases[row] = output.leg_states.phases
        self._stamps[row] = sensors.stamp
        self._count += 1

    def recording(self) -> Recording:
        """What has been recorded."""
        layout, model, end = self._twin.layout, self._twin.model, self._count
        root, base = layout.root_position, layout.base_site
        return Recording(
            robot=self._twin.robot.name,
            servos=layout.servos,
            stamps=self._stamps[:end],
            states=self._states[:end],
            # The state starts with the time, then come the positions.
            root=self._states[:end, 1 + root : 1 + root + 7],
            base_in_root=np.concatenate([model.site_pos[base], model.site_quat[base]]),
            commands=self._commands[:end],
            servo_positions=self._sensors[:end, layout.servo_position],
            servo_velocities=self._sensors[:end, layout.servo_velocity],
            servo_torques=self._sensors[:end, layout.servo_torque],
            angular_velocity=self._sensors[:end, layout.gyro],
            linear_acceleration=self._sensors[:end, layout.accelerometer],
            foot_forces=self._sensors[:end, layout.foot_force],
            phases=self._phases[:end],
        )


@dataclass(frozen=True, slots=True)
class Recording:
    """One run, one row a control tick."""

    robot: str
    servos: tuple[str, ...]
    stamps: NDArray[np.int64]
    """(n,) [ns]"""
    states: Array
    """(n, state size), for `mujoco.mj_setState` with `divergence.STATE`."""
    root: Array
    """(n, 7): position [m] and quaternion (w, x, y, z) of the torso."""
    base_in_root: Array
    """(7,): pose of base_link in the torso."""
    commands: Array
    """(n, servos) [rad]"""
    servo_positions: Array
    """(n, servos) [rad]"""
    servo_velocities: Array
    """(n, servos) [rad/s]"""
    servo_torques: Array
    """(n, servos) [N m]"""
    angular_velocity: Array
    """(n, 3) [rad/s]"""
    linear_acceleration: Array
    """(n, 3) [m/s^2]"""
    foot_forces: Array
    """(n, 4) [N], normal"""
    phases: NDArray[np.int8]
    """(n, 4): 0 stance, 1 swing"""

    @property
    def time(self) -> Array:
        """(n,) [s], from the first tick."""
        return (self.stamps - self.stamps[0]) * 1e-9 if len(self.stamps) else np.zeros(0)

    @property
    def position(self) -> Array:
        """(n, 3) [m], of base_link in the world."""
        return self.root[:, :3] + _rotation(self.root[:, 3:]).apply(self.base_in_root[:3])

    @property
    def roll_pitch_yaw(self) -> Array:
        """(n, 3) [rad], of base_link; yaw without jumps. Positive pitch is nose down (REP-103)."""
        yaw_pitch_roll = (_rotation(self.root[:, 3:]) * _rotation(self.base_in_root[3:])).as_euler("ZYX")
        angles = yaw_pitch_roll[:, ::-1].copy()
        angles[:, 2] = np.unwrap(angles[:, 2])
        return angles

    def part(self, begin: float, end: float) -> Recording:
        """The ticks from `begin` to `end` [s], both counted from the first."""
        rows = (self.time >= begin) & (self.time <= end)
        whole = ("robot", "servos", "base_in_root")
        return replace(self, **{name: getattr(self, name)[rows] for name in self.__slots__ if name not in whole})

    def save(self, path: Path) -> None:
        """Writes one .npz file."""
        arrays = {name: getattr(self, name) for name in self.__slots__ if name not in ("robot", "servos")}
        about = json.dumps({"robot": self.robot, "servos": self.servos})
        np.savez_compressed(path, about=np.array(about), **arrays)

    @classmethod
    def load(cls, path: Path) -> Recording:
        """Reads what `save` wrote."""
        with np.load(path) as file:
            arrays = {name: file[name] for name in file.files}
        about = json.loads(str(arrays.pop("about")))
        return cls(robot=about["robot"], servos=tuple(about["servos"]), **arrays)


def _rotation(quaternion: Array) -> Rotation:
    """Of quaternions (..., 4), scalar first as MuJoCo has them."""
    # Not above: each simulator node imports this module, and SciPy takes a third of its start.
    from scipy.spatial.transform import Rotation

    return Rotation.from_quat(quaternion[..., [1, 2, 3, 0]])
