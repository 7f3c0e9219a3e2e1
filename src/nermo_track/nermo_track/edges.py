"""Corners of a tag as where its edges meet.

OpenCV's own refinements take what lies around a corner, which blur rounds off, to one side always: 0.4 to 0.9 pixels
for its `SUBPIX`, 0.9 for `CONTOUR`; `APRILTAG` is off by half a pixel both ways, and now and then by more. Blur moves
no straight edge. So each edge is found along its length, and corners are where edges meet, as AprilTag 2's own detector
does it (Wang and Olson, IROS 2016, `refine_edges`). `nermo bench track` measures what is left.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from nermo_track.film import Picture
from nermo_track.layout import MODULES

Array = NDArray[np.float64]

ALONG = np.linspace(0.08, 0.92, 32)
"""Where along an edge it is looked at: not where the other one rounds it off."""
STEP = 0.25
"""[px] Between samples across an edge."""
REACH = 0.6
"""Of a module: how far across an edge it is looked at; the next ones are a module away."""
LEAST_REACH = 1.5
"""[px] A lens's blur is as wide."""
ROUNDS = 3


def refined(picture: Picture, corners: Array) -> Array:
    """(4, 2) [px] Corners of a tag, upper left first and clockwise as ``corners`` (4, 2), which may be a pixel off.

    They stay as they are where an edge is not to be seen: at the picture's border, or covered.
    """
    found = corners
    for _ in range(ROUNDS):
        better = _once(picture, found)
        if better is None or np.abs(better - corners).max() > max(2.0, 2.0 * _module(corners)):
            return corners
        found = better
    return found


def _module(corners: Array) -> float:
    """[px] Edge of one square of the tag, by its shortest side."""
    return float(np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1).min()) / MODULES


def _once(picture: Picture, corners: Array) -> Array | None:
    """Corners from edges looked for about ``corners``; None where one is not to be seen."""
    reach = max(REACH * _module(corners), LEAST_REACH)
    across = np.arange(-reach, reach + STEP / 2, STEP)
    ends = np.roll(corners, -1, axis=0)
    along = (ends - corners) / np.linalg.norm(ends - corners, axis=1, keepdims=True)
    # Corners run clockwise in the picture, whose y points down: this points out of the tag, from black to white.
    out = np.column_stack([along[:, 1], -along[:, 0]])
    base = corners[:, None] + ALONG[None, :, None] * (ends - corners)[:, None]
    spots = base[:, :, None] + across[None, None, :, None] * out[:, None, None]
    height, width = picture.shape
    if spots.min() < 0.0 or spots[..., 0].max() > width - 1 or spots[..., 1].max() > height - 1:
        return None
    across_map, down_map = (spots[..., axis].reshape(-1, len(across)).astype(np.float32) for axis in range(2))
    read = cv2.remap(picture.astype(np.float32), across_map, down_map, cv2.INTER_LINEAR)
    grey = np.asarray(read, dtype=np.float64).reshape(spots.shape[:3])
    rise = np.maximum(np.diff(grey, axis=2), 0.0)
    weight = rise.sum(axis=2)
    if (np.median(weight, axis=1) < 10.0).any():
        return None
    middle = 0.5 * (across[:-1] + across[1:])
    shift = (rise * middle).sum(axis=2) / np.maximum(weight, 1e-9)
    lines = []
    for edge in range(4):
        points = (base[edge] + shift[edge][:, None] * out[edge]).astype(np.float32)
        dx, dy, x, y = cv2.fitLine(points[weight[edge] > 5.0], cv2.DIST_HUBER, 0, 0.01, 0.001).ravel()
        lines.append((dy, -dx, dy * x - dx * y))
    return np.array([_meeting(lines[k - 1], lines[k]) for k in range(4)])


def _meeting(one: tuple[float, float, float], other: tuple[float, float, float]) -> Array:
    """(2,) Where two lines a x + b y = c meet."""
    rows = np.array([one[:2], other[:2]], dtype=np.float64)
    if abs(np.linalg.det(rows)) < 1e-6:
        return np.full(2, np.inf)
    return np.asarray(np.linalg.solve(rows, np.array([one[2], other[2]], dtype=np.float64)), dtype=np.float64)
