"""Forward and inverse kinematics of one leg (N 5.1.2-5.1.5).

At the boundary a foot stands at (x, z) in the leg plane, origin at the hip or shoulder axis, x forward, z up [m]. N's
own leg plane has y backward; x = -y. Inside, the plane is complex, w = -z + i y: a segment at angle phi from straight
down, positive towards the back, is a factor e^(i phi). With sigma = -1 (front) and +1 (rear), (5.1) and (5.20) both
read

    H = l1 e^(i q1) + (l3 + l4 e^(-i theta3)) e^(i (q1 + sigma theta1)),

two links: l1, and the lower leg with its stiff ankle. So the inverse has a closed form; N's velocity-integrated
inverse is `inverse_by_integration`. N misprint: l3 is the whole lower leg, knee A to ankle G.
"""

from __future__ import annotations

import cmath
import math

from nermo_control.legs.tendon import Pair, UpperLegRouting, routing
from nermo_description.parameters import LegParameters

TOLERANCE = 1e-9
"""Rounding allowed before a target counts as outside the workspace: relative in distance, rad in knee angle."""

Jacobian = tuple[tuple[float, float], tuple[float, float]]


class LegKinematics:
    """One leg of the front or rear pair; left and right are alike. Immutable, plain floats.

    Workspace: the hip turns freely; the knee keeps to the angles that its tendon can drive and in which the foot comes
    closer to the hip as the knee bends, so that every foot position has one solution. Servo limits are not known here.

    Symbols: q1 hip servo, q2 knee pulley [rad], signs as in N (q2 < 0 pulls and flexes), theta1 knee angle [rad] (0:
    straight).

    Raises ValueError for parameters that close no leg.
    """

    def __init__(self, leg: LegParameters, pair: Pair) -> None:
        if pair not in ("front", "rear"):
            raise ValueError(f"pair is {pair!r}; it must be 'front' or 'rear'")
        self.tendon = routing(leg)
        self._sigma = -1.0 if pair == "front" else 1.0
        lower = leg.lower_length + leg.foot_length * cmath.exp(-1j * leg.ankle_angle)
        self._upper = leg.upper_length
        self._lower = abs(lower)
        self._lower_angle = cmath.phase(lower)
        self._squares = self._upper**2 + self._lower**2
        self._product = 2.0 * self._upper * self._lower
        # Where the foot comes closer as the knee bends: 0 <= sigma theta1 + phase(lower) <= pi, up to the sign sigma.
        self._bend_offset = -self._sigma * self._lower_angle
        self._lowest = max(0.0, self._bend_offset)
        self._highest = min(math.pi, math.pi + self._bend_offset)
        # Type 3 drives the knee alike at every q1: computed once.
        self._constant_range = self.knee_range() if isinstance(self.tendon, UpperLegRouting) else None

    def knee_range(self, q1: float = 0.0) -> tuple[float, float]:
        """Lowest and highest knee angle theta1 [rad] of the workspace; only for types 1 and 2 does q1 matter."""
        low, high = self.tendon.knee_range(-self._sigma * _finite(q1))
        low = min(max(low, self._lowest), self._highest)
        return low, max(low, min(high, self._highest))

    def knee_angle(self, q2: float, q1: float = 0.0) -> float:
        """theta1 [rad] for a pulley angle, held where the tendon's triangle closes: N's whole valid range of q2."""
        return self.tendon.knee_angle(0.0 if math.isnan(q2) else q2, -self._sigma * _finite(q1))

    def pulley_angle(self, knee_angle: float, q1: float = 0.0) -> float:
        """q2 [rad] for a knee angle theta1, which is held inside `knee_range`."""
        low, high = self.knee_range(q1)
        return self.tendon.pulley_angle(max(low, min(_finite(knee_angle), high)), -self._sigma * _finite(q1))

    def forward(self, q1: float, q2: float) -> tuple[float, float]:
        """Foot position (x, z) [m]. A q2 outside the tendon's range is held at its end; NaN counts as 0."""
        q1 = _finite(q1)
        angle = q1 + self._sigma * self.knee_angle(q2, q1) + self._lower_angle
        return (
            -self._upper * math.sin(q1) - self._lower * math.sin(angle),
            -self._upper * math.cos(q1) - self._lower * math.cos(angle),
        )

    def inverse(self, x: float, z: float) -> tuple[float, float, bool]:
        """Servo angles (q1, q2) [rad] that put the foot at (x, z) [m], and whether the target had to be clamped.

        q1 is in (-pi, pi]. A target that is too near or too far is moved along its direction to the border of the
        workspace, the nearest point of it (types 1 and 2: where the tendon sets the border, the knee angle is held
        and the direction may change). A target with NaN counts as straight below the hip at q2 = 0. Never raises,
        never NaN.
        """
        if math.isnan(x) or math.isnan(z):
            q1, q2, _ = self.inverse(0.0, -math.hypot(*self.forward(0.0, 0.0)))
            return q1, q2, True
        distance = math.hypot(x, z)
        cosine = (distance * distance - self._squares) / self._product
        clamped = not -1.0 - TOLERANCE <= cosine <= 1.0 + TOLERANCE
        knee = math.acos(max(-1.0, min(cosine, 1.0))) + self._bend_offset
        q1 = self._hip_angle(x, z, knee)
        low, high = self._constant_range or self.knee_range(q1)
        if not low <= knee <= high:
            clamped = clamped or not low - TOLERANCE <= knee <= high + TOLERANCE
            knee = max(low, min(knee, high))
            if self._constant_range:
                q1 = self._hip_angle(x, z, knee)
        return q1, self.tendon.pulley_angle(knee, -self._sigma * q1), clamped

    def jacobian(self, q1: float, q2: float) -> Jacobian:
        """((dx/dq1, dx/dq2), (dz/dq1, dz/dq2)) of `forward` [m/rad] at the knee angle nearest inside `knee_range`.

        N (5.12)-(5.15) and (5.19). Misprint: (5.12) lacks the dots on p_H and q1.
        """
        q1 = _finite(q1)
        low, high = self.knee_range(q1)
        knee = max(low, min(self.knee_angle(q2, q1), high))
        angle = q1 + self._sigma * knee + self._lower_angle
        per_sweep, per_q2 = self.tendon.gradient(knee, -self._sigma * q1)
        x_per_knee = -self._sigma * self._lower * math.cos(angle)
        z_per_knee = self._sigma * self._lower * math.sin(angle)
        x = -self._upper * math.sin(q1) - self._lower * math.sin(angle)
        z = -self._upper * math.cos(q1) - self._lower * math.cos(angle)
        knee_per_q1 = -self._sigma * per_sweep
        return (
            (z + x_per_knee * knee_per_q1, x_per_knee * per_q2),
            (-x + z_per_knee * knee_per_q1, z_per_knee * per_q2),
        )

    def _hip_angle(self, x: float, z: float, knee: float) -> float:
        """q1 [rad] that turns a leg with this knee angle towards (x, z); straight down for the hip axis itself."""
        bend = self._sigma * knee + self._lower_angle
        direction = math.atan2(-x, -z) if x or z else 0.0
        reach = math.atan2(self._lower * math.sin(bend), self._upper + self._lower * math.cos(bend))
        return math.remainder(direction - reach, 2.0 * math.pi)


