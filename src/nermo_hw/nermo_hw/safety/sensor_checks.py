"""Sensors that lie: readings that are no numbers, that do not change although they should, or that cannot be."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nermo_description.parameters import RobotParameters
from nermo_hw.safety.rules import RANGE_MARGIN, SPEED_FACTOR, Cause
from nermo_hw.types import Array, SensorSample

SENSOR_CAUSES = (
    Cause.IMU_INVALID,
    Cause.IMU_FROZEN,
    Cause.IMU_IMPLAUSIBLE,
    Cause.BATTERY_INVALID,
    Cause.BATTERY_FROZEN,
    Cause.BATTERY_IMPLAUSIBLE,
    Cause.SERVO_INVALID,
    Cause.SERVO_FROZEN,
    Cause.SERVO_IMPLAUSIBLE,
)

NORM_TOLERANCE = 0.1
"""A quaternion whose norm is further from 1 is none."""
MOVED = 0.1
"""[rad] A servo that moves so far shakes any IMU; a potentiometer that stands still meanwhile is dead."""
TURNED = 0.2
"""[rad] So far may the gyroscope turn while the orientation stays the same to the last bit."""
GYROSCOPE_DEAD_BAND = 0.2
"""[rad/s] Slower turning is not counted, as a sensor at rest has noise and an offset."""
LARGEST_ACCELERATION, LARGEST_RATE = 16.0 * 9.81, 35.0
"""[m/s^2], [rad/s] What an IMU of this size measures, 16 g and 2000 degrees a second; more counts as so much."""
SMOOTHING = 0.5
"""[s] Time constant of means in which the steps of a walk cancel out."""
GRAVITY = 9.81
GRAVITY_TOLERANCE = 0.5 * GRAVITY
"""[m/s^2] The mean acceleration, turned into the world by the orientation, is further from gravity: one lies."""
TURNING_TOLERANCE = 1.0
"""[rad/s] The mean of the gyroscope is further from how fast the orientation turns: one of them lies."""
MOVING = 0.2
"""[rad/s] A servo that turns faster draws current."""
LONGEST_STEP = 0.1
"""[s] A longer pause between two samples tells nothing and counts as none."""


@dataclass(frozen=True, slots=True)
class Finding:
    """A lie, and since when it is one."""

    since: int
    """[ns]"""
    why: str


class SensorChecks:
    """Takes one sample after another and finds what cannot be believed. Times are [ns] on one clock.

    highest_voltage: more than the robot's battery can have [V].

    A reading that does not change is suspicious only while it should: real sensors have noise, but an emulated or
    simulated one that is perfect may well stand still as long as nothing moves.
    """

    def __init__(self, robot: RobotParameters, highest_voltage: float) -> None:
        servos = list(robot.servos.values())
        self._servos = tuple(robot.servos)
        self._lower = np.array([servo.lower for servo in servos]) - RANGE_MARGIN
        self._upper = np.array([servo.upper for servo in servos]) + RANGE_MARGIN
        self._fastest = SPEED_FACTOR * np.array([servo.max_velocity for servo in servos])
        self._highest_voltage = highest_voltage
        self._findings: dict[Cause, Finding] = {}
        self._last: SensorSample | None = None
        self._last_at = 0
        self._dt = 0.0
        self._imu: bytes = b""
        self._orientation: Array | None = None
        """The last one, if it was one."""
        self._servos_low = self._servos_high = np.zeros(0)
        self._turned = 0.0
        self._acceleration_error, self._turning_error = np.zeros(3), np.zeros(3)
        self._supply: tuple[float, float] | None = None
        self._moving_for = 0.0
        self._targets_low, self._targets_high = np.full(len(self._servos), np.inf), np.full(len(self._servos), -np.inf)

    def take(self, sample: SensorSample, targets: Array | None, now: int) -> dict[Cause, Finding]:
        """What cannot be believed, by cause.

        targets: where the servos shall be in the end [rad]; None without power.
        """
        pause = (now - self._last_at) * 1e-9
        self._dt = pause if self._last is not None and 0.0 < pause <= LONGEST_STEP else 0.0
        found = {
            **({} if sample.blind else self._look_at_imu(sample)),
            **self._look_at_battery(sample),
            **({} if sample.blind else self._look_at_servos(sample, targets)),
        }
        self._findings = {
            cause: Finding(self._findings[cause].since if cause in self._findings else now, why)
            for cause, why in found.items()
        }
        if (still := self._findings.get(Cause.BATTERY_FROZEN)) is not None:  # a pause in the movement does not count
            self._findings[Cause.BATTERY_FROZEN] = Finding(now - round(self._moving_for * 1e9), still.why)
        self._last, self._last_at = sample, now
        return self._findings

    def believable_positions(self, sample: SensorSample) -> Array:
        """Where the servos are [rad]; NaN for one whose position or speed cannot be."""
        return np.where(self._impossible(sample), math.nan, sample.servo_positions)

    def _impossible(self, sample: SensorSample) -> NDArray[np.bool_]:
        positions, velocities = sample.servo_positions, sample.servo_velocities
        with np.errstate(invalid="ignore"):
            beyond: NDArray[np.bool_] = (positions < self._lower) | (positions > self._upper)
            return beyond | (np.abs(velocities) > self._fastest)

    # IMU

    def _look_at_imu(self, sample: SensorSample) -> dict[Cause, str]:
        orientation = sample.orientation
        readings = np.concatenate((orientation, sample.angular_velocity, sample.linear_acceleration))
        with np.errstate(over="ignore"):
            norm = float(np.linalg.norm(orientation))
        if not np.isfinite(readings).all() or abs(norm - 1.0) > NORM_TOLERANCE:
            self._orientation = None
            return {Cause.IMU_INVALID: f"{_numbers(readings)} are no unit quaternion, rates and accelerations"}
        found = {}
        if frozen := self._imu_frozen(sample, readings.tobytes()):
            found[Cause.IMU_FROZEN] = frozen
        if implausible := self._imu_implausible(sample):
            found[Cause.IMU_IMPLAUSIBLE] = implausible
        return found

    def _imu_frozen(self, sample: SensorSample, imu: bytes) -> str:
        positions = sample.servo_positions
        if imu != self._imu:
            self._imu, self._servos_low, self._servos_high = imu, positions, positions
        else:
            self._servos_low = np.fmin(self._servos_low, positions)
            self._servos_high = np.fmax(self._servos_high, positions)
        moved = np.nan_to_num(self._servos_high - self._servos_low)
        most = int(moved.argmax())
        if moved[most] > MOVED:
            return f"the same reading to the last bit while {self._servos[most]} has moved by {moved[most]:.2f} rad"
        if self._last is None or (sample.orientation != self._last.orientation).any():
            self._turned = 0.0
        else:
            rate = float(np.linalg.norm(sample.angular_velocity))
            self._turned += max(rate - GYROSCOPE_DEAD_BAND, 0.0) * self._dt
        if self._turned > TURNED:
            return f"the same orientation to the last bit while the gyroscope has turned by {self._turned:.2f} rad"
        return ""

    def _imu_implausible(self, sample: SensorSample) -> str:
        share = 1.0 - math.exp(-self._dt / SMOOTHING)
        acceleration = np.clip(sample.linear_acceleration, -LARGEST_ACCELERATION, LARGEST_ACCELERATION)
        rate = np.clip(sample.angular_velocity, -LARGEST_RATE, LARGEST_RATE)
        error = rotated(sample.orientation, acceleration) - np.array([0.0, 0.0, GRAVITY])
        self._acceleration_error = self._acceleration_error + share * (error - self._acceleration_error)
        if self._orientation is not None and self._dt > 0.0:
            turning = turn(self._orientation, sample.orientation) / self._dt - rate
            self._turning_error = self._turning_error + share * (turning - self._turning_error)
        self._orientation = sample.orientation
        wrong = float(np.linalg.norm(self._acceleration_error))
        if wrong > GRAVITY_TOLERANCE:
            return f"accelerometer and orientation differ by {wrong:.1f} m/s^2 on which way is up"
        wrong = float(np.linalg.norm(self._turning_error))
        if wrong > TURNING_TOLERANCE:
            return f"gyroscope and orientation differ by {wrong:.1f} rad/s"
        return ""

    # Battery

    def _look_at_battery(self, sample: SensorSample) -> dict[Cause, str]:
        voltage, current = sample.battery_voltage, sample.battery_current
        if not math.isfinite(voltage):
            return {Cause.BATTERY_INVALID: f"{voltage} V"}
        found = {}
        if voltage > self._highest_voltage:
            found[Cause.BATTERY_IMPLAUSIBLE] = f"{voltage:.2f} V, at most {self._highest_voltage:g} V are possible"
        supply = (voltage, current)
        if supply != self._supply:
            self._supply, self._moving_for = supply, 0.0
        elif self._last is not None and bool((np.abs(sample.servo_velocities) > MOVING).any()):
            self._moving_for += self._dt
        if self._moving_for > 0.0:
            found[Cause.BATTERY_FROZEN] = f"{voltage:.2f} V to the last bit while servos move"
        return found

    # Servos

    def _look_at_servos(self, sample: SensorSample, targets: Array | None) -> dict[Cause, str]:
        positions, velocities = sample.servo_positions, sample.servo_velocities
        numbers = np.isfinite(positions) & np.isfinite(velocities) & np.isfinite(sample.servo_currents)
        found = {}
        if not numbers.all():
            found[Cause.SERVO_INVALID] = f"{self._named(~numbers)}: position, speed or current is no number"
        impossible = self._impossible(sample)
        if impossible.any():
            first = int(impossible.argmax())
            found[Cause.SERVO_IMPLAUSIBLE] = (
                f"{self._servos[first]} at {positions[first]:.2f} rad, {velocities[first]:.1f} rad/s: it cannot be"
            )
        dead = self._servos_frozen(sample, targets)
        if dead.any():
            found[Cause.SERVO_FROZEN] = f"{self._named(dead)}: the same position to the last bit while told to move"
        return found

    def _servos_frozen(self, sample: SensorSample, targets: Array | None) -> NDArray[np.bool_]:
        changed = np.ones(len(self._servos), dtype=bool)
        if self._last is not None and targets is not None and not sample.limp:
            changed = sample.servo_positions != self._last.servo_positions
        for name in sample.silent_servos:  # known, and a cause of its own
            changed[self._servos.index(name)] = True
        there = sample.servo_positions if targets is None else targets
        self._targets_low = np.where(changed, there, np.fmin(self._targets_low, there))
        self._targets_high = np.where(changed, there, np.fmax(self._targets_high, there))
        with np.errstate(invalid="ignore"):
            moved: NDArray[np.bool_] = (self._targets_high - self._targets_low) > MOVED
        return moved

    def _named(self, which: NDArray[np.bool_]) -> str:
        return ", ".join(name for name, is_it in zip(self._servos, which.tolist(), strict=True) if is_it)


def rotated(quaternion: Array, vector: Array) -> Array:
    """A vector, shape (3,), turned by a unit quaternion (w, x, y, z): from body to world for an orientation."""
    w, axis = quaternion[0], quaternion[1:]
    twice = 2.0 * _cross(axis, vector)
    return vector + w * twice + _cross(axis, twice)


def turn(before: Array, after: Array) -> Array:
    """Rotation vector [rad], shape (3,), in the body's axes, from one orientation to the next."""
    w1, v1, w2, v2 = before[0], before[1:], after[0], after[1:]
    cosine = float(w1 * w2 + v1 @ v2)
    sine = w1 * v2 - w2 * v1 - _cross(v1, v2)
    length = float(np.linalg.norm(sine))
    if length < 1e-12:
        return np.zeros(3)
    angle = 2.0 * math.atan2(length, abs(cosine))
    return sine * (math.copysign(angle, cosine) / length)


def _cross(a: Array, b: Array) -> Array:
    """As np.cross, which takes ten times as long for three numbers."""
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def _numbers(values: Array) -> str:
    return f"({', '.join(f'{value:.3g}' for value in values.tolist())})"
