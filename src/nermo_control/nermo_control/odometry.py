"""Dead reckoning from legs and IMU: a foot on the ground stays where it is, so the body moves against it.

The mouse has no contact switches; a foot counts as standing while it is as low as the lowest one, with the body tilted
as the IMU says. Knees give way under load, which servos do not see, so feet that swing are not much higher than that:
a wide band of heights would take them for standing and find less than half of the way. Slipping feet are not noticed:
the position drifts with the distance walked, the heading only with the IMU.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from nermo_control.legs.kinematics import LegKinematics
from nermo_control.spine.kinematics import SpineKinematics
from nermo_control.spine.tendon import SpineTendon
from nermo_description.parameters import LEGS, RobotParameters
from nermo_description.silence import WALK

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
"""(w, x, y, z)."""

STANDING_WITHIN = 1e-4
"""Height above the lowest foot within which a foot stands [m]: no more than feet of equal height differ by. On the twin
dead reckoning then finds 0.96 to 1.24 of the way of all gaits; with 0.5 mm 0.4 to 1.2, with 2 mm 0.4 to 0.5."""
VELOCITY_TIME_CONSTANT = 0.1
"""Of the low pass on the velocities [s]."""


@dataclass(frozen=True, slots=True)
class BaseState:
    """Pose and velocity of base_link in odom, REP-103."""

    stamp: int
    position: Vector
    """[m]"""
    orientation: Quaternion
    linear_velocity: Vector
    """[m/s], in base_link turned level."""
    turn_rate: float
    """[rad/s], about the vertical, positive left."""


class LegOdometry:
    """Integrates the movement of the body against its standing feet. odom begins where the mouse is at first."""

    def __init__(self, robot: RobotParameters) -> None:
        number = {name: place for place, name in enumerate(robot.servos)}
        pairs = (LegKinematics(robot.front_leg, "front"), LegKinematics(robot.rear_leg, "rear"))
        self._legs = [
            (pairs[leg // 2].forward, number[f"{name}_hip"], number[f"{name}_knee"], robot.hip_positions[leg])
            for leg, name in enumerate(LEGS)
        ]
        self._spine_servo = number["spine_lateral"]
        self._spine = SpineKinematics(robot.spine)
        self._tendon = SpineTendon(robot.spine, robot.servos["spine_lateral"].neutral)
        self._servos = [servo.neutral for servo in robot.servos.values()]
        self._sole = robot.rear_leg_dynamics.foot_radius
        self._x = self._y = self._yaw = 0.0
        self._first_yaw: float | None = None
        self._last_stamp: int | None = None
        self._feet: list[Vector] = []
        self._velocity = (0.0, 0.0)
        self._turn_rate = 0.0

    def step(
        self,
        stamp: int,
        servo_positions: Sequence[float],
        orientation: Quaternion | None,
        yaw_rate: float = 0.0,
    ) -> BaseState:
        """State of the body at `stamp` [ns] from servo positions [rad], robot order, and the IMU's orientation.

        Without an orientation the body counts as level and `yaw_rate` [rad/s] is integrated. What is not finite
        keeps its last value.
        """
        elapsed = 0.0
        # After a longer gap nothing is said about what happened in it.
        if self._last_stamp is not None and 0 < stamp - self._last_stamp <= WALK.after * 1e9:
            elapsed = (stamp - self._last_stamp) * 1e-9
        self._last_stamp = stamp
        self._servos = [
            new if math.isfinite(new) else last for new, last in zip(servo_positions, self._servos, strict=True)
        ]
        tilt, yaw = self._attitude(orientation, yaw_rate, elapsed)
        feet = self._feet_in_odom_axes(tilt, yaw)
        lowest = min(z for _, _, z in feet)
        standing = [z <= lowest + STANDING_WITHIN for _, _, z in feet]
        if elapsed > 0.0:
            self._move(feet, standing, math.remainder(yaw - self._yaw, math.tau), elapsed)
        else:
            self._velocity, self._turn_rate = (0.0, 0.0), 0.0
        self._feet, self._yaw = feet, yaw

        vx, vy = self._velocity
        cos, sin = math.cos(yaw), math.sin(yaw)
        turn = (math.cos(0.5 * yaw), 0.0, 0.0, math.sin(0.5 * yaw))
        return BaseState(
            stamp,
            (self._x, self._y, self._sole - lowest),
            _product(turn, tilt),
            (cos * vx + sin * vy, cos * vy - sin * vx, 0.0),
            self._turn_rate,
        )

    def _attitude(self, orientation: Quaternion | None, yaw_rate: float, elapsed: float) -> tuple[Quaternion, float]:
        """Tilt of the body without its yaw, and the yaw [rad], 0 at the start."""
        norm = math.hypot(*orientation) if orientation is not None else 0.0
        if orientation is None or not 0.5 < norm < 2.0:
            return (1.0, 0.0, 0.0, 0.0), self._yaw + (yaw_rate * elapsed if math.isfinite(yaw_rate) else 0.0)
        w, x, y, z = (part / norm for part in orientation)
        yaw = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
        if self._first_yaw is None:
            self._first_yaw = yaw - self._yaw
        level = (math.cos(0.5 * yaw), 0.0, 0.0, -math.sin(0.5 * yaw))
        return _product(level, (w, x, y, z)), math.remainder(yaw - self._first_yaw, math.tau)

    def _feet_in_odom_axes(self, tilt: Quaternion, yaw: float) -> list[Vector]:
        """The feet from the origin of base_link, in the axes of odom [m]."""
        flexion = self._tendon.flexion(self._servos[self._spine_servo])
        rotation = _matrix(_product((math.cos(0.5 * yaw), 0.0, 0.0, math.sin(0.5 * yaw)), tilt))
        feet: list[Vector] = []
        for leg, (forward, hip, knee, (hip_x, hip_y, hip_z)) in enumerate(self._legs):
            x, z = forward(self._servos[hip], self._servos[knee])
            foot: Sequence[float] = (hip_x + x, hip_y, hip_z + z)
            if leg >= 2 and flexion != 0.0:
                foot = self._spine.point(self._spine.in_hip_frame(foot), flexion).tolist()
            feet.append(tuple((rotation @ foot).tolist()))
        return feet

    def _move(self, feet: list[Vector], standing: list[bool], turned: float, elapsed: float) -> None:
        steps = [
            (before[0] - now[0], before[1] - now[1])
            for before, now, stands in zip(self._feet, feet, standing, strict=True)
            if stands
        ]
        dx = sum(step[0] for step in steps) / len(steps)
        dy = sum(step[1] for step in steps) / len(steps)
        self._x += dx
        self._y += dy
        share = elapsed / (VELOCITY_TIME_CONSTANT + elapsed)
        vx, vy = self._velocity
        self._velocity = vx + share * (dx / elapsed - vx), vy + share * (dy / elapsed - vy)
        self._turn_rate += share * (turned / elapsed - self._turn_rate)


def _product(a: Quaternion, b: Quaternion) -> Quaternion:
    return (
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    )


def _matrix(q: Quaternion) -> np.ndarray:
    w, x, y, z = q
    return np.array(
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
            [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
            [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
        ]
    )
