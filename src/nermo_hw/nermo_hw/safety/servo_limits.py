"""Position, rate and torque limits of the servos, from the robot's parameters."""

from __future__ import annotations

import numpy as np

from nermo_description.parameters import RobotParameters
from nermo_hw.types import Array


class ServoLimits:
    """Bends targets so that they stay within what each servo may do. Arrays are in the order of `robot.servos`.

    torque_share: share of the stall torque that a servo may be asked for, (0, 1].
    """

    def __init__(self, robot: RobotParameters, torque_share: float = 1.0) -> None:
        servos = robot.servos.values()
        self.lower = np.array([servo.lower for servo in servos])
        self.upper = np.array([servo.upper for servo in servos])
        self.max_velocity = np.array([servo.max_velocity for servo in servos])
        self._gain = np.array([servo.proportional_gain for servo in servos])
        self._damping = np.array([servo.damping for servo in servos])
        self._torque = torque_share * np.array([servo.max_torque for servo in servos])

    def position(self, target: Array) -> Array:
        """Within [lower, upper]; what is not finite goes to the middle, though nothing of that kind should get here."""
        safe = np.where(np.isfinite(target), target, 0.5 * (self.lower + self.upper))
        return np.clip(safe, self.lower, self.upper)

    def rate(self, target: Array, last: Array, dt: float, velocity: float | None = None) -> Array:
        """At most as far from `last` as a servo turns in dt [s], or as `velocity` [rad/s] allows where that is less."""
        speed = self.max_velocity if velocity is None else np.minimum(self.max_velocity, velocity)
        return np.clip(target, last - speed * dt, last + speed * dt)

    def torque(self, target: Array, position: Array, velocity: Array) -> Array:
        """So near to where the servo is that its P controller, damped by its motor, asks for no more than allowed.

        With torque = gain (target - position) - damping velocity, as `ServoType` models it. A servo that did not say
        where it is (not finite) is left alone.
        """
        reach = self._torque / self._gain
        with np.errstate(over="ignore", invalid="ignore"):
            centre = position + self._damping * velocity / self._gain
            bent = np.clip(target, centre - reach, centre + reach)
        return np.where(np.isfinite(bent), bent, target)
