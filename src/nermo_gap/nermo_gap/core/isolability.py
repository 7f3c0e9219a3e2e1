"""What this recording can tell apart: angles between what effects change, once nuisances have taken their part."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nermo_gap.core.screen import Screened

Array = NDArray[np.float64]

SEPARATE = 20.0
"""[deg] Effects whose responses lie closer than this are hard to tell apart in this recording."""
_SHOWN = 16


def isolability(screened: Sequence[Screened], winner: Sequence[str]) -> dict[str, Any]:
    """Angles [deg] between the responses of the strongest candidates and of the winner, and its near neighbours.

    An angle is taken between lines (0 to 90): an effect and its opposite are one direction.
    """
    first = [s for s in screened if s.effect.key in winner]
    rest = [s for s in screened if s.effect.key not in winner]
    shown: list[Screened] = []
    for s in [*first, *rest]:
        if s.effect.key not in {t.effect.key for t in shown} and len(shown) < _SHOWN:
            shown.append(s)
    matrix = angle_matrix([s.response for s in shown])
    names = [s.effect.key for s in shown]
    near = {
        name: [names[j] for j in np.argsort(matrix[i]) if j != i and matrix[i, j] < SEPARATE]
        for i, name in enumerate(names)
        if name in winner
    }
    return {"effects": names, "angle_deg": np.round(matrix, 1).tolist(), "near": near, "near_below_deg": SEPARATE}


def angle_matrix(responses: Sequence[Array]) -> Array:
    """Angles [deg] between lines, (n, n); 90 for a response that is nil."""
    stacked = np.array(responses)
    norms = np.linalg.norm(stacked, axis=1)
    unit = np.divide(stacked, norms[:, None], out=np.zeros_like(stacked), where=norms[:, None] > 0)
    cosine = np.abs(unit @ unit.T)
    angles: Array = np.degrees(np.arccos(np.clip(cosine, 0.0, 1.0)))
    np.fill_diagonal(angles, 0.0)
    return angles
