"""The tail: the chain model of the spine (N 5.2.1), adapted to 18 joints of one stiffness and a tapering tendon.

N sets the spine's angle by its tendon's length. In the tail the tendon comes nearer to the axis towards the tip, so
that its one tension F bends joint i by theta_i = F o_i / k, o_i being its distance from the axis there; it shortens by
sum(o_i theta_i). So a servo that pulls in r q bends the whole tail by

    theta = r q sum(o_i) / sum(o_i^2),

whatever the stiffness k. Positive bends to the left, as with the spine.
"""

from __future__ import annotations

from typing import Literal

from nermo_control.follower import POSE_RESPONSE_TIME, Follower
from nermo_description.parameters import RobotParameters

TailMode = Literal["off", "spine"]

JOINTS = 18
"""N 4.2"""
TIP_SHARE = 1.0 / 3.0
"""Tendon offset at the tip over that at the root."""


class TailController:
    """Position of the servo `tail` [rad].

    The tail bends by a commanded angle and, in the mode `spine`, against the spine: as the hip yaws to one side the
    tail bends to the other, and goes on pointing straight back.
    """

    def __init__(self, robot: RobotParameters, period_ns: int) -> None:
        offsets = [robot.tail.tendon_offset * (1.0 - (1.0 - TIP_SHARE) * (i + 0.5) / JOINTS) for i in range(JOINTS)]
        self.angle_per_servo = robot.tail.pulley_radius * sum(offsets) / sum(o * o for o in offsets)
        """Bend of the whole tail over the servo's angle."""
        self._servo = robot.servos["tail"]
        self._spine_joints = len(robot.spine.lateral_joints)
        self._period = period_ns * 1e-9
        self.reset()

    def reset(self) -> None:
        """Straight."""
        self._angle = Follower(self._period, response_time=POSE_RESPONSE_TIME)
        self._by_spine = Follower(self._period)

    def step(self, mode: TailMode, angle: float, flexion: float) -> float:
        """Servo position for an angle of the whole tail [rad] and the spine's flexion [rad per joint], within range."""
        by_spine = self._by_spine.step(1.0 if mode == "spine" else 0.0)
        bend = self._angle.step(angle) - by_spine * self._spine_joints * flexion
        position = self._servo.neutral + bend / self.angle_per_servo
        return max(self._servo.lower, min(position, self._servo.upper))
