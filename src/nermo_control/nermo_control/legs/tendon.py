"""Knee tendons: the pulley angle q2 against the knee angle theta1, for N's tendon types (N 5.1.2-5.1.4, table 5.1).

Frame: the leg plane is written as complex numbers w = -z + i y (down is real), with y pointing so that the knee of a
leg with positive `sweep` lies at positive y and the tendon runs on the other side. For the front leg that is N's own
y and `sweep` is q1; the rear leg is its mirror image, `sweep` is -q1 (N figure 5.6). Knee A = l1 e^(i sweep), tendon
attachment B = A + l2 e^(i (sweep - theta1)), pulley axis E = -d1.

Every routing follows one rule: over a pulley the tendon's length changes by r_p q2 and by nothing else, so with u the
unit vector along the free tendon towards B, r_p dq2 = u . dB. A routing keeps to the knee angles where pulling
bends the knee: between the two dead centres, at which the tendon's line passes through the knee.
"""

from __future__ import annotations

import cmath
import math
from abc import ABC, abstractmethod
from typing import Literal, Protocol

from nermo_description.parameters import LegParameters

Pair = Literal["front", "rear"]
MARGIN = 1e-6
"""[rad] kept from the dead centres, where the tendon's line passes through the knee and the moment arm is zero."""


class TendonRouting(Protocol):
    """What a leg needs to know of its tendon. Angles in rad; `sweep` is explained above."""

    def knee_range(self, sweep: float) -> tuple[float, float]:
        """Knee angles that the tendon can drive at this sweep, lowest and highest."""

    def knee_angle(self, q2: float, sweep: float) -> float:
        """theta1 for a pulley angle, held inside `knee_range`."""

    def pulley_angle(self, knee: float, sweep: float) -> float:
        """q2 for a knee angle inside `knee_range`."""

    def gradient(self, knee: float, sweep: float) -> tuple[float, float]:
        """(d theta1 / d sweep, d theta1 / d q2) at a knee angle inside `knee_range`; finite everywhere in it."""


class UpperLegRouting:
    """Type 3 (N (5.16)-(5.19)): the tendon runs through the hip axis O, so that theta1 depends on q2 alone.

    The adjusted type 3 (N 5.1.4, figure 5.7a) runs on to a second point I on the upper leg, `routing_distance` from
    O. The way from O to I is rigid, so the same triangle holds with IA in place of OA. As in (5.2), l_t0 is the
    length from the last routing point (O or I) to B at q2 = 0.

    N misprint: the triangle of (5.16) is OAB, not ABC.
    """

    def __init__(self, leg: LegParameters) -> None:
        upper = leg.upper_length - (leg.routing_distance or 0.0)
        self._squares = upper**2 + leg.tendon_attachment**2
        self._product = 2.0 * upper * leg.tendon_attachment
        self._length = leg.tendon_length
        self._radius = leg.pulley_radius
        self._range = (MARGIN, math.pi - MARGIN)
        self.pulley_range = (
            (abs(upper - leg.tendon_attachment) - self._length) / self._radius,
            (upper + leg.tendon_attachment - self._length) / self._radius,
        )
        """q2 [rad] at which the triangle is folded and stretched: N's valid range, without servo limits."""

    def knee_range(self, sweep: float) -> tuple[float, float]:
        return self._range

    def knee_angle(self, q2: float, sweep: float) -> float:
        length = self._length + self._radius * max(self.pulley_range[0], min(q2, self.pulley_range[1]))
        cosine = (length * length - self._squares) / self._product
        low, high = self._range
        return max(low, min(math.acos(max(-1.0, min(cosine, 1.0))), high))

    def pulley_angle(self, knee: float, sweep: float) -> float:
        return (math.sqrt(self._squares + self._product * math.cos(knee)) - self._length) / self._radius

    def gradient(self, knee: float, sweep: float) -> tuple[float, float]:
        length = math.sqrt(self._squares + self._product * math.cos(knee))
        return 0.0, -2.0 * self._radius * length / (self._product * math.sin(knee))


class _BodyRouting(ABC):
    """What types 1 and 2 share: the tendon comes from the body, so the knee angle depends on the sweep, too."""

    def __init__(self, leg: LegParameters) -> None:
        self._upper = leg.upper_length
        self._attachment = leg.tendon_attachment
        self._length = leg.tendon_length
        self._radius = leg.pulley_radius

    @abstractmethod
    def _direction(self, point: complex) -> complex:
        """Unit vector u of a tendon stretched from the body to `point`."""

    def _points(self, knee: float, sweep: float) -> tuple[complex, complex]:
        """Knee A and tendon attachment B."""
        knee_point = self._upper * cmath.exp(1j * sweep)
        return knee_point, knee_point + self._attachment * cmath.exp(1j * (sweep - knee))

    def _dead_centre(self, sweep: float) -> float:
        """Knee angle at which tendon and lower leg are stretched in one line; the folded one is half a turn on."""
        direction = self._direction(self._upper * cmath.exp(1j * sweep))
        return math.remainder(sweep - cmath.phase(direction), 2.0 * math.pi)

    def knee_range(self, sweep: float) -> tuple[float, float]:
        stretched = self._dead_centre(sweep)
        low = min(max(0.0, stretched) + MARGIN, math.pi)
        return low, max(low, min(math.pi, stretched + math.pi) - MARGIN)

    def gradient(self, knee: float, sweep: float) -> tuple[float, float]:
        knee_point, point = self._points(knee, sweep)
        direction = self._direction(point)
        per_knee = _dot(direction, -1j * (point - knee_point))
        # Only where a leg is folded onto its own pulley can the moment arm vanish inside the range; stay finite there.
        per_knee = min(per_knee, -MARGIN * self._attachment)
        per_sweep = _dot(direction, 1j * point)
        return -per_sweep / per_knee, self._radius / per_knee


