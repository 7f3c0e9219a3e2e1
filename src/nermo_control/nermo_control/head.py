"""The neck against the gait's noise in the camera picture (proposed in N 7.1.2): pan cancels yaw, tilt cancels pitch.

The gait swings the head about where the mouse is going; only that swing is cancelled, so that in a turn the cameras
look along with the body. What is measured (feedback) needs the IMU; what the spine is about to do to the front torso
(feed-forward) needs nothing, and leaves the swing that has other causes.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Literal

from nermo_control.follower import Follower
from nermo_control.types import Imu
from nermo_description.parameters import RobotParameters, ServoParameters
from nermo_description.silence import WALK

GazeMode = Literal["off", "spine", "imu"]

FRONT_SHARE = 0.41
"""Share of the spine's bend that turns the front torso; the rest turns the hip. `nermo experiment gaze` measures it on
the twin (`front_share`), in a trot with stride extension: the slope of base_link's yaw over the angle of the whole
spine. Between two standing feet half way along the body each half of the mouse turns about as much."""
IDLE_WINDOW = 1.0
"""Time over which the mean is taken while no gait cycle runs [s]."""


class Swing:
    """The part of a signal that swings with the gait: its deviation from the straight line through its last cycle.

    A constant and a steady slope drop out exactly, and so does nothing of what repeats each cycle.
    """

    def __init__(self, period: float) -> None:
        self._period = period
        self._window: deque[float] = deque()
        self._sum = 0.0

    def step(self, value: float, duration: float) -> float:
        """Takes the next value; `duration` of the cycle [s], whose change is taken up gradually."""
        window = self._window
        window.append(value)
        self._sum += value
        longest = max(2, round(duration / self._period) + 1)
        for _ in range(min(2, len(window) - longest)):
            self._sum -= window.popleft()
        # The trapezoidal mean of a whole cycle, both ends of which are the same phase of the gait.
        ends = 0.5 * (window[0] + value)
        mean = (self._sum - ends) / (len(window) - 1) if len(window) > 1 else value
        return value - mean - 0.5 * (value - window[0])


class GazeController:
    """Positions of the servos `head_pan` and, where there is one, `head_tilt`, about their neutral positions [rad]."""

    def __init__(self, robot: RobotParameters, period_ns: int) -> None:
        self._period = period_ns * 1e-9
        self._timeout = round(WALK.after * 1e9)
        self._joints = len(robot.spine.lateral_joints)
        pan, self._tilt = robot.servos["head_pan"], robot.servos.get("head_tilt")
        self._pan = pan
        # A servo trails its target by the slope of its own damping over its gain; the target itself is held for a tick
        # and is answered one tick after the measurement.
        self._lead = (pan.damping + pan.derivative_gain) / pan.proportional_gain + 1.5 * self._period
        self.reset()

    def reset(self) -> None:
        """Looks ahead, and knows of no gait."""
        self._yaw_swing, self._spine_swing = Swing(self._period), Swing(self._period)
        self._by_imu, self._by_spine = Follower(self._period), Follower(self._period)
        self._last_yaw: float | None = None
        self._yaw = 0.0
        self._counter = (0.0, 0.0)

    def step(
        self, stamp: int, mode: GazeMode, imu: Imu | None, flexion: float, gait_frequency: float
    ) -> tuple[float, float | None]:
        """Pan and tilt [rad] of one control tick; tilt is None where there is no such servo.

        `flexion` of the spine as commanded [rad per joint]; `gait_frequency` [Hz], 0 while no cycle runs. Without a
        fresh and finite IMU the mode `imu` lets the head come back to neutral.
        """
        cycle = 1.0 / gait_frequency if gait_frequency > 0.0 else IDLE_WINDOW
        seen = imu is not None and abs(stamp - imu.stamp) <= self._timeout and _finite(imu)
        if seen:
            assert imu is not None, "an IMU is seen"
            self._look(imu, cycle)
        by_imu = self._by_imu.step(1.0 if seen and mode == "imu" else 0.0)
        by_spine = self._by_spine.step(1.0 if mode == "spine" else 0.0)
        swing = FRONT_SHARE * self._joints * self._spine_swing.step(flexion, cycle)
        pan, tilt = self._counter
        pan = _within(self._pan.neutral + by_imu * pan - by_spine * swing, self._pan)
        return pan, None if self._tilt is None else _within(self._tilt.neutral + by_imu * tilt, self._tilt)

    def _look(self, imu: Imu, cycle: float) -> None:
        """Finds the angles of the neck that look level along the mean heading, for when the servos will be there."""
        w, x, y, z = imu.orientation
        yaw = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
        pitch = math.asin(max(-1.0, min(2.0 * (w * y - z * x), 1.0)))
        if self._last_yaw is not None:
            self._yaw += (yaw - self._last_yaw + math.pi) % (2.0 * math.pi) - math.pi
        self._last_yaw = yaw
        roll = math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
        roll_rate, pitch_rate, yaw_rate = imu.angular_velocity
        roll, pitch = roll + self._lead * roll_rate, pitch + self._lead * pitch_rate
        deviation = self._yaw_swing.step(self._yaw + self._lead * yaw_rate, cycle)
        sr, cr, sp, cp = math.sin(roll), math.cos(roll), math.sin(pitch), math.cos(pitch)
        if self._tilt is None:
            # The heading of (cos pan, sin pan, 0) in base_link is to be that of the level direction at -deviation.
            slope = math.tan(deviation)
            self._counter = math.atan2(-slope * cp, cr + slope * sp * sr), 0.0
            return
        # The level direction at -deviation from the heading, seen in base_link.
        forward, left, up = cp * math.cos(deviation), -math.sin(deviation), sp * math.cos(deviation)
        left, up = cr * left + sr * up, cr * up - sr * left
        self._counter = math.atan2(left, forward), -math.atan2(up, math.hypot(forward, left))


def _finite(imu: Imu) -> bool:
    return math.isfinite(sum(imu.orientation) + sum(imu.angular_velocity)) and any(imu.orientation)


def _within(position: float, servo: ServoParameters) -> float:
    return max(servo.lower, min(position, servo.upper))