def leg_kinematics(leg: LegParameters, pair: Pair) -> LegKinematics:
    """The kinematics of a leg with its tendon type."""
    return LegKinematics(leg, pair)


def inverse_by_integration(
    leg: LegKinematics, q1: float, q2: float, x: float, z: float, steps: int = 200
) -> tuple[float, float]:
    """Servo angles for the foot at (x, z) [m], the way N finds them: dq = J^-1 dp, integrated along the straight line.

    Starts from the foot position of (q1, q2) and takes `steps` Runge-Kutta steps of fourth order. Slower than
    `LegKinematics.inverse` and without clamping: an independent check of it. Raises ZeroDivisionError on a singular
    leg.
    """
    start_x, start_z = leg.forward(q1, q2)
    dx, dz = (x - start_x) / steps, (z - start_z) / steps

    def rate(first: float, second: float) -> tuple[float, float]:
        (a, b), (c, d) = leg.jacobian(first, second)
        determinant = a * d - b * c
        return (d * dx - b * dz) / determinant, (a * dz - c * dx) / determinant

    for _ in range(steps):
        k1 = rate(q1, q2)
        k2 = rate(q1 + 0.5 * k1[0], q2 + 0.5 * k1[1])
        k3 = rate(q1 + 0.5 * k2[0], q2 + 0.5 * k2[1])
        k4 = rate(q1 + k3[0], q2 + k3[1])
        q1 += (k1[0] + 2.0 * k2[0] + 2.0 * k3[0] + k4[0]) / 6.0
        q2 += (k1[1] + 2.0 * k2[1] + 2.0 * k3[1] + k4[1]) / 6.0
    return q1, q2


def _finite(angle: float) -> float:
    return angle if math.isfinite(angle) else 0.0