class FixedPointRouting(_BodyRouting):
    """Type 2: the tendon runs through a routing point C fixed to the body.

    theta2 = 0 (table 5.1) puts C on the pulley's tangent, r_p beside the hip axis; N does not say how high. Here it
    is level with the hip axis, the point of that tangent from which type 3 is reached by moving C onto the axis.
    """

    def __init__(self, leg: LegParameters) -> None:
        super().__init__(leg)
        self._routing_point = complex(0.0, -leg.pulley_radius)

    def _direction(self, point: complex) -> complex:
        span = point - self._routing_point
        return span / abs(span)

    def pulley_angle(self, knee: float, sweep: float) -> float:
        _, point = self._points(knee, sweep)
        return (abs(point - self._routing_point) - self._length) / self._radius

    def knee_angle(self, q2: float, sweep: float) -> float:
        distance = abs(self._upper * cmath.exp(1j * sweep) - self._routing_point)
        length = max(0.0, self._length + self._radius * q2)
        cosine = (length * length - distance**2 - self._attachment**2) / (2.0 * distance * self._attachment)
        low, high = self.knee_range(sweep)
        return max(low, min(self._dead_centre(sweep) + math.acos(max(-1.0, min(cosine, 1.0))), high))


class PulleyRouting(_BodyRouting):
    """Type 1: the tendon runs straight from the pulley to B and wraps on the pulley as the leg moves (N (5.3)-(5.11)).

    The inverse is explicit: B gives the tangent to the pulley, that gives theta2 and l_t, and (5.2) gives q2.
    Forward, N solves (5.9) for theta2; here the same equation is solved for theta1 by Brent's method, because q2
    falls monotonically with theta1 between the two dead centres: there is exactly one root, and it is bracketed. It
    is the larger of the two roots theta2 of (5.9); the smaller one belongs to the knee bent backwards through the
    tendon's line.
    """

    def __init__(self, leg: LegParameters) -> None:
        super().__init__(leg)
        self._pulley = complex(-leg.pulley_distance, 0.0)

    def _tangent(self, span: complex) -> float:
        """asin(r_p / r_s), the angle from a vector E to P to the tendon that ends in P; at most a right angle."""
        return math.asin(self._radius / max(abs(span), self._radius))

    def _direction(self, point: complex) -> complex:
        span = point - self._pulley
        return cmath.exp(1j * (cmath.phase(span) + self._tangent(span)))

    def wrapping_angle(self, knee: float, sweep: float) -> float:
        """theta2 [rad] of (5.4): minus the tendon's angle from straight down, counted past the knee without a jump."""
        knee_point, point = self._points(knee, sweep)
        knee_span, span = knee_point - self._pulley, point - self._pulley
        return -(cmath.phase(knee_span) + cmath.phase(span / knee_span) + self._tangent(span))

    def pulley_angle(self, knee: float, sweep: float) -> float:
        _, point = self._points(knee, sweep)
        spiral = max(abs(point - self._pulley), self._radius)
        length = math.sqrt(spiral * spiral - self._radius * self._radius)
        return (length - self._length) / self._radius - self.wrapping_angle(knee, sweep)

    def knee_range(self, sweep: float) -> tuple[float, float]:
        low, high = super().knee_range(sweep)
        span = self._upper * cmath.exp(1j * sweep) - self._pulley
        distance = abs(span)
        # With the leg swung far up, B would run into the pulley before the tendon's line reaches the knee.
        if distance - self._attachment < self._radius:
            cosine = (self._radius**2 - distance**2 - self._attachment**2) / (2.0 * distance * self._attachment)
            touching = math.remainder(sweep - cmath.phase(span), 2.0 * math.pi) + math.acos(max(-1.0, min(cosine, 1.0)))
            high = max(low, min(high, touching - MARGIN))
        return low, high

    def knee_angle(self, q2: float, sweep: float) -> float:
        low, high = self.knee_range(sweep)
        if q2 >= self.pulley_angle(low, sweep):
            return low
        if q2 <= self.pulley_angle(high, sweep):
            return high
        from scipy.optimize import brentq  # only here: it would double the time in which a node starts

        return float(brentq(lambda knee: self.pulley_angle(knee, sweep) - q2, low, high, xtol=1e-14, rtol=1e-14))


def routing(leg: LegParameters) -> TendonRouting:
    """The routing of a leg's `tendon_type`.

    Raises ValueError if an adjusted type 3 has no `routing_distance`, or one that is not on the upper leg.
    """
    if leg.tendon_type == "type_1":
        return PulleyRouting(leg)
    if leg.tendon_type == "type_2":
        return FixedPointRouting(leg)
    if leg.tendon_type == "type_3_adjusted":
        if leg.routing_distance is None or not leg.routing_distance < leg.upper_length:
            raise ValueError(
                f"routing_distance is {leg.routing_distance}; tendon type_3_adjusted needs one between 0 and "
                f"upper_length = {leg.upper_length} m"
            )
        return UpperLegRouting(leg)
    return UpperLegRouting(leg.model_copy(update={"routing_distance": None}))


def _dot(first: complex, second: complex) -> float:
    return first.real * second.real + first.imag * second.imag
