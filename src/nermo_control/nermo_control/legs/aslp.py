"""The Advanced Spring Loaded Pantograph leg of Cheetah-Cub and Oncilla (C appendix A), its misprints corrected.

Leg plane: origin at the hip axis, x forward, z up (C's y), in m; angles in rad, segments' directions from straight
down, positive forward. Segment l1 hangs from the hip at `hip`; l2 is folded back from it by `knee` (C's q2 with its
reference, 0 is stretched), l3 forward again by knee + opening: with the pantograph closed (opening 0) it is parallel
to l1.

The points are hip, K (l1 to l2), A (l2 to l3) and the foot; P on l1 and Q on l3 lie l_delta above K and A. The cable
spans from the hip to A (l_c), the diagonal spring from P to A (l_d), the parallel spring from P to Q (l_p).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple


class UnreachableError(ValueError):
    """A foot where the leg cannot have it."""


class AslpPose(NamedTuple):
    """Configuration of one leg."""

    hip: float
    """Direction of l1 [rad]."""
    knee: float
    """Fold of l2 against l1 [rad], 0 to pi."""
    opening: float = 0.0
    """Of the pantograph, C's q2 + q3 [rad]; 0 is closed, positive stretches the parallel spring."""


class AslpPoints(NamedTuple):
    """Joints of one leg, (x, z) [m] each."""

    knee: tuple[float, float]
    """K"""
    ankle: tuple[float, float]
    """A"""
    foot: tuple[float, float]
    upper: tuple[float, float]
    """P"""
    lower: tuple[float, float]
    """Q"""


