"""Paths that the mouse follows by itself (internal trajectory mode, N A.1.4): lines, arcs, polylines.

A path is a chain of segments of constant curvature, so that its nearest point is found exactly. Curvature is positive
to the left. Lengths in m, angles in rad, in the frame of the odometry.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Self

Pose = tuple[float, float, float]
"""x [m], y [m], yaw [rad]."""


class PathStatus(StrEnum):
    """How far a path has been followed, or why it is not."""

    IDLE = "no path"
    FOLLOWING = "following"
    FINISHED = "finished"
    TOO_TIGHT = "too tight"
    LOST = "lost"


@dataclass(frozen=True, slots=True)
class Segment:
    """A line or an arc: where it begins, how long it is and how it bends."""

    x: float
    y: float
    yaw: float
    length: float
    curvature: float = 0.0

    def pose(self, distance: float) -> Pose:
        """Point and heading at a distance [m] from the begin."""
        turned = self.curvature * distance
        if self.curvature == 0.0:
            along, across = distance, 0.0
        else:
            along, across = math.sin(turned) / self.curvature, (1.0 - math.cos(turned)) / self.curvature
        cos, sin = math.cos(self.yaw), math.sin(self.yaw)
        return self.x + cos * along - sin * across, self.y + sin * along + cos * across, self.yaw + turned

    def locate(self, x: float, y: float) -> tuple[float, float]:
        """Distance [m] from the begin to the nearest point, beyond both ends too, and how far left of it (x, y) is."""
        cos, sin = math.cos(self.yaw), math.sin(self.yaw)
        dx, dy = x - self.x, y - self.y
        along, across = cos * dx + sin * dy, cos * dy - sin * dx
        if self.curvature == 0.0:
            return along, across
        radius, side = 1.0 / abs(self.curvature), math.copysign(1.0, self.curvature)
        # Angle about the centre, unwrapped around the middle of the segment.
        middle = 0.5 * self.length / radius
        angle = math.atan2(along, radius - side * across)
        angle = (angle - middle + math.pi) % (2.0 * math.pi) - math.pi + middle
        return angle * radius, side * (radius - math.hypot(along, radius - side * across))


class Path:
    """Segments, each beginning where the last one ends.

    Raises ValueError for no segment at all, one without length, or a number that is not finite (the length of the last
    segment may be infinite).
    """

    def __init__(self, segments: Sequence[Segment]) -> None:
        if not segments:
            raise ValueError("a path needs at least one segment")
        for number, segment in enumerate(segments):
            numbers = (segment.x, segment.y, segment.yaw, segment.curvature)
            last = number == len(segments) - 1
            if not (all(map(math.isfinite, numbers)) and segment.length > 0.0 and (last or segment.length < math.inf)):
                raise ValueError(f"segment {number} of the path: {segment} must be finite and longer than 0 m")
        self.segments = tuple(segments)

    @classmethod
    def line(cls, start: Pose, length: float = math.inf) -> Self:
        """Straight ahead from a pose."""
        return cls([Segment(*start, length)])

    @classmethod
    def arc(cls, start: Pose, radius: float, angle: float) -> Self:
        """Part of a circle of `radius`, through `angle`: positive turns left, negative right. Raises ValueError."""
        if not (math.isfinite(radius) and radius > 0.0 and math.isfinite(angle) and angle != 0.0):
            raise ValueError(f"arc: radius {radius} m must be positive, angle {angle} rad finite and not 0")
        return cls([Segment(*start, radius * abs(angle), math.copysign(1.0 / radius, angle))])

    @classmethod
    def polyline(cls, points: Sequence[tuple[float, float]], corner_radius: float) -> Self:
        """Straight from point to point, with each corner rounded off. Raises ValueError where a corner has no room."""
        if len(points) < 2 or not all(math.isfinite(value) for point in points for value in point):
            raise ValueError(f"polyline: {list(points)} must be at least two finite points")
        if not corner_radius > 0.0:
            raise ValueError(f"polyline: corner_radius = {corner_radius} m must be positive")
        segments: list[Segment] = []
        position, cut = points[0], 0.0
        for number, (x, y) in enumerate(points[1:], start=1):
            px, py = points[number - 1]
            yaw, side = math.atan2(y - py, x - px), math.hypot(x - px, y - py)
            turn = 0.0
            if number < len(points) - 1:
                nx, ny = points[number + 1]
                turn = _wrapped(math.atan2(ny - y, nx - x) - yaw)
            next_cut = corner_radius * math.tan(0.5 * abs(turn))
            straight = side - cut - next_cut
            if straight < -1e-9 or side == 0.0 or abs(turn) > math.radians(170.0):
                raise ValueError(f"polyline: no room at point {number} for a corner of {corner_radius} m")
            if straight > 1e-9:
                segments.append(Segment(*position, yaw, straight))
                position = segments[-1].pose(straight)[:2]
            if turn:
                arc = Segment(*position, yaw, corner_radius * abs(turn), math.copysign(1.0 / corner_radius, turn))
                segments.append(arc)
                position = arc.pose(arc.length)[:2]
            cut = next_cut
        return cls(segments)

    def placed(self, pose: Pose) -> Path:
        """The same path, whose frame stands at a pose (x [m], y [m], yaw [rad])."""
        x, y, yaw = pose
        cos, sin = math.cos(yaw), math.sin(yaw)
        return Path(
            [
                replace(
                    segment,
                    x=x + cos * segment.x - sin * segment.y,
                    y=y + sin * segment.x + cos * segment.y,
                    yaw=yaw + segment.yaw,
                )
                for segment in self.segments
            ]
        )

    @property
    def length(self) -> float:
        """[m]"""
        return sum(segment.length for segment in self.segments)

    @property
    def smallest_radius(self) -> float:
        """Of its tightest segment [m]; infinite for a line."""
        sharpest = max(abs(segment.curvature) for segment in self.segments)
        return 1.0 / sharpest if sharpest else math.inf

    def pose(self, distance: float) -> Pose:
        """Point and heading at a distance [m] from the start, beyond both ends too."""
        for segment in self.segments[:-1]:
            if distance < segment.length:
                return segment.pose(distance)
            distance -= segment.length
        return self.segments[-1].pose(distance)


@dataclass(frozen=True, slots=True)
class Deviation:
    """Where a pose is, seen from a path."""

    progress: float
    """Distance from the path's start to the nearest point [m]."""
    cross_track: float
    """Distance to the path [m], positive left of it."""
    heading: float
    """Heading off the path's [rad], in [-pi, pi)."""
    curvature: float
    """Of the path a little ahead [1/m]."""


