"""Draws any MJCF as vector graphics, its parts coloured by their share of the gap. Needs no OpenGL."""

from __future__ import annotations

from collections.abc import Collection, Mapping

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from simgap.report import style
from simgap.report.style import AFTER, EDGE, QUIET, UNSEEN
from simgap.report.svg import Drawing, text_width

Array = NDArray[np.float64]
Geom = mujoco.mjtGeom

_RING = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
_THICK = 0.03
"""Radius of a bar of a skeleton, of the robot's largest extent."""
_WIDTH, _TALLEST, _TEXT = 500.0, 400.0, 13.0
"""[px] of the drawing, the robot in it, and the names."""


def draw_robot(
    model: mujoco.MjModel,
    qpos: Array,
    heat: Mapping[int, float],
    labels: Mapping[int, str],
    causes: Collection[int] = (),
) -> Drawing:
    """The robot in posture ``qpos`` with bodies coloured by ``heat`` {body: 0 to 1}; others are grey.

    Bodies in ``causes`` have a blue outline.
    """
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    right, up, toward = _view(model, data)
    shapes = []
    for g in range(model.ngeom):
        outline = _outline(model, data, g, right, up)
        if outline is not None:
            shapes.append((float(data.geom_xpos[g] @ toward), int(model.geom_bodyid[g]), outline))
    shapes = shapes or _skeleton(model, data, right, up, toward)
    drawn = {b: np.concatenate([s for _, body, s in shapes if body == b] or [_at(data, b, right, up)]) for b in labels}
    places = {b: 0.5 * (points.min(axis=0) + points.max(axis=0)) for b, points in drawn.items()}
    low, high = _bounds([s[2] for s in shapes])
    sides = _sides(places, low, high)
    margin = {
        s: max((text_width(labels[b], _TEXT) + 30.0 for b in sides if sides[b] == s), default=8.0) for s in (-1, 1)
    }
    across, tall = np.maximum(high - low, 1e-9)
    scale = min(max(_WIDTH - margin[-1] - margin[1], 120.0) / across, _TALLEST / tall)
    left = margin[-1] + 0.5 * max(_WIDTH - margin[-1] - margin[1] - scale * across, 0.0)
    origin, flip = np.array([left - scale * low[0], scale * high[1]]), np.array([scale, -scale])
    names = _heights({b: float((origin + flip * p)[1]) for b, p in places.items()}, labels, sides)
    reach = [0.0, scale * tall, *(y + side * 0.6 * _lines(labels[b]) for b, y in names.items() for side in (-1, 1))]
    top, bottom = min(reach) - 6.0, max(reach) + 6.0
    origin[1] -= top
    drawing = Drawing("robot", left + scale * across + margin[1], bottom - top)
    for _, body, outline in sorted(shapes, key=lambda s: s[0]):
        fill = style.heat(heat[body]) if body in heat else UNSEEN
        edge, width = (AFTER, 3.0) if body in causes else (EDGE, 1.0)
        drawing.polygon(origin + flip * outline, fill, edge, width)
    for body, y in names.items():
        side = sides[body]
        x = left - 20.0 if side < 0 else left + scale * across + 20.0
        drawing.line([tuple(origin + flip * places[body]), (x - 4.0 * side, y - top)], QUIET)
        drawing.text(x, y - top, labels[body], anchor="end" if side < 0 else "start", size=_TEXT)
    return drawing


def _sides(places: Mapping[int, Array], low: Array, high: Array) -> dict[int, int]:
    """At which side of the robot the name of each part stands: -1 left, 1 right; in turn for those in the middle."""
    middle, size = 0.5 * (low[0] + high[0]), float((high - low).max())
    sides = {}
    for i, body in enumerate(sorted(places, key=lambda b: -places[b][1])):
        x = places[body][0]
        sides[body] = (1 if i % 2 == 0 else -1) if abs(x - middle) < 0.12 * size else (1 if x > middle else -1)
    return sides


def _lines(text: str) -> float:
    """Height of a text [px]."""
    return 1.25 * _TEXT * (text.count("\n") + 1)


def _heights(wanted: Mapping[int, float], labels: Mapping[int, str], sides: Mapping[int, int]) -> dict[int, float]:
    """Where the names stand, downwards [px]: beside their part, or lower where another one is in the way."""
    found: dict[int, float] = {}
    below = {-1: -np.inf, 1: -np.inf}
    for body in sorted(wanted, key=lambda b: wanted[b]):
        half = 0.5 * _lines(labels[body]) + 3.0
        found[body] = max(wanted[body], below[sides[body]] + half)
        below[sides[body]] = found[body] + half
    return found


