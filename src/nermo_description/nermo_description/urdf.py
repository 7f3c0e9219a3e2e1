"""The model as URDF, for `robot_state_publisher` and RViz: links are MuJoCo's bodies, joints keep names and zeros."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable

import mujoco
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
PACKAGE = "package://nermo_description"
_ROOT = "base_link"
_OPTICAL = np.array([0.0, 1.0, 0.0, 0.0])
"""MuJoCo's cameras look along -z with y up; ROS's optical frames along z with y down."""


def to_urdf(model: mujoco.MjModel) -> str:
    """URDF text of the robot in a model, scene left out. The root link is `base_link`, MuJoCo's body `torso`.

    Beside the bodies there are links for the IMU (`imu_link`), the feet (`<leg>_foot`) and the cameras' optical frames.
    """
    robot = ElementTree.Element("robot", name=model.names[: model.names.index(b"\0")].decode())
    materials = _materials(model)
    root = model.body("torso").id
    for material, colour in materials.items():
        ElementTree.SubElement(
            ElementTree.SubElement(robot, "material", name=material),
            "color",
            rgba=_numbers(np.round(colour.astype(float), 4)),
        )
    for body in range(root, model.nbody):
        _add_link(robot, model, body)
        if body != root:
            _add_joint(robot, model, body)
    for site in range(model.nsite):
        name = model.site(site).name
        if name == "imu":
            _add_fixed(
                robot, "imu_link", _link(model, model.site_bodyid[site]), model.site_pos[site], model.site_quat[site]
            )
        elif name.endswith("_foot"):
            _add_fixed(robot, name, _link(model, model.site_bodyid[site]), model.site_pos[site], model.site_quat[site])
    for camera in range(model.ncam):
        name = model.camera(camera).name
        if name.startswith("head_"):
            quat = _multiply(model.cam_quat[camera], _OPTICAL)
            parent = _link(model, model.cam_bodyid[camera])
            _add_fixed(robot, f"{name}_camera_optical", parent, model.cam_pos[camera], quat)
    ElementTree.indent(robot)
    return '<?xml version="1.0"?>\n' + ElementTree.tostring(robot, encoding="unicode") + "\n"


def _link(model: mujoco.MjModel, body: int) -> str:
    name = str(model.body(body).name)
    return _ROOT if name == "torso" else name


def _add_link(robot: ElementTree.Element, model: mujoco.MjModel, body: int) -> None:
    link = ElementTree.SubElement(robot, "link", name=_link(model, body))
    if model.body_mass[body] > 0.0:
        inertial = ElementTree.SubElement(link, "inertial")
        _add_origin(inertial, model.body_ipos[body], model.body_iquat[body])
        ElementTree.SubElement(inertial, "mass", value=_number(model.body_mass[body]))
        x, y, z = (_number(value) for value in model.body_inertia[body])
        ElementTree.SubElement(inertial, "inertia", ixx=x, ixy="0", ixz="0", iyy=y, iyz="0", izz=z)
    for geom in range(model.ngeom):
        if model.geom_bodyid[geom] != body:
            continue
        collides = bool(model.geom_contype[geom] or model.geom_conaffinity[geom])
        if not collides and model.geom_group[geom] != 2:
            continue
        _add_geom(link, model, geom, "collision" if collides else "visual")


def _add_geom(link: ElementTree.Element, model: mujoco.MjModel, geom: int, kind: str) -> None:
    element = ElementTree.SubElement(link, kind)
    position, quat, size = model.geom_pos[geom], model.geom_quat[geom], model.geom_size[geom]
    shape = ElementTree.Element("geometry")
    match mujoco.mjtGeom(model.geom_type[geom]):
        case mujoco.mjtGeom.mjGEOM_MESH:
            mesh = int(model.geom_dataid[geom])
            # The compiler moves a mesh to its own centre; the file is where it was.
            inverse = np.zeros(4)
            mujoco.mju_negQuat(inverse, model.mesh_quat[mesh])
            quat = _multiply(quat, inverse)
            position = position - _rotate(quat, model.mesh_pos[mesh])
            ElementTree.SubElement(shape, "mesh", filename=f"{PACKAGE}/meshes/{_mesh_file(model, mesh)}")
        case mujoco.mjtGeom.mjGEOM_SPHERE:
            ElementTree.SubElement(shape, "sphere", radius=_number(size[0]))
        case mujoco.mjtGeom.mjGEOM_CAPSULE:
            length = _number(2.0 * (size[0] + size[1]))
            ElementTree.SubElement(shape, "cylinder", radius=_number(size[0]), length=length)
        case mujoco.mjtGeom.mjGEOM_CYLINDER:
            ElementTree.SubElement(shape, "cylinder", radius=_number(size[0]), length=_number(2.0 * size[1]))
        case mujoco.mjtGeom.mjGEOM_ELLIPSOID:  # of collisions only; URDF has none: the box around it
            ElementTree.SubElement(shape, "box", size=_numbers(2.0 * size))
        case other:
            raise ValueError(f"geom {model.geom(geom).name!r}: URDF has no {other.name}")
    _add_origin(element, position, quat)
    element.append(shape)
    if kind == "visual" and model.geom_matid[geom] >= 0:
        ElementTree.SubElement(element, "material", name=_plain(model.mat(model.geom_matid[geom]).name))


def _mesh_file(model: mujoco.MjModel, mesh: int) -> str:
    start = int(model.mesh_pathadr[mesh])
    path = model.paths[start : model.paths.index(b"\0", start)].decode()
    return path.replace("\\", "/").rsplit("/", 1)[-1]


def _add_joint(robot: ElementTree.Element, model: mujoco.MjModel, body: int) -> None:
    parent = _link(model, int(model.body_parentid[body]))
    position, quat = model.body_pos[body], model.body_quat[body]
    if model.body_jntnum[body] == 0:
        _add_fixed_joint(robot, _link(model, body), parent, position, quat)
        return
    joint = int(model.body_jntadr[body])
    element = ElementTree.SubElement(robot, "joint", name=model.joint(joint).name, type="revolute")
    _add_origin(element, position, quat)
    ElementTree.SubElement(element, "parent", link=parent)
    ElementTree.SubElement(element, "child", link=_link(model, body))
    ElementTree.SubElement(element, "axis", xyz=_numbers(model.jnt_axis[joint]))
    effort, velocity = _drive(model, joint)
    lower, upper = (_number(value) for value in model.jnt_range[joint])
    ElementTree.SubElement(element, "limit", lower=lower, upper=upper, effort=effort, velocity=velocity)
    damping = _number(model.dof_damping[model.jnt_dofadr[joint]])
    ElementTree.SubElement(element, "dynamics", damping=damping, friction="0")


def _drive(model: mujoco.MjModel, joint: int) -> tuple[str, str]:
    """Largest effort [N m] and velocity [rad/s]: of the servo at this joint; compliant joints have none of either."""
    for actuator in range(model.nu):
        if model.actuator_trnid[actuator, 0] == joint:
            torque = model.actuator_forcerange[actuator, 1]
            return _number(torque), _number(torque / model.dof_damping[model.jnt_dofadr[joint]])
    return "0", "100"


def _add_fixed(robot: ElementTree.Element, name: str, parent: str, position: Array, quat: Array) -> None:
    ElementTree.SubElement(robot, "link", name=name)
    _add_fixed_joint(robot, name, parent, position, quat)


def _add_fixed_joint(robot: ElementTree.Element, child: str, parent: str, position: Array, quat: Array) -> None:
    element = ElementTree.SubElement(robot, "joint", name=f"{child}_fixed", type="fixed")
    _add_origin(element, position, quat)
    ElementTree.SubElement(element, "parent", link=parent)
    ElementTree.SubElement(element, "child", link=child)


def _add_origin(element: ElementTree.Element, position: Array, quat: Array) -> None:
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, quat)
    r = matrix.reshape(3, 3)
    pitch = np.arctan2(-r[2, 0], np.hypot(r[0, 0], r[1, 0]))
    if np.hypot(r[0, 0], r[1, 0]) > 1e-9:
        roll, yaw = np.arctan2(r[2, 1], r[2, 2]), np.arctan2(r[1, 0], r[0, 0])
    else:
        roll, yaw = np.arctan2(-r[1, 2], r[1, 1]), 0.0
    ElementTree.SubElement(element, "origin", xyz=_numbers(position), rpy=_numbers((roll, pitch, yaw)))


def _materials(model: mujoco.MjModel) -> dict[str, Array]:
    """Colours by name; the blocks' copies of one material are one."""
    used = [
        int(material)
        for material, body in zip(model.geom_matid, model.geom_bodyid, strict=True)
        if material >= 0 < body
    ]
    return {_plain(model.mat(material).name): model.mat_rgba[material] for material in used}


def _plain(name: str) -> str:
    """`rear_left_fur` is `fur`."""
    return name.rsplit("_", 1)[-1]


def _multiply(first: Array, second: Array) -> Array:
    result = np.zeros(4)
    mujoco.mju_mulQuat(result, first, second)
    return result


def _rotate(quat: Array, vector: Array) -> Array:
    result = np.zeros(3)
    mujoco.mju_rotVecQuat(result, vector, quat)
    return result


def _numbers(values: Iterable[float]) -> str:
    return " ".join(_number(value) for value in values)


def _number(value: float) -> str:
    rounded = round(float(value), 12) + 0.0
    return f"{rounded:.9g}"