class PathFollower:
    """Keeps track of how far along its path a pose has come; it never goes back to an earlier segment.

    A path that crosses or touches itself is therefore no problem. `preview` [m] is how far ahead the curvature is read:
    legs and spine need about half a gait cycle to answer.
    """

    def __init__(self, path: Path, preview: float = 0.0) -> None:
        self.path = path
        self._preview = preview
        self._number = 0
        self._passed = 0.0

    def step(self, pose: Pose) -> Deviation:
        """Where a pose is now."""
        x, y, yaw = pose
        segments = self.path.segments
        distance, cross_track = segments[self._number].locate(x, y)
        while self._number + 1 < len(segments) and distance >= segments[self._number].length:
            self._passed += segments[self._number].length
            self._number += 1
            distance, cross_track = segments[self._number].locate(x, y)
        segment = segments[self._number]
        return Deviation(
            self._passed + distance,
            cross_track,
            _wrapped(yaw - segment.yaw - segment.curvature * distance),
            self._curvature_ahead(distance + self._preview),
        )

    @property
    def length(self) -> float:
        """Of the path [m]."""
        return self.path.length

    def _curvature_ahead(self, distance: float) -> float:
        for segment in self.path.segments[self._number :]:
            if distance < segment.length:
                return segment.curvature
            distance -= segment.length
        return self.path.segments[-1].curvature


class CycleMean:
    """Mean of a pair of numbers over a moving window: what swings with the gait drops out of one of a gait cycle."""

    def __init__(self) -> None:
        self._window: deque[tuple[int, float, float]] = deque()
        self._first = self._second = 0.0

    def step(self, stamp: int, first: float, second: float, duration: float) -> tuple[float, float]:
        """Takes the values at `stamp` [ns]; returns the means over the last `duration` [s], less at the beginning.

        With a duration of 0 they are the values themselves.
        """
        window, oldest = self._window, stamp - max(1, round(duration * 1e9))
        window.append((stamp, first, second))
        self._first += first
        self._second += second
        while window[0][0] <= oldest:
            _, gone_first, gone_second = window.popleft()
            self._first -= gone_first
            self._second -= gone_second
        return self._first / len(window), self._second / len(window)


def _wrapped(angle: float) -> float:
    return (angle + math.pi) % (2.0 * math.pi) - math.pi
