"""Geometry of Nermo-Lite as printed in N tables 5.3, A.4, A.5 and A.7: the formulas are tested against N itself."""

from __future__ import annotations

import math

from nermo_description.parameters import LegParameters, SpineParameters

FRONT_LEG = LegParameters(
    upper_length=0.0295,
    tendon_attachment=0.0145,
    lower_length=0.0225,
    foot_length=0.0145,
    pulley_radius=0.008,
    pulley_distance=0.0128,
    tendon_length=0.033,
    ankle_angle=math.radians(23.0),
)
REAR_LEG = LegParameters(
    upper_length=0.0317,
    tendon_attachment=0.020,
    lower_length=0.0305,
    foot_length=0.0205,
    pulley_radius=0.008,
    pulley_distance=0.0128,
    tendon_length=0.032,
    ankle_angle=math.radians(73.0),
)
LEG_PARAMETERS = {"front": FRONT_LEG, "rear": REAR_LEG}
NEUTRAL_FEET = {"front": (0.005, -0.045), "rear": (0.0, -0.05)}
"""Neutral feet (x, z) [m] from the hip axes, N table A.7 (printed with y = -x)."""

SPINE = SpineParameters(
    alpha=tuple(math.radians(a) for a in (0.0, 90.0, -90.0, 90.0, -90.0, 90.0, -90.0, 90.0, -90.0, 90.0, -90.0)),
    a=(0.0, 0.0016, 0.007, 0.007, 0.007, 0.007, 0.007, 0.007, 0.0092, 0.0014, 0.0),
    theta=tuple(math.radians(t) for t in (90.0, -10.7, 0.0, -7.0, 0.0, -6.9, 0.0, 9.7, 0.0, 15.0, -90.0)),
    d=(0.0,) * 11,
    pulley_radius=0.006,
    vertebra_length=0.014,
    tendon_offset=0.007,
    max_flexion=0.1,
)
"""Table 5.3; pulley radius and tendon offset, which N does not give, are of the vertebrae's size."""
HIP_POSITIONS = (
    (0.0615, 0.0368, 0.0024),
    (0.0615, -0.0368, 0.0024),
    (-0.0604, 0.0428, 0.0095),
    (-0.0604, -0.0428, 0.0095),
)
"""Table A.5, in base_link [m]."""
NEUTRAL_FOOT_X = (0.005, 0.0)
STRIDE = 0.06
FRONT_MASS, REAR_MASS = 0.225, 0.060
"""N 5.2.2 [kg]."""
FRONT_COM = (0.0272, 0.0, 0.027)
"""In base_link. Table A.5 prints x = 0.0417, which contradicts the balance tests of table 6.5, and z = -0.027, which
contradicts the COM height of 57 mm."""
REAR_COM = (-0.0310, 0.0, -0.0160)
"""In the hip frame, table A.5."""
