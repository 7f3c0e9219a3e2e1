"""The robot's shape: the meshes of its bodies, and where bodies and tendons are for joint angles and a pose."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
import trimesh
from numpy.typing import NDArray

from nermo_control.legs.kinematics import leg_kinematics
from nermo_control.spine.tendon import LumbarTendon, SpineTendon
from nermo_description.model import build_model
from nermo_description.parameters import LEGS, RobotParameters
from nermo_description.robots import AnyRobot

Array = NDArray[np.float64]

SEEN_GROUPS = (0, 1, 2)
"""Groups of geoms that MuJoCo's own viewers show at first; the others are for contact only."""


@dataclass(frozen=True)
class Part:
    """What one body has of one colour: a mesh in the body's frame."""

    body: str
    vertices: NDArray[np.float32]
    """[m], shape (V, 3)"""
    faces: NDArray[np.uint32]
    """Shape (F, 3)."""
    colour: tuple[int, int, int]


@dataclass(frozen=True)
class Placed:
    """Where everything is, in the frame of odometry."""

    position: dict[str, Array]
    """[m] of each body."""
    turn: dict[str, Array]
    """Unit quaternion w, x, y, z of each body."""
    tendons: NDArray[np.float32]
    """[m] Pieces of straight tendon, shape (N, 2, 3)."""
    feet: NDArray[np.float32]
    """[m] The feet in the order of LEGS, shape (4, 3)."""


class RobotShape:
    """A robot in a scene, moved by what topics say of it. Raises ValueError for a scene that does not exist."""

    def __init__(self, robot: AnyRobot, scene: str = "flat") -> None:
        self._model = model = build_model(robot, scene)
        self._data = mujoco.MjData(model)
        mujoco.mj_resetDataKeyframe(model, self._data, model.key("stand").id)
        self._joints = {
            model.joint(number).name: int(model.jnt_qposadr[number])
            for number in range(model.njnt)
            if model.jnt_type[number] != mujoco.mjtJoint.mjJNT_FREE
        }
        self._root = int(model.joint("root").qposadr[0])
        # base_link is fixed in the torso, which is what the free joint moves.
        base = model.site("base_link").id
        self._torso, self._torso_turn = np.zeros(3), np.zeros(4)
        mujoco.mju_negPose(self._torso, self._torso_turn, model.site_pos[base], model.site_quat[base])
        self._feet = [model.geom(f"{leg}_foot").id for leg in LEGS]
        self._servos = ServoJoints(robot) if isinstance(robot, RobotParameters) else None
        self.parts = _parts(model)
        self.bodies = list(dict.fromkeys(part.body for part in self.parts))
        """Bodies that there is something to see of."""
        self._numbers = {name: model.body(name).id for name in self.bodies}
        self.carriers = {name: self._carrier(number) for name, number in self._numbers.items()}
        """For each of them the next one that it hangs on; empty: none."""

    def _carrier(self, number: int) -> str:
        while number > 0:
            number = int(self._model.body_parentid[number])
            if number in self._numbers.values():
                return str(self._model.body(number).name)
        return ""

    def by_servos(self, positions: Mapping[str, float]) -> dict[str, float]:
        """Joint angles [rad] that follow from servo positions [rad] if nothing gives way; empty where nobody knows."""
        return self._servos.angles(positions) if self._servos is not None else {}

    def place(self, position: Array, turn: Array, angles: Mapping[str, float]) -> Placed:
        """Where bodies, tendons and feet are.

        Args:
            position: base_link in the frame of odometry [m].
            turn: The same, as a quaternion w, x, y, z; it may be of any length but 0.
            angles: Joint angles [rad]; a joint that is not named, or whose angle is not finite, stays where it was.
        """
        state, root = self._data.qpos, self._root
        unit = turn / np.linalg.norm(turn)
        mujoco.mju_mulPose(
            state[root : root + 3], state[root + 3 : root + 7], position, unit, self._torso, self._torso_turn
        )
        for name, angle in angles.items():
            place = self._joints.get(name)
            if place is not None and math.isfinite(angle):
                state[place] = angle
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_comPos(self._model, self._data)
        mujoco.mj_tendon(self._model, self._data)
        data, numbers = self._data, self._numbers
        return Placed(
            {name: data.xpos[number].copy() for name, number in numbers.items()},
            {name: data.xquat[number].copy() for name, number in numbers.items()},
            self._tendons(),
            data.geom_xpos[self._feet].astype(np.float32),
        )

    def _tendons(self) -> NDArray[np.float32]:
        points = self._data.wrap_xpos.reshape(-1, 3)
        pieces = [
            points[first : first + count]
            for first, count in zip(self._data.ten_wrapadr.tolist(), self._data.ten_wrapnum.tolist(), strict=True)
        ]
        return np.concatenate(
            [np.zeros((0, 2, 3)), *(np.stack([piece[:-1], piece[1:]], axis=1) for piece in pieces if len(piece) > 1)]
        ).astype(np.float32)


