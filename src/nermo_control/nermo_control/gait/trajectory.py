"""Foot paths: control points and the two cubics through them (N 5.4.2, (5.47)-(5.48), table 5.6).

Leg planes: origin at the hip or shoulder axis, x forward, z up, in m; times in s, stamps in ns.
"""

from __future__ import annotations

import math

from nermo_control.gait.foot_locus import Point, locus_curves
from nermo_control.gait.knowledge_base import GaitParameters, stride_length
from nermo_control.types import FootTrajectory, Four, LegStates, Phase

LARGEST_DESCENT = 0.15
"""Largest mean vertical speed [m/s] between the ends of a phase; its peak stays below what the servos can do. Full
phases begin and end on the ground; a gait that changes may leave a foot in the air hardly any time to come down."""


def horizontal_spline(start: float, middle: float, end: float, duration: float) -> tuple[Four, Four]:
    """The two cubics of table 5.6, left column: at rest at both ends, twice continuous in the middle.

    Coefficients a, b, c, d of a t^3 + b t^2 + c t + d, t from the start of each half of `duration`.
    """
    half = 0.5 * duration
    middle_velocity = 0.75 * (end - start) / half
    return _cubic(start, middle, 0.0, middle_velocity, half), _cubic(middle, end, middle_velocity, 0.0, half)


def vertical_spline(start: float, middle: float, end: float, duration: float) -> tuple[Four, Four]:
    """The two cubics of table 5.6, right column: no acceleration at both ends, twice continuous in the middle."""
    half = 0.5 * duration
    rise, fall = (middle - start) / half, (end - middle) / half
    middle_velocity = 0.5 * (rise + fall)
    first = _cubic(start, middle, 0.5 * (3.0 * rise - middle_velocity), middle_velocity, half)
    second = _cubic(middle, end, middle_velocity, 0.5 * (3.0 * fall - middle_velocity), half)
    return first, second


def _cubic(start: float, end: float, start_velocity: float, end_velocity: float, duration: float) -> Four:
    """Cubic with given values and slopes at both ends (Hermite)."""
    slope = (end - start) / duration
    b = (3.0 * slope - 2.0 * start_velocity - end_velocity) / duration
    a = (start_velocity + end_velocity - 2.0 * slope) / (duration * duration)
    return a, b, start_velocity, start


def foot_position(trajectory: FootTrajectory, stamp: int) -> tuple[float, float]:
    """Foot (x, z) [m] on its trajectory at a time [ns]; before its start the first, after its end the last point."""
    t = (stamp - trajectory.start_time) * 1e-9
    duration = trajectory.duration
    t = 0.0 if t < 0.0 else duration if t > duration else t
    half = 0.5 * duration
    if t < half:
        a, b, c, d = trajectory.x_first
        e, f, g, h = trajectory.z_first
    else:
        t -= half
        a, b, c, d = trajectory.x_second
        e, f, g, h = trajectory.z_second
    return ((a * t + b) * t + c) * t + d, ((e * t + f) * t + g) * t + h


class TrajectoryGenerator:
    """Answers each request of the leg state machine with the foot's path through its next phase (tr_foot)."""

    def __init__(self, parameters: GaitParameters) -> None:
        self._parameters = parameters

    def set_parameters(self, parameters: GaitParameters) -> None:
        """Takes new gait parameters; they shape the trajectories generated from now on."""
        self._parameters = parameters

    def step(self, states: LegStates) -> tuple[FootTrajectory, ...]:
        """Trajectories of the legs that asked for one. Raises ValueError where a request makes no sense."""
        if not any(states.requested):
            return ()
        return tuple(self._trajectory(states, leg) for leg in range(4) if states.requested[leg])

    def _trajectory(self, states: LegStates, leg: int) -> FootTrajectory:
        phase, duration, share = states.next_phases[leg], states.durations[leg], states.remaining_fractions[leg]
        x, z, velocity = states.start_x[leg], states.start_z[leg], states.velocities[leg]
        frequency, duty = states.gait_frequency, states.duty_factor
        if not (math.isfinite(x + z + velocity) and 0.0 < duration < math.inf and 0.0 < share <= 1.0):
            raise ValueError(f"leg {leg}: unusable request: ({x}, {z}) m, {velocity} m/s, {duration} s, share {share}")
        if not (0.0 < frequency < math.inf and 0.0 < duty < 1.0):
            raise ValueError(f"leg {leg}: unusable gait: frequency {frequency} Hz, duty factor {duty}")

        end_x = self._stance_end(leg, x, velocity * duration)
        middle_z = self._stance_height(leg, z, share)
        if phase is Phase.SWING:
            end_x = self._touch_down(leg, x, stride_length(velocity, frequency, duty), share)
            middle_z = self._swing_height(leg, z, share)

        ground, farthest = self._parameters.stride(leg).neutral_stance_height, LARGEST_DESCENT * duration
        end_z = z + min(max(ground - z, -farthest), farthest)
        middle_z += 0.5 * (end_z - ground)
        if self._parameters.foot_path == "locus":
            stride = self._parameters.stride(leg)
            angles = stride.touch_down_angle, stride.take_off_angle
            begin, finish = reversed(angles) if phase is Phase.SWING else angles
            middle = Point(0.5 * (x + end_x), middle_z)
            curves = locus_curves(Point(x, z), middle, Point(end_x, end_z), begin, finish, duration)
            return FootTrajectory(leg, phase, states.start_time, duration, *curves)
        x_first, x_second = horizontal_spline(x, 0.5 * (x + end_x), end_x, duration)
        z_first, z_second = vertical_spline(z, middle_z, end_z, duration)
        return FootTrajectory(leg, phase, states.start_time, duration, x_first, x_second, z_first, z_second)

    # Control points (figure 5.19). Over a full phase the middle point lies on the neutral axis; over a part of one, or
    # after a change of speed, halfway between start and end, so that the foot never turns back. The start point is the
    # memory: wherever the foot is.

    def _stance_end(self, leg: int, x: float, travel: float) -> float:
        """The ground carries the foot back at the nominal velocity, as far as half the largest stride allows."""
        stride = self._parameters.stride(leg)
        reach = 0.5 * stride.max_stride_length
        neutral = stride.neutral_stride_position
        return min(max(x - travel, neutral - reach), neutral + reach)

    def _touch_down(self, leg: int, x: float, length: float, share: float) -> float:
        """Half a stride ahead of the neutral position, but no faster than twice the longest stride of a full phase."""
        stride = self._parameters.stride(leg)
        longest = stride.max_stride_length
        target = stride.neutral_stride_position + 0.5 * min(max(length, -longest), longest)
        farthest = 2.0 * longest * share
        return x + min(max(target - x, -farthest), farthest)

    def _stance_height(self, leg: int, z: float, share: float) -> float:
        stride = self._parameters.stride(leg)
        return 0.5 * (z + stride.neutral_stance_height) - stride.stance_amplitude * share

    def _swing_height(self, leg: int, z: float, share: float) -> float:
        stride = self._parameters.stride(leg)
        return 0.5 * (z + stride.neutral_stance_height) + stride.swing_amplitude * share
