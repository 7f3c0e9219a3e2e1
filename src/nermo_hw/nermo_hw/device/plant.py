"""What hangs on the boards: servos and sensors, behind a protocol that a simulated robot can fill as well."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from nermo_description.parameters import LEGS, RobotParameters
from nermo_hw.sbcp.boards import TACTILE_CHANNELS

Array = NDArray[np.float64]

STEP = 1e-3
"""Time of one step [s]."""


@dataclass(slots=True)
class PlantSensors:
    """What there is to measure; n servos in the order of the robot's."""

    positions: Array
    """[rad], shape (n,)"""
    velocities: Array
    """[rad/s], shape (n,)"""
    torques: Array
    """[N m], shape (n,)"""
    knee_angles: Array
    """theta1 [rad], shape (4,)"""
    cells: dict[str, Array]
    """What each cell of the feet reads [V], shape (4,) in the order of LEGS"""
    orientation: Array
    """(w, x, y, z)"""
    angular_velocity: Array
    """[rad/s], shape (3,), IMU axes"""
    linear_acceleration: Array
    """[m/s^2], shape (3,), IMU axes"""


class Plant(Protocol):
    """The robot as its servos move it."""

    def step(self, targets: Array, energised: NDArray[np.bool_]) -> None:
        """Advances by `STEP`. targets [rad] and energised have shape (n,); a servo without power is limp."""
        ...

    def sensors(self) -> PlantSensors:
        """The present measurements."""
        ...

    def move_by_hand(self, servo: int, position: float) -> None:
        """Somebody takes a limp servo's horn and puts it to a position [rad]."""
        ...


class ServoPlant:
    """Servos on a bench: each its own second-order system, nothing attached, the robot level and at rest."""

    def __init__(self, robot: RobotParameters) -> None:
        servos = list(robot.servos.values())
        self._gain = np.array([servo.proportional_gain for servo in servos])
        self._derivative = np.array([servo.derivative_gain for servo in servos])
        self._damping = np.array([servo.damping for servo in servos])
        self._inertia = np.array([servo.armature for servo in servos])
        self._limit = np.array([servo.max_torque for servo in servos])
        self._lower = np.array([servo.lower for servo in servos])
        self._upper = np.array([servo.upper for servo in servos])
        self._position = np.array([servo.neutral for servo in servos])
        self._velocity = np.zeros(len(servos))
        self._torque = np.zeros(len(servos))
        self._knees = np.array([robot.front_leg_dynamics.knee.rest] * 2 + [robot.rear_leg_dynamics.knee.rest] * 2)

    def step(self, targets: Array, energised: NDArray[np.bool_]) -> None:
        """As `Plant` says; implicit in the damping, so that 1 ms is short enough for any servo."""
        error = np.clip(targets, self._lower, self._upper) - self._position
        torque = self._gain * error - self._derivative * self._velocity
        self._torque = np.where(energised, np.clip(torque, -self._limit, self._limit), 0.0)
        share = STEP / self._inertia
        self._velocity = (self._velocity + share * self._torque) / (1.0 + share * self._damping)
        self._position = self._position + STEP * self._velocity
        stopped = (self._position < self._lower) | (self._position > self._upper)
        self._velocity[stopped] = 0.0
        np.clip(self._position, self._lower, self._upper, out=self._position)

    def sensors(self) -> PlantSensors:
        """As `Plant` says; nothing is felt by the feet."""
        return PlantSensors(
            positions=self._position.copy(),
            velocities=self._velocity.copy(),
            torques=self._torque.copy(),
            knee_angles=self._knees.copy(),
            cells={cell: np.zeros(len(LEGS)) for cell in TACTILE_CHANNELS},
            orientation=np.array([1.0, 0.0, 0.0, 0.0]),
            angular_velocity=np.zeros(3),
            linear_acceleration=np.array([0.0, 0.0, 9.81]),
        )

    def move_by_hand(self, servo: int, position: float) -> None:
        """As `Plant` says."""
        self._position[servo] = position
        self._velocity[servo] = 0.0