@dataclass(frozen=True, slots=True)
class AslpLeg:
    """Lengths of a leg (C table A.1)."""

    l1: float
    """Hip to K [m]."""
    l2: float
    """K to A [m]."""
    l3: float
    """Q to the foot [m]."""
    l_delta: float
    """K to P and A to Q [m]."""
    cable_max: float
    """l_c of the stretched leg [m]: what the reference angles are made from (C A.2)."""
    parallel_travel: float
    """l_p,max: how far the parallel spring's slider opens [m]."""

    def __post_init__(self) -> None:
        for name in ("l1", "l2", "l3", "l_delta", "cable_max"):
            if not (getattr(self, name) > 0.0 and math.isfinite(getattr(self, name))):
                raise ValueError(f"{name} = {getattr(self, name)} m: must be finite and above 0")
        if not self.l_delta < min(self.l1, self.l3):
            raise ValueError(f"l_delta = {self.l_delta} m: must be less than l1 = {self.l1} m and l3 = {self.l3} m")
        if not abs(self.l1 - self.l2) < self.cable_max <= self.l1 + self.l2:
            raise ValueError(
                f"cable_max = {self.cable_max} m: must be above {abs(self.l1 - self.l2):.4g} m "
                f"and at most {self.l1 + self.l2:.4g} m"
            )
        if not 0.0 <= self.parallel_travel < self.l_delta:
            raise ValueError(f"parallel_travel = {self.parallel_travel} m: must be within 0 and l_delta")

    @property
    def _arm(self) -> float:
        """l1 + l3 - l_delta: first segment of the two-segmented leg that a closed pantograph equals (figure A.2)."""
        return self.l1 + self.l3 - self.l_delta

    # Reference (A.2)

    @property
    def knee_reference(self) -> float:
        """Fold of the stretched leg (A.10) [rad]: the least that the cable allows."""
        return self.knee_of_cable(self.cable_max)

    @property
    def longest(self) -> float:
        """Hip to foot of the stretched leg [m], the root of (A.11) with its missing factor 2."""
        return self._length(self.knee_reference)

    @property
    def shortest(self) -> float:
        """Hip to foot of the leg folded as far as it goes [m]."""
        return abs(self._arm - self.l2)

    @property
    def hip_reference(self) -> float:
        """Direction of l1 with which the stretched leg's foot is below the hip (A.12) [rad]."""
        return self._hip_ahead(self.longest, self.knee_reference)

    # Cable and knee (A.4), (A.5)

    def cable_of_knee(self, knee: float) -> float:
        """l_c [m]: the root of (A.4)."""
        return math.sqrt(self.l1**2 + self.l2**2 + 2.0 * self.l1 * self.l2 * math.cos(knee))

    def knee_of_cable(self, cable: float) -> float:
        """Fold [rad] for a cable l_c [m] (A.5). Raises UnreachableError."""
        cosine = (cable**2 - self.l1**2 - self.l2**2) / (2.0 * self.l1 * self.l2)
        if not abs(cosine) <= 1.0 + 1e-12:
            raise UnreachableError(f"cable = {cable} m: no knee has it")
        return math.acos(min(max(cosine, -1.0), 1.0))

    # Inverse and forward kinematics

    def inverse(self, x: float, z: float) -> AslpPose:
        """Pose with the foot at (x, z) [m] and the pantograph closed ((A.2)-(A.9)).

        Raises UnreachableError where the foot is farther than the stretched leg reaches, or too near.
        """
        length = math.hypot(x, z)
        nearest = self.shortest
        if not length <= self.longest * (1.0 + 1e-12):
            raise UnreachableError(f"foot at ({x}, {z}) m: {length:.4g} m away, the leg reaches {self.longest:.4g} m")
        if not length > max(nearest, 1e-6):
            raise UnreachableError(f"foot at ({x}, {z}) m: {length:.4g} m away, the leg folds to {nearest:.4g} m")
        cosine = (length**2 - self.l2**2 - self._arm**2) / (2.0 * self.l2 * self._arm)
        knee = math.acos(min(max(cosine, -1.0), 1.0))
        return AslpPose(math.atan2(x, -z) + self._hip_ahead(length, knee), knee)

    def forward(self, pose: AslpPose) -> tuple[float, float]:
        """Foot (x, z) [m], for a pantograph that may be open ((A.29), (A.30))."""
        return self.points(pose).foot

    def points(self, pose: AslpPose) -> AslpPoints:
        """Every joint of the leg [m]."""
        first, second = pose.hip, pose.hip - pose.knee
        third = pose.hip + pose.opening
        knee = _along((0.0, 0.0), first, self.l1)
        ankle = _along(knee, second, self.l2)
        return AslpPoints(
            knee,
            ankle,
            _along(ankle, third, self.l3 - self.l_delta),
            _along(knee, first, -self.l_delta),
            _along(ankle, third, -self.l_delta),
        )

    # Springs (A.3), (A.4)

    def diagonal(self, knee: float) -> float:
        """l_d [m] (A.16), from P to A."""
        return math.sqrt(self.l2**2 + self.l_delta**2 + 2.0 * self.l2 * self.l_delta * math.cos(knee))

    def knee_of_diagonal(self, diagonal: float) -> float:
        """Fold [rad] for a diagonal l_d [m] (A.28), 0 or more. Raises UnreachableError."""
        cosine = (diagonal**2 - self.l2**2 - self.l_delta**2) / (2.0 * self.l2 * self.l_delta)
        if not abs(cosine) <= 1.0 + 1e-12:
            raise UnreachableError(f"diagonal = {diagonal} m: no knee has it")
        return math.acos(min(max(cosine, -1.0), 1.0))

    def parallel(self, pose: AslpPose) -> float:
        """l_p [m] (A.21), from P to Q."""
        beta = self.beta(pose.knee, self.l2) + pose.opening
        diagonal = self.diagonal(pose.knee)
        return math.sqrt(max(diagonal**2 + self.l_delta**2 - 2.0 * self.l_delta * diagonal * math.cos(beta), 0.0))

    def beta(self, knee: float, parallel: float) -> float:
        """Angle at A between P and Q [rad] for a slider l_p [m]: (A.15) with l_p in the place of l2.

        Raises UnreachableError.
        """
        diagonal = self.diagonal(knee)
        cosine = (diagonal**2 + self.l_delta**2 - parallel**2) / (2.0 * self.l_delta * diagonal)
        if not abs(cosine) <= 1.0 + 1e-9:
            raise UnreachableError(f"parallel = {parallel} m: no pantograph with a knee of {knee:.4g} rad has it")
        return math.acos(min(max(cosine, -1.0), 1.0))

    def widest(self, knee: float) -> float:
        """Largest opening [rad] that the slider allows with this knee ((A.17)-(A.19)); the least is 0."""
        largest = self.diagonal(knee) + self.l_delta
        return self.beta(knee, min(self.l2 + self.parallel_travel, largest)) - self.beta(knee, self.l2)

    def _length(self, knee: float) -> float:
        return math.sqrt(self.l2**2 + self._arm**2 + 2.0 * self.l2 * self._arm * math.cos(knee))

    def _hip_ahead(self, length: float, knee: float) -> float:
        """How far l1 points ahead of the foot [rad]: the angle at the hip of the two-segmented leg (from (A.3))."""
        return math.atan2(self.l2 * math.sin(knee), self._arm + self.l2 * math.cos(knee))


