"""The robot's shape in viser's scene. The mouse stays in the middle and the ground moves below it: no view loses it."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Mapping

import numpy as np
import trimesh
import viser
from numpy.typing import NDArray

from nermo_web.robot_shape import Placed, RobotShape
from nermo_web.skeleton import Skeleton
from nermo_web.trail import Trail

Colour = tuple[int, int, int]

GROUND_M = 3.0
"""Edge of the piece of ground that is drawn; it comes along in whole cells."""
CELL_M, SECTION_M = 0.02, 0.1
TRAIL_HEIGHT_M = 0.0005
METRE_PER_NEWTON = 0.03
"""Length of a force's arrow: a foot carries some newtons at most."""
LEAST_FORCE_N = 0.01
TENDON, FORCE, WAY = (214, 140, 0), (200, 0, 0), (20, 80, 190)
"""Colours."""
GHOST_OPACITY = 0.35
GHOST_THICKER_M = 0.0008
"""By which a ghost stands out where it is where the robot is, so that the two surfaces do not flicker."""


class Scene:
    """A viser server on a port of this machine that nobody else needs to know, and what is in it."""

    def __init__(self, shape: RobotShape) -> None:
        # It tells its own address, which is not the one to open.
        with contextlib.redirect_stdout(io.StringIO()):
            self._server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
        server = self._server
        server.gui.configure_theme(show_logo=False, show_share_button=False)
        server.initial_camera.position = (0.27, -0.36, 0.2)
        server.initial_camera.look_at = (-0.02, 0.0, 0.0)
        server.initial_camera.near = 0.005
        server.initial_camera.fov = 0.7
        self._ground = server.scene.add_frame("/ground", show_axes=False)
        self._grid = server.scene.add_grid(
            "/ground/grid",
            GROUND_M,
            GROUND_M,
            cell_size=CELL_M,
            section_size=SECTION_M,
            cell_color=(215, 215, 210),
            section_color=(175, 175, 170),
            plane_color=(238, 238, 234),
            plane_opacity=1.0,
            shadow_opacity=0.25,
            fade_distance=3.0,
        )
        self._skeleton = Skeleton(server.scene, "/ground", shape)
        for number, part in enumerate(shape.parts):
            place = f"{self._skeleton.paths[part.body]}/{number}"
            server.scene.add_mesh_simple(place, part.vertices, part.faces, color=part.colour)
        nothing = np.zeros((0, 2, 3), np.float32)
        self._tendons = server.scene.add_line_segments("/ground/tendons", nothing, TENDON, thickness=0.0008)
        self._way = server.scene.add_line_segments("/ground/way", nothing, WAY, thickness=0.002)
        self._forces = server.scene.add_arrows(
            "/ground/forces", nothing, FORCE, shaft_radius=0.0009, head_radius=0.0025, head_length=0.006
        )

        self._ghost_shape = shape
        self._ghost: viser.FrameHandle | None = None
        self._ghost_skeleton: Skeleton | None = None
        self._ghost_meshes: list[tuple[str, viser.MeshHandle]] = []

    @property
    def port(self) -> int:
        """Where it listens, on this machine alone."""
        return self._server.get_port()

    @property
    def watched(self) -> bool:
        """Whether anybody sees it."""
        return bool(self._server.get_clients())

    def show(self, placed: Placed, forces: NDArray[np.float32], middle: tuple[float, float]) -> None:
        """Moves everything.

        Args:
            placed: Where bodies and tendons are.
            forces: On the feet [N], world axes, shape (4, 3).
            middle: What of the ground is in the middle [m].
        """
        x, y = middle
        felt = np.linalg.norm(forces, axis=1) > LEAST_FORCE_N
        arrows = np.stack([placed.feet, placed.feet + METRE_PER_NEWTON * forces], axis=1)[felt]
        with self._server.atomic():
            self._ground.position = (-x, -y, 0.0)
            cell = (SECTION_M * round(x / SECTION_M), SECTION_M * round(y / SECTION_M), 0.0)
            if tuple(self._grid.position) != cell:
                self._grid.position = cell
            self._skeleton.move(placed)
            self._tendons.points = placed.tendons
            self._forces.points = arrows

    def show_ghost(self, placed: Placed, colours: Mapping[str, Colour]) -> None:
        """Draws a second robot that one can see through, in a colour for each body; the first time it is brought."""
        if self._ghost is None:
            self._bring_ghost()
        assert self._ghost is not None and self._ghost_skeleton is not None
        with self._server.atomic():
            self._ghost.visible = True
            self._ghost_skeleton.move(placed)
            for body, mesh in self._ghost_meshes:
                if mesh.color != colours[body]:
                    mesh.color = colours[body]

    def hide_ghost(self) -> None:
        """Takes it away."""
        if self._ghost is not None and self._ghost.visible:
            self._ghost.visible = False

    @property
    def ghost_seen(self) -> bool:
        """Whether there is one."""
        return self._ghost is not None and self._ghost.visible

    def _bring_ghost(self) -> None:
        scene, shape = self._server.scene, self._ghost_shape
        self._ghost = scene.add_frame("/ground/ghost", show_axes=False)
        self._ghost_skeleton = Skeleton(scene, "/ground/ghost", shape)
        for number, part in enumerate(shape.parts):
            outward = trimesh.Trimesh(part.vertices, part.faces, process=False).vertex_normals
            mesh = scene.add_mesh_simple(
                f"{self._ghost_skeleton.paths[part.body]}/{number}",
                part.vertices + np.float32(GHOST_THICKER_M) * outward.astype(np.float32),
                part.faces,
                opacity=GHOST_OPACITY,
                cast_shadow=False,
                receive_shadow=False,
            )
            self._ghost_meshes.append((part.body, mesh))

    def show_way(self, trail: Trail) -> None:
        """Draws the way that was walked."""
        self._way.points = trail.pieces(TRAIL_HEIGHT_M)

    def close(self) -> None:
        """Ends the server."""
        with contextlib.redirect_stdout(io.StringIO()):
            self._server.stop()
