"""A stand that gives way under a truth: a body with hinges, springs and an inertia between world and robot."""

from __future__ import annotations

from dataclasses import dataclass
from xml.etree import ElementTree

import mujoco
import numpy as np
from numpy.typing import NDArray

STAND = "stand"
"""Name of the body; those of its joints begin with it."""
_OWN = 0.4
"""Inertia of the stand, as a share of the robot's about it."""
_RATIO = 0.07
"""Damping ratio."""
_ASKEW = 0.1
"""By how much one axis is stiffer, and the other softer, than the mean."""


@dataclass(frozen=True)
class Stand:
    """What a robot stands on: ``stiffness`` [N m/rad] against tilting."""

    stiffness: float


def on_stand(spec: mujoco.MjSpec, body: str, stand: Stand) -> mujoco.MjSpec:
    """The same robot on a stand."""
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    base = model.body(body).id
    inertia = float(np.linalg.norm(data.subtree_com[base] - data.xpos[base]) ** 2 * model.body_subtreemass[base])
    inertia += sum(float(model.body_inertia[b].max()) for b in range(1, model.nbody) if model.body_rootid[b] == base)
    tree = ElementTree.fromstring(spec.to_xml())
    world = tree.find("worldbody")
    assert world is not None
    at, robot = next((i, e) for i, e in enumerate(world) if e.tag == "body" and e.get("name") == body)
    place = " ".join(map(repr, data.xpos[base].tolist()))
    stand_ = ElementTree.Element("body", name=STAND, pos=place)
    robot.set("pos", "0 0 0")
    for name, axis, share in (("x", "1 0 0", 1.0 + _ASKEW), ("y", "0 1 0", 1.0 - _ASKEW)):
        stiffness = share * stand.stiffness
        damping = 2.0 * _RATIO * np.sqrt(stiffness * (1.0 + _OWN) * inertia)
        told = {"stiffness": stiffness, "damping": float(damping), "armature": _OWN * inertia}
        words = {"name": f"{STAND}_{name}", "type": "hinge", "axis": axis}
        ElementTree.SubElement(stand_, "joint", words | {k: repr(float(v)) for k, v in told.items()})
    ElementTree.SubElement(stand_, "inertial", pos="0 0 0", mass="1e-6", diaginertia="1e-9 1e-9 1e-9")
    stand_.append(robot)
    world[at] = stand_
    return mujoco.MjSpec.from_string(ElementTree.tostring(tree, encoding="unicode"))


def of_robot(model: mujoco.MjModel, kind: str) -> NDArray[np.bool_]:
    """Which bodies (``body``), joints (``jnt``) or degrees of freedom (``dof``) are the robot's, not a stand's."""
    joints = np.array([not str(model.joint(j).name).startswith(STAND) for j in range(model.njnt)], bool)
    if kind == "body":
        return np.array([model.body(b).name != STAND for b in range(model.nbody)], bool)
    return joints if kind == "jnt" else joints[model.dof_jntid]
