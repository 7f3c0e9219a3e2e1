"""Spine-based stride extension (N 5.2.2): bending in step with the gait lengthens the stride.

The spine changes the distance d_ext (5.32) between a shoulder and the diagonally opposite hip. N's two rules:
compress the diagonal whose legs swing, extend the one whose legs stand. So over its stance a diagonal goes from
compressed to extended, which carries the body on, and over its swing back again.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from nermo_control.gait.phase import LegPhases
from nermo_control.spine.kinematics import LARGEST_ANGLE, Array, SpineKinematics
from nermo_control.types import Phase
from nermo_description.parameters import Vector3

DIAGONALS = ((0, 3), (1, 2))
"""Front and rear leg of each diagonal pair: front left with rear right, front right with rear left."""
_DIAGONAL_OF_LEG = (0, 1, 1, 0)


class StrideExtension:
    """Which flexion extends and compresses each diagonal, and the flexion that fits the legs' phases.

    `hip_positions` are the hip and shoulder axes in base_link [m], in the order of the legs; `max_flexion` [rad per
    joint] is the amplitude.
    """

    def __init__(self, spine: SpineKinematics, hip_positions: Sequence[Vector3], max_flexion: float) -> None:
        self._spine = spine
        axes = np.asarray(hip_positions, dtype=np.float64)
        self._shoulders = [axes[front] for front, _ in DIAGONALS]
        self._hips = [spine.in_hip_frame(axes[rear]) for _, rear in DIAGONALS]

        def hold(flexion: float) -> float:
            return max(-max_flexion, min(flexion, max_flexion))

        self.extension = tuple(hold(self.optimum(diagonal, longest=True)) for diagonal in (0, 1))
        """theta_ext*: flexion that extends each diagonal most, within the range [rad per joint]."""
        self.compression = tuple(hold(self.optimum(diagonal, longest=False)) for diagonal in (0, 1))
        """theta_comp*: flexion that compresses it most."""

    def distance(self, diagonal: int, flexion: ArrayLike) -> Array:
        """d_ext (5.32) of a diagonal, an index of DIAGONALS, for flexions (...): (...) [m]."""
        hip = self._spine.point(self._hips[diagonal], flexion)
        return np.asarray(np.linalg.norm(hip - self._shoulders[diagonal], axis=-1))

    def optimum(self, diagonal: int, longest: bool) -> float:
        """The argmax of (5.33), or the argmin for compression, over all flexions that the model allows [rad per joint].

        N misprint: (5.33) writes max for argmax, and pairs a shoulder with the hip of its own side. With N's numbers
        the maximum lies at 0.20 rad, twice the range in use; d_ext has no other, so holding it to the range is right.
        """
        sign = -1.0 if longest else 1.0
        low, high = -LARGEST_ANGLE, LARGEST_ANGLE
        for _ in range(4):  # each round narrows the range to two steps of its grid
            grid = np.linspace(low, high, 201)
            best = float(grid[np.argmin(sign * self.distance(diagonal, grid))])
            low, high = max(best - (grid[1] - grid[0]), low), min(best + (grid[1] - grid[0]), high)
        return best

    def flexion(self, legs: LegPhases) -> float:
        """Flexion [rad per joint] for the legs' phases while walking forward; backward, its negative.

        Each leg wants its diagonal compressed at touch-down and extended at lift-off, with a cosine in between, so that
        the spine rests where the feet rest; the mean of the four is taken. In the ideal trot they agree. Where both
        diagonals stand, or the legs of one differ, the mean stays smooth and loses amplitude; in gaits without diagonal
        pairs it vanishes.
        """
        total = 0.0
        for leg, diagonal in enumerate(_DIAGONAL_OF_LEG):
            start, end = self.compression[diagonal], self.extension[diagonal]
            if legs.phases[leg] is Phase.SWING:
                start, end = end, start
            total += start + (end - start) * 0.5 * (1.0 - math.cos(math.pi * legs.fractions[leg]))
        return 0.25 * total


def lumbar_share(legs: LegPhases) -> float:
    """Share in [0, 1] of the vertical flexion that fits the legs' phases while walking forward.

    The counterpart of `StrideExtension.flexion` for rear legs that move together, as rodents use it (N ch. 8): the back
    is arched as the rear feet touch down, far forward under the body, and straightens as they push. The tendon only
    pulls, so the straight half of the wave is left to spring and form stop. Rear legs that alternate ask for nothing.
    """
    total = 0.0
    for leg in (2, 3):
        wave = math.cos(math.pi * legs.fractions[leg])
        total += wave if legs.phases[leg] is Phase.STANCE else -wave
    return max(0.0, 0.5 * total) ** 2
