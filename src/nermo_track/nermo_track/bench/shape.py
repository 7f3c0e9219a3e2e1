"""The twin's own shape, drawn from its geoms as a camera sees them: torsos, spine, tail, head and legs that step."""

from __future__ import annotations

import cv2
import mujoco
import numpy as np
from numpy.typing import NDArray

from nermo_description.model import build_model
from nermo_description.parameters import RobotParameters
from nermo_track.bench.studio import MOMENTS
from nermo_track.bench.walk import Walk
from nermo_track.camera import Camera
from nermo_track.pose import Placement

Array = NDArray[np.float64]

SEEN_GROUPS = (0, 1, 2)
"""Of MuJoCo's geoms; the others are for contact only."""
FINER = 4
"""Dots along each edge of a pixel."""
MARGIN = 6
"""[px] Around the shape."""


class Shape:
    """Paints a twin that walks; each geom is convex, and the nearer one hides the farther one."""

    def __init__(
        self,
        robot: RobotParameters,
        walked: Walk,
        camera: Camera,
        world: Placement,
        greys: tuple[float, float] = (30.0, 90.0),
        seed: int = 0,
    ) -> None:
        """``world``: the world in the camera's axes. ``greys``: of 255, from and to which each geom has its own."""
        if walked.joints is None:
            raise ValueError("a walk without joints has no shape")
        self._time, self._joints, self._camera, self._world = walked.time, walked.joints, camera, world
        self._model = build_model(robot)
        self._data = mujoco.MjData(self._model)
        kinds, groups = self._model.geom_type, self._model.geom_group
        drawn = np.isin(groups, SEEN_GROUPS) & (kinds != mujoco.mjtGeom.mjGEOM_PLANE)
        self._geoms = [int(geom) for geom in np.flatnonzero(drawn)]
        self._points = [_points(self._model, geom) for geom in self._geoms]
        self._greys = np.random.default_rng(seed).uniform(*greys, len(self._geoms))

    def __call__(self, picture: Array, begin: float) -> None:
        """Paint it on a picture (height, width) whose first row's exposure begins at ``begin`` [s]."""
        camera = self._camera
        read, shutter = camera.height * camera.line_delay, camera.exposure
        first, last = (self._pixels(when) for when in (begin, begin + read + shutter))
        seen = []
        for moment in (np.arange(MOMENTS) + 0.5) / MOMENTS * shutter:
            pieces = []
            for (far, grey, here), (_, _, there) in zip(first, last, strict=True):
                late = moment + camera.line_delay * np.clip(here[:, 1:], 0.0, camera.height)
                pieces.append((far, grey, here + late / max(read + shutter, 1e-9) * (there - here)))
            seen.append(pieces)
        every = np.vstack([corners for pieces in seen for _, _, corners in pieces])
        size = np.array([camera.width, camera.height])
        low = np.clip(np.floor(every.min(axis=0)).astype(int) - MARGIN, 0, size)
        high = np.clip(np.ceil(every.max(axis=0)).astype(int) + MARGIN, 0, size)
        if (high <= low).any():
            return
        part = picture[low[1] : high[1], low[0] : high[0]]
        ground = np.repeat(np.repeat(part, FINER, axis=0), FINER, axis=1).astype(np.float32)
        total = np.zeros_like(ground)
        for pieces in seen:
            canvas = ground.copy()
            for _, grey, corners in sorted(pieces, key=lambda piece: -piece[0]):
                dots = np.round(16.0 * ((corners - low + 0.5) * FINER - 0.5)).astype(np.int32)
                cv2.fillConvexPoly(canvas, cv2.convexHull(dots), (float(grey),), cv2.LINE_8, 4)
            total += canvas
        shape = (high[1] - low[1], FINER, high[0] - low[0], FINER)
        part[...] = (total / MOMENTS).reshape(shape).mean(axis=(1, 3))

    def _pixels(self, time: float) -> list[tuple[float, float, Array]]:
        """Distance [m], grey, and corners (k, 2) [px] of each geom."""
        data, geoms = self._data, self._geoms
        data.qpos[:] = [np.interp(time, self._time, column) for column in self._joints.T]
        mujoco.mj_kinematics(self._model, data)  # which makes quaternions whole again
        placed = [
            points @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]
            for geom, points in zip(geoms, self._points, strict=True)
        ]
        seen = self._world.apply(np.vstack(placed))
        ends = np.cumsum([len(points) for points in placed])[:-1]
        pixels = np.split(self._camera.project(seen)[0], ends)
        far = [float(np.linalg.norm(points.mean(axis=0))) for points in np.split(seen, ends)]
        return list(zip(far, self._greys.tolist(), pixels, strict=True))


def _points(model: mujoco.MjModel, geom: int) -> Array:
    """(k, 3) [m] Corners of a geom's convex hull, in its own frame."""
    kind, (a, b, c) = model.geom_type[geom], model.geom_size[geom].tolist()
    around, up = np.meshgrid(np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False), np.linspace(-0.5, 0.5, 7) * np.pi)
    ball = np.stack([np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)], axis=-1).reshape(-1, 3)
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        mesh = model.mesh(model.geom_dataid[geom])
        first, count = int(model.mesh_vertadr[mesh.id]), int(model.mesh_vertnum[mesh.id])
        vertices = np.asarray(model.mesh_vert[first : first + count], dtype=np.float64)
        # The outermost in as many directions do for thousands.
        return np.asarray(vertices[np.unique(np.argmax((ball / [a, b, c]) @ vertices.T, axis=1))], dtype=np.float64)
    if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        return np.asarray(a * ball, dtype=np.float64)
    if kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
        return np.asarray(ball * [a, b, c], dtype=np.float64)
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        return np.vstack([a * ball + [0.0, 0.0, end] for end in (-b, b)])
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        return np.vstack([a * ball * [1.0, 1.0, 0.0] + [0.0, 0.0, end] for end in (-b, b)])
    raise ValueError(f"geom {geom} is of a kind that is not drawn: {mujoco.mjtGeom(kind).name}")
