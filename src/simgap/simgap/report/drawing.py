"""Draws any MJCF as vector graphics, its parts coloured by their share of the gap. Needs no OpenGL."""

from __future__ import annotations

from collections.abc import Collection, Mapping

import mujoco
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_hex, to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from simgap.report.style import AFTER, HEAT, INK, QUIET, UNSEEN

Array = NDArray[np.float64]
Geom = mujoco.mjtGeom

_RING = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)


def draw_robot(
    model: mujoco.MjModel,
    qpos: Array,
    heat: Mapping[int, float],
    labels: Mapping[int, str],
    causes: Collection[int] = (),
) -> Figure:
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
    low, high = _bounds([s[2] for s in shapes])
    size = float((high - low).max())
    # As tall as the robot is, or the names beside it: a long mouse needs no tower.
    tall = max(float(high[1] - low[1]), 0.11 * size * (len(labels) + 1) / 2)
    figure = Figure(figsize=(5.4, float(np.clip(0.4 + 5.4 * tall / (1.3 * size), 1.8, 4.4))), layout="constrained")
    axes = figure.subplots()
    for _, body, outline in sorted(shapes, key=lambda s: s[0]):
        axes.add_patch(_patch(outline, heat.get(body), body in causes))
    drawn = {b: np.concatenate([s for _, body, s in shapes if body == b] or [_at(data, b, right, up)]) for b in labels}
    places = {b: 0.5 * (points.min(axis=0) + points.max(axis=0)) for b, points in drawn.items()}
    _label(axes, places, labels, (float(low[0]), float(high[0])), size)
    axes.set_aspect("equal")
    axes.autoscale_view()
    axes.margins(0.06)
    axes.axis("off")
    return figure


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
    flat = np.stack([points @ right, points @ up], 1)
    try:
        return flat[ConvexHull(flat).vertices]
    except QhullError:
        return None


def _at(data: mujoco.MjData, body: int, right: Array, up: Array) -> Array:
    """Where the centre of mass of a body lies on the picture plane, (1, 2)."""
    return np.array([[data.xipos[body] @ right, data.xipos[body] @ up]])


def _patch(outline: Array, heat: float | None, cause: bool) -> Polygon:
    colour = UNSEEN if heat is None else to_hex(HEAT(heat))
    edge, width = (to_rgb(AFTER), 2.4) if cause else (tuple(0.55 * c for c in to_rgb(colour)), 0.8)
    return Polygon(outline, closed=True, facecolor=colour, edgecolor=edge, linewidth=width, joinstyle="round")


def _bounds(outlines: list[Array]) -> tuple[Array, Array]:
    if not outlines:
        return np.zeros(2), np.ones(2)
    points = np.concatenate(outlines)
    return points.min(axis=0), points.max(axis=0)


def _label(
    axes: Axes,
    places: Mapping[int, Array],
    labels: Mapping[int, str],
    sides: tuple[float, float],
    size: float,
) -> None:
    """Names beside the parts at ``places``, left and right of the robot in turn, in the order of their height."""
    if not places:
        return
    middle = 0.5 * sum(sides)
    ordered = sorted(places, key=lambda b: -places[b][1])
    levels: dict[int, list[float]] = {-1: [], 1: []}
    for i, body in enumerate(ordered):
        x, y = places[body]
        side = (1 if i % 2 == 0 else -1) if abs(x - middle) < 0.12 * size else (1 if x > middle else -1)
        height = y
        while any(abs(height - h) < 0.11 * size for h in levels[side]):
            height -= 0.11 * size
        levels[side].append(height)
        axes.annotate(
            labels[body],
            (x, y),
            (sides[side > 0] + side * 0.1 * size, height),
            fontsize=9,
            color=INK,
            ha="left" if side > 0 else "right",
            va="center",
            arrowprops={"arrowstyle": "-", "color": QUIET, "linewidth": 0.8, "shrinkB": 0},
        )
