"""The bio-inspired foot locus: quadratic Bezier curves through the four key points of a step (C 3.2.1, table 3.2).

Leg planes: origin at the hip or shoulder axis, x forward, z up (C's y), in m.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from nermo_control.types import Four


class Point(NamedTuple):
    """In the leg plane [m]."""

    x: float
    z: float


def locus_curves(
    start: Point, middle: Point, end: Point, start_angle: float, end_angle: float, duration: float
) -> tuple[Four, Four, Four, Four]:
    """One phase of the locus, from take-off over mid-swing to touch-down or from there over mid-stance to take-off.

    The angles [rad] are the incidences at both ends, theta_to and theta_td of table 3.1: pi / 2 is vertical. Each half
    is a quadratic Bezier curve whose control point lies where the tangent at the end meets the height of the middle;
    with the points of table 3.2 these are its c_to-sw, c_td-sw, c_td-st and c_to-st.

    Returns the cubics of x and of z in both halves, as `FootTrajectory` has them; the curve's own parameter, and with
    it time, is linear in each half of `duration` [s].
    """
    half = 0.5 * duration
    before = Point(start.x + (middle.z - start.z) * math.tan(start_angle - 0.5 * math.pi), middle.z)
    after = Point(end.x + (middle.z - end.z) * math.tan(end_angle - 0.5 * math.pi), middle.z)
    return (
        quadratic_bezier(start.x, before.x, middle.x, half),
        quadratic_bezier(middle.x, after.x, end.x, half),
        quadratic_bezier(start.z, before.z, middle.z, half),
        quadratic_bezier(middle.z, after.z, end.z, half),
    )


def quadratic_bezier(start: float, control: float, end: float, duration: float) -> Four:
    """Coefficients a = 0, b, c, d of b t^2 + c t + d: the curve run through in `duration` [s]."""
    return 0.0, (start - 2.0 * control + end) / (duration * duration), 2.0 * (control - start) / duration, start
