"""What the robot measures in one control tick, and how badly."""

from __future__ import annotations

from dataclasses import astuple, dataclass

import numpy as np
from numpy.typing import NDArray

from nermo_control.types import Imu
from nermo_sim.layout import ModelLayout

Array = NDArray[np.float64]


class SensorData:
    """All sensors of one control tick; each is taken apart only when it is read.

    `stamp` [ns] is the end of the tick. MuJoCo evaluates sensors at the start of a physics step, so the values are one
    physics step (1 ms) older than that.
    """

    __slots__ = ("_layout", "stamp", "values")

    def __init__(self, stamp: int, values: Array, layout: ModelLayout) -> None:
        self.stamp = stamp
        self.values = values
        """The model's `sensordata` of this tick, noise included."""
        self._layout = layout

    @property
    def servo_positions(self) -> list[float]:
        """[rad], in the order of the robot's servos."""
        return self.values[self._layout.servo_position].tolist()

    @property
    def servo_velocities(self) -> list[float]:
        """[rad/s], in the order of the robot's servos."""
        return self.values[self._layout.servo_velocity].tolist()

    @property
    def servo_torques(self) -> list[float]:
        """[N m], in the order of the robot's servos."""
        return self.values[self._layout.servo_torque].tolist()

    @property
    def orientation(self) -> list[float]:
        """Of the IMU in the world: unit quaternion (w, x, y, z)."""
        quaternion = self.values[self._layout.orientation]
        return (quaternion / np.linalg.norm(quaternion)).tolist()

    @property
    def angular_velocity(self) -> list[float]:
        """[rad/s], IMU axes."""
        return self.values[self._layout.gyro].tolist()

    @property
    def linear_acceleration(self) -> list[float]:
        """[m/s^2], IMU axes; at rest +9.81 upwards."""
        return self.values[self._layout.accelerometer].tolist()

    @property
    def imu(self) -> Imu:
        """Orientation and rates as the controller takes them."""
        return Imu(self.stamp, tuple(self.orientation), tuple(self.angular_velocity))  # type: ignore[arg-type]

    @property
    def foot_forces(self) -> list[float]:
        """Normal force on each foot [N], what its tactile cells feel."""
        return self.values[self._layout.foot_force].tolist()

    @property
    def knee_encoders(self) -> list[float]:
        """Knee angles theta1 [rad]."""
        return self.values[self._layout.knee_encoder].tolist()


@dataclass(frozen=True, slots=True)
class SensorNoise:
    """Standard deviations of white noise on each kind of sensor; 0 is a perfect one."""

    servo_position: float = 0.0
    """[rad]"""
    servo_velocity: float = 0.0
    """[rad/s]"""
    servo_torque: float = 0.0
    """[N m]"""
    orientation: float = 0.0
    """[1], on each element of the quaternion: half the angle's deviation in rad"""
    angular_velocity: float = 0.0
    """[rad/s]"""
    linear_acceleration: float = 0.0
    """[m/s^2]"""
    foot_force: float = 0.0
    """[N]"""
    knee_encoder: float = 0.0
    """[rad]"""

    def times(self, factor: float) -> SensorNoise:
        """So many times as much on every sensor."""
        return SensorNoise(*(factor * deviation for deviation in astuple(self)))

    def deviations(self, layout: ModelLayout, size: int) -> Array:
        """Standard deviation of each element of `sensordata`, shape (size,)."""
        result = np.zeros(size)
        for where, deviation in (
            (layout.servo_position, self.servo_position),
            (layout.servo_velocity, self.servo_velocity),
            (layout.servo_torque, self.servo_torque),
            (layout.orientation, self.orientation),
            (layout.gyro, self.angular_velocity),
            (layout.accelerometer, self.linear_acceleration),
            (layout.foot_force, self.foot_force),
            (layout.knee_encoder, self.knee_encoder),
        ):
            result[where] = deviation
        return result


TYPICAL_NOISE = SensorNoise(
    servo_position=0.002,
    servo_velocity=0.05,
    servo_torque=0.002,
    orientation=0.002,
    angular_velocity=0.01,
    linear_acceleration=0.1,
    foot_force=0.02,
    knee_encoder=0.005,
)
"""Of a 12-bit potentiometer, a consumer IMU, a printed force cell."""