def _view(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[Array, Array, Array]:
    """Unit vectors right, up and towards the eye: along the axis of a planar robot, else from above at an angle."""
    hinges = model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE
    free = (model.jnt_type == mujoco.mjtJoint.mjJNT_FREE).any()
    axes = data.xaxis[hinges]
    if not free and len(axes) and np.all(np.abs(axes @ axes[0]) > 0.99) and abs(axes[0][2]) < 0.5:
        toward = -axes[0] / np.linalg.norm(axes[0])
    else:
        toward = np.array([0.55, -0.75, 0.42])
        toward /= np.linalg.norm(toward)
    right = np.cross([0.0, 0.0, 1.0], toward)
    right /= np.linalg.norm(right)
    return right, np.cross(toward, right), toward


def _outline(model: mujoco.MjModel, data: mujoco.MjData, g: int, right: Array, up: Array) -> Array | None:
    """Silhouette of a geom on the picture plane, (n, 2); None for planes, fields and what is invisible."""
    kind, body = int(model.geom_type[g]), int(model.geom_bodyid[g])
    fixed = model.body_weldid[body] == 0
    if kind in (Geom.mjGEOM_PLANE, Geom.mjGEOM_HFIELD) or model.geom_rgba[g, 3] < 0.05:
        return None
    if fixed and model.geom_rbound[g] > 0.5 * float(model.stat.extent):
        return None
    turn, place = data.geom_xmat[g].reshape(3, 3), data.geom_xpos[g]
    size = model.geom_size[g]
    circle = np.cos(_RING)[:, None] * right + np.sin(_RING)[:, None] * up
    if kind == Geom.mjGEOM_SPHERE:
        points = place + size[0] * circle
    elif kind == Geom.mjGEOM_CAPSULE:
        ends = [place + s * size[1] * turn[:, 2] for s in (-1, 1)]
        points = np.concatenate([e + size[0] * circle for e in ends])
    elif kind == Geom.mjGEOM_CYLINDER:
        ring = size[0] * (np.cos(_RING)[:, None] * turn[:, 0] + np.sin(_RING)[:, None] * turn[:, 1])
        points = np.concatenate([place + s * size[1] * turn[:, 2] + ring for s in (-1, 1)])
    elif kind == Geom.mjGEOM_ELLIPSOID:
        theta, phi = np.meshgrid(np.linspace(0, np.pi, 12), _RING)
        unit = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], -1).reshape(-1, 3)
        points = place + (unit * size) @ turn.T
    elif kind == Geom.mjGEOM_MESH:
        mesh = int(model.geom_dataid[g])
        first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
        points = place + model.mesh_vert[first : first + count] @ turn.T
    else:
        corners = np.array([[a, b, c] for a in (-1, 1) for b in (-1, 1) for c in (-1, 1)], float)
        points = place + (corners * size) @ turn.T
    return _hull(points, right, up)


def _skeleton(
    model: mujoco.MjModel, data: mujoco.MjData, right: Array, up: Array, toward: Array
) -> list[tuple[float, int, Array]]:
    """Of a model that came without its meshes: each body a bar to those that it carries, or to its centre of mass."""
    bodies = np.arange(1, model.nbody)
    if not len(bodies):
        return []
    places = np.concatenate([data.xpos[bodies], data.xipos[bodies]])
    thick = _THICK * float(np.ptp(places, axis=0).max())
    round_ = thick * (np.cos(_RING)[:, None] * right + np.sin(_RING)[:, None] * up)
    shapes = []
    for body in bodies:
        carried = data.xpos[np.flatnonzero(model.body_parentid == body)]
        for end in carried if len(carried) else data.xipos[[body]]:
            outline = _hull(np.concatenate([data.xpos[body] + round_, end + round_]), right, up)
            if outline is not None:
                shapes.append((float(0.5 * (data.xpos[body] + end) @ toward), int(body), outline))
    return shapes


def _hull(points: Array, right: Array, up: Array) -> Array | None:
    """The convex outline (n, 2) of points on the picture plane; None where they have no area."""
    flat = np.stack([points @ right, points @ up], 1)
    try:
        return flat[ConvexHull(flat).vertices]
    except QhullError:
        return None


def _at(data: mujoco.MjData, body: int, right: Array, up: Array) -> Array:
    """Where the centre of mass of a body lies on the picture plane, (1, 2)."""
    return np.array([[data.xipos[body] @ right, data.xipos[body] @ up]])


def _bounds(outlines: list[Array]) -> tuple[Array, Array]:
    if not outlines:
        return np.zeros(2), np.ones(2)
    points = np.concatenate(outlines)
    return points.min(axis=0), points.max(axis=0)