class ServoJoints:
    """Joint angles of a mouse from its servos' positions, as its tendons lead them: nothing gives way."""

    def __init__(self, robot: RobotParameters) -> None:
        self._robot = robot
        self._lateral = SpineTendon(robot.spine, robot.servos["spine_lateral"].neutral)
        vertical, offset = robot.servos.get("spine_vertical"), robot.spine_dynamics.lumbar_tendon_offset
        self._lumbar = (
            None if vertical is None or offset is None else LumbarTendon(robot.spine, offset, vertical.neutral)
        )
        self._legs = {
            leg: leg_kinematics(*((robot.front_leg, "front") if leg.startswith("front") else (robot.rear_leg, "rear")))
            for leg in LEGS
        }

    def angles(self, positions: Mapping[str, float]) -> dict[str, float]:
        """Joint angles [rad]; those of servos that are not named, or not finite, are left out."""
        known = {name: value for name, value in positions.items() if math.isfinite(value)}
        found = {f"{name}_joint": value for name, value in known.items() if not name.endswith("_knee")}
        for leg, kinematics in self._legs.items():
            hip, knee = known.get(f"{leg}_hip"), known.get(f"{leg}_knee")
            if hip is not None and knee is not None:
                found[f"{leg}_knee_pulley_joint"] = knee
                found[f"{leg}_knee_joint"] = kinematics.knee_angle(knee, hip)
        for servo, tendon in (("spine_lateral", self._lateral), ("spine_vertical", self._lumbar)):
            if tendon is not None and servo in known:
                flexion = tendon.flexion(known[servo])
                found |= {f"{servo}_{number}_joint": flexion for number in range(1, 5)}
                found[f"{servo}_pulley_joint"] = known[servo]
        if "tail" in known:
            found["tail_pulley_joint"] = known["tail"]
        return found


def _parts(model: mujoco.MjModel) -> list[Part]:
    meshes: dict[tuple[int, tuple[int, int, int]], list[trimesh.Trimesh]] = {}
    for geom in range(model.ngeom):
        if model.geom_group[geom] not in SEEN_GROUPS or model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_PLANE:
            continue
        mesh = _mesh(model, geom)
        if mesh is None:
            continue
        place = np.eye(4)
        turn = np.zeros(9)
        mujoco.mju_quat2Mat(turn, model.geom_quat[geom])
        place[:3, :3], place[:3, 3] = turn.reshape(3, 3), model.geom_pos[geom]
        mesh.apply_transform(place)
        material = model.geom_matid[geom]
        rgba = model.mat_rgba[material] if material >= 0 else model.geom_rgba[geom]
        red, green, blue = (round(255.0 * float(part)) for part in rgba[:3])
        meshes.setdefault((int(model.geom_bodyid[geom]), (red, green, blue)), []).append(mesh)
    parts = []
    for (body, colour), several in meshes.items():
        whole: Any = trimesh.util.concatenate(several)
        vertices, faces = np.asarray(whole.vertices, np.float32), np.asarray(whole.faces, np.uint32)
        parts.append(Part(model.body(body).name, vertices, faces, colour))
    return parts


def _mesh(model: mujoco.MjModel, geom: int) -> trimesh.Trimesh | None:
    """A geom in its own frame; None for a kind that is not drawn, as height fields."""
    kind, (a, b, c) = model.geom_type[geom], model.geom_size[geom].tolist()
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        mesh = model.mesh(model.geom_dataid[geom])
        first, count = int(model.mesh_vertadr[mesh.id]), int(model.mesh_vertnum[mesh.id])
        face, faces = int(model.mesh_faceadr[mesh.id]), int(model.mesh_facenum[mesh.id])
        return trimesh.Trimesh(
            model.mesh_vert[first : first + count], model.mesh_face[face : face + faces], process=False
        )
    if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        return trimesh.creation.icosphere(subdivisions=2, radius=a)
    if kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
        return trimesh.creation.icosphere(subdivisions=2).apply_scale((a, b, c))
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        whole = trimesh.creation.capsule(height=2.0 * b, radius=a, count=(12, 12))
        return whole.apply_translation(-whole.bounds.mean(axis=0))
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        return trimesh.creation.cylinder(radius=a, height=2.0 * b, sections=24)
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        return trimesh.creation.box(extents=(2.0 * a, 2.0 * b, 2.0 * c))
    return None
