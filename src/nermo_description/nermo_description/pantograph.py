"""Parameters of robots with pantograph legs and a rigid trunk, as Cheetah-Cub (C 1.1.3, 2.1.2). No mujoco here."""

from __future__ import annotations

import math

from pydantic import model_validator

from nermo_description.parameters import LEGS, NonNegative, Parameters, Positive, RobotDescription, Vector3


class PantographLeg(Parameters):
    """One Advanced Spring Loaded Pantograph leg; all four are alike. Names of C's table A.1 in brackets.

    The points are those of C figure A.1: hip, K (l1 to l2), A (l2 to l3) and F (l3 to the toe); P on l1 and Q on l3 lie
    `spacing` above K and A. The cable pulls A towards the hip, the diagonal strut joins P and A, the parallel strut P
    and Q.
    """

    upper_length: Positive
    """Hip to K (l1) [m]."""
    middle_length: Positive
    """K to A (l2) [m]."""
    lower_length: Positive
    """Q to F (l3) [m]."""
    spacing: Positive
    """P to K and Q to A (l_delta) [m]."""
    toe_length: Positive
    """F to the middle of the sole [m]."""
    cable_max: Positive
    """Hip to A of the stretched leg (l_c,max) [m]: where the diagonal strut ends."""
    parallel_travel: Positive
    """How far the parallel strut opens beyond l2 (l_p,max) [m]."""
    diagonal_stiffness: Positive
    """k_d [N/m]"""
    diagonal_precompression: NonNegative
    """p_d [m]: free length beyond that of the stretched leg."""
    parallel_stiffness: Positive
    """k_p [N/m]"""
    parallel_precompression: NonNegative
    """p_p [m]: free length below l2."""
    toe_stiffness: Positive
    """k_F [N m/rad]"""
    toe_rest: float
    """q_f,0 [rad]: direction of the free toe from l3, positive forward."""
    toe_range: tuple[float, float]
    """Stops of the toe [rad]."""
    diagonal_damping: NonNegative
    """Viscous friction of the diagonal strut [N s/m]."""
    parallel_damping: NonNegative
    """Viscous friction of the parallel strut [N s/m]."""
    toe_damping: NonNegative
    """[N m s/rad]"""
    upper_mass: Positive
    """l1 [kg]"""
    middle_mass: Positive
    """l2 [kg]"""
    lower_mass: Positive
    """l3 [kg]"""
    toe_mass: Positive
    """[kg]"""
    strut_mass: Positive
    """Each half of each strut [kg]."""
    foot_radius: Positive
    """Of the sole [m]."""
    pulley_radius: Positive
    """Of the knee servo's pulley [m]."""
    pulley_distance: Positive
    """Hip axis to the pulley's axis [m]."""

    @property
    def mass(self) -> float:
        """All of the leg [kg]."""
        return self.upper_mass + self.middle_mass + self.lower_mass + self.toe_mass + 4.0 * self.strut_mass

    @property
    def knee_reference(self) -> float:
        """Fold of the stretched leg [rad] (A.10)."""
        return self.knee_of_cable(self.cable_max)

    @property
    def diagonal_max(self) -> float:
        """Length of the diagonal strut in the stretched leg (l_d,max) [m]."""
        return self.diagonal(self.knee_reference)

    def knee_of_cable(self, cable: float) -> float:
        """Fold of the knee [rad] that a cable l_c [m] allows at least (A.5); 0 is stretched."""
        cosine = (cable**2 - self.upper_length**2 - self.middle_length**2) / (
            2.0 * self.upper_length * self.middle_length
        )
        return math.acos(min(max(cosine, -1.0), 1.0))

    def diagonal(self, knee: float) -> float:
        """l_d [m] at a fold of the knee [rad] (A.16)."""
        l2, spacing = self.middle_length, self.spacing
        return math.sqrt(l2**2 + spacing**2 + 2.0 * l2 * spacing * math.cos(knee))

    @model_validator(mode="after")
    def _possible(self) -> PantographLeg:
        if not self.spacing < min(self.upper_length, self.lower_length):
            raise ValueError(f"spacing {self.spacing} must be below upper_length and lower_length")
        least, most = abs(self.upper_length - self.middle_length), self.upper_length + self.middle_length
        if not least < self.cable_max < most:
            raise ValueError(f"cable_max {self.cable_max} must lie between {least:.4g} and {most:.4g}")
        if not self.parallel_travel < self.spacing:
            raise ValueError(f"parallel_travel {self.parallel_travel} must be below spacing {self.spacing}")
        if not self.toe_range[0] <= self.toe_rest <= self.toe_range[1]:
            raise ValueError(f"toe_rest {self.toe_rest} must lie in toe_range {list(self.toe_range)}")
        return self


class PantographParameters(RobotDescription):
    """Everything that is known of one robot with pantograph legs: a servo at each hip, a cable servo for each knee."""

    family = "pantograph"
    leg: PantographLeg
    mass: Positive
    """Of the whole robot [kg]; the trunk has what the legs leave."""
    trunk_size: Vector3
    """Edges of the box that the trunk is [m]."""
    trunk_com: Vector3
    """Its centre of mass in base_link [m]."""

    @property
    def total_mass(self) -> float:
        """[kg]"""
        return self.mass

    @property
    def trunk_mass(self) -> float:
        """[kg]"""
        return self.mass - len(LEGS) * self.leg.mass

    @model_validator(mode="after")
    def _consistent(self) -> PantographParameters:
        needed = [f"{leg}_{joint}" for leg in LEGS for joint in ("hip", "knee")]
        if list(self.servos) != needed:
            raise ValueError(f"servos: must be {', '.join(needed)}")
        self.check_postures()
        if self.trunk_mass <= 0.0:
            raise ValueError(f"mass: the legs leave nothing of {self.mass} kg for the trunk")
        return self
