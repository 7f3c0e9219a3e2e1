"""How far each part of a robot is from its twin, as colours of its bodies."""

from __future__ import annotations

import math
from collections.abc import Mapping

from nermo_description.parameters import LEGS
from nermo_web.scene import Colour

SAME, FAR = 1.0, 3.0
"""[sensor resolutions] Gaps of the two ends of the colours; beyond the second the monitor warns."""
AGREES, DIFFERS, UNKNOWN = (40, 150, 70), (200, 30, 30), (120, 130, 150)
"""Colours."""


def gaps_of(values: Mapping[str, str]) -> dict[str, float]:
    """{part: gap} of the monitor's values; those that are no numbers are left out."""
    found = {}
    for key, text in values.items():
        try:
            gap = float(text)
        except ValueError:
            continue
        if key.endswith("_gap") and math.isfinite(gap):
            found[key.removesuffix("_gap")] = gap
    return found


def colour_of(body: str, gaps: Mapping[str, float]) -> Colour:
    """The colour of a body: that of its leg, of the spine, or else of the body as a whole."""
    leg = next((f"{leg}_leg" for leg in LEGS if body.startswith(leg)), None)
    gap = gaps.get(leg or ("spine" if body.startswith("spine") else "body"))
    if gap is None:
        return UNKNOWN
    share = min(max((gap - SAME) / (FAR - SAME), 0.0), 1.0)
    red, green, blue = (round(a + share * (b - a)) for a, b in zip(AGREES, DIFFERS, strict=True))
    return red, green, blue
