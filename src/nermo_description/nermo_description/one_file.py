"""A model as one MJCF that needs no other file, for tools that know nothing of blocks and parameters."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def one_file(spec: mujoco.MjSpec) -> str:
    """The text of a model without its skins, which are meshes in files of their own; ``spec`` loses them.

    Bodies, joints and actuators keep their names, and keyframes their postures.
    """
    for geom in list(spec.geoms):
        if geom.type == mujoco.mjtGeom.mjGEOM_MESH:
            spec.delete(geom)
    for mesh in list(spec.meshes):
        spec.delete(mesh)
    model = spec.compile()
    written = mujoco.MjSpec.from_string(spec.to_xml())
    # In the file bodies stand in another order, and a keyframe is a list of numbers: written anew, by name.
    other = written.compile()
    for key in written.keys:
        key.qpos, key.ctrl = _reordered(model, other, key.name)
    written.compile()
    return str(written.to_xml())


def _reordered(model: mujoco.MjModel, other: mujoco.MjModel, key: str) -> tuple[Array, Array]:
    """A keyframe (qpos, ctrl) of ``model`` in the order of ``other``."""
    widths = {mujoco.mjtJoint.mjJNT_FREE: 7, mujoco.mjtJoint.mjJNT_BALL: 4}
    qpos, ctrl, frame = np.zeros(other.nq), np.zeros(other.nu), model.key(key)
    for j in range(model.njnt):
        name, width = model.joint(j).name, widths.get(int(model.jnt_type[j]), 1)
        here, there = int(model.jnt_qposadr[j]), int(other.jnt_qposadr[other.joint(name).id])
        qpos[there : there + width] = frame.qpos[here : here + width]
    for a in range(model.nu):
        ctrl[other.actuator(model.actuator(a).name).id] = frame.ctrl[a]
    return qpos, ctrl