@dataclass(frozen=True, slots=True)
class AslpSprings:
    """Springs of a leg (C table A.3)."""

    diagonal_stiffness: float
    """k_d [N/m]."""
    diagonal_rest: float
    """l_d,max + p_d: its length without force [m]."""
    parallel_stiffness: float
    """k_p [N/m]."""
    parallel_rest: float
    """l_2 - p_p: its length without force [m]."""

    def energy(self, leg: AslpLeg, pose: AslpPose) -> float:
        """Stored in both [J]."""
        diagonal = leg.diagonal(pose.knee) - self.diagonal_rest
        parallel = leg.parallel(pose) - self.parallel_rest
        return 0.5 * (self.diagonal_stiffness * diagonal**2 + self.parallel_stiffness * parallel**2)

    def torques(self, leg: AslpLeg, pose: AslpPose) -> tuple[float, float]:
        """Generalised torques on `knee` and `opening` [N m]: minus the derivatives of the energy.

        (A.24) and (A.25) with the lengths that the print lacks: the diagonal acts on the knee alone; the parallel
        spring on the opening, and on the knee too, which C leaves out.
        """
        diagonal, parallel = leg.diagonal(pose.knee), leg.parallel(pose)
        by_diagonal = self.diagonal_stiffness * (self.diagonal_rest - diagonal)
        by_parallel = self.parallel_stiffness * (self.parallel_rest - parallel)
        stretch = -leg.l2 * leg.l_delta * math.sin(pose.knee) / diagonal
        beta = leg.beta(pose.knee, leg.l2) + pose.opening
        # l_p^2 = l_d^2 + l_delta^2 - 2 l_delta l_d cos(beta), with beta_min and l_d depending on the knee.
        by_beta = leg.l_delta * diagonal * math.sin(beta) / parallel
        by_length = (diagonal - leg.l_delta * math.cos(beta)) / parallel
        beta_slope = _beta_slope(leg, pose.knee)
        return (
            by_diagonal * stretch + by_parallel * (by_length * stretch + by_beta * beta_slope),
            by_parallel * by_beta,
        )


def _beta_slope(leg: AslpLeg, knee: float) -> float:
    """Derivative of beta_min by the knee [1]; beta_min is the angle at A in the triangle P, A, Q of a closed leg."""
    diagonal = leg.diagonal(knee)
    stretch = -leg.l2 * leg.l_delta * math.sin(knee) / diagonal
    beta = leg.beta(knee, leg.l2)
    cosine_slope = (diagonal**2 - leg.l_delta**2 + leg.l2**2) / (2.0 * leg.l_delta * diagonal**2) * stretch
    return -cosine_slope / math.sin(beta)


def _along(point: tuple[float, float], direction: float, length: float) -> tuple[float, float]:
    return point[0] + length * math.sin(direction), point[1] - length * math.cos(direction)
