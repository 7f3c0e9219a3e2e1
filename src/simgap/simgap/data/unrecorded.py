"""Parts of a model that a recording knows nothing of: the other legs of a robot of which one leg was recorded."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import mujoco
import numpy as np

from simgap.data.channels import model_names
from simgap.data.mapping import Map
from simgap.data.trees import tree_of

Obj = mujoco.mjtObj
_AT_SITE = (int(mujoco.mjtTrn.mjTRN_SITE), int(mujoco.mjtTrn.mjTRN_SLIDERCRANK))
_ROUND_A_GEOM = (int(mujoco.mjtWrap.mjWRAP_SPHERE), int(mujoco.mjtWrap.mjWRAP_CYLINDER))
_OF_BODIES = (int(mujoco.mjtEq.mjEQ_CONNECT), int(mujoco.mjtEq.mjEQ_WELD))


def leave_out_unrecorded(spec: mujoco.MjSpec, model: mujoco.MjModel, mapping: Map) -> list[str]:
    """Take out of ``spec`` what stands fixed, is driven, and is not in the map by any name; roots of what was taken.

    Where such a part was, nobody knows: in a replay it would hang, as if its motors were off. What nothing drives stays
    (a door that the robot pushes), and so does what a cable or an equality ties to others.
    """
    named = set(_strings(mapping.model_dump(exclude={"corrects", "source"})))
    names = model_names(model, Obj.mjOBJ_BODY)
    tied, driven = _tied(model), _driven(model)
    gone = []
    for tree in range(model.ntree):
        bodies = np.flatnonzero(model.body_treeid == tree)
        root = int(bodies[0])
        free = (model.jnt_type[np.isin(model.jnt_bodyid, bodies)] == mujoco.mjtJoint.mjJNT_FREE).any()
        if free or tree in tied or tree not in driven or named & _names_in(model, tree):
            continue
        gone.append(root)
    if len(gone) == model.ntree:
        return []
    for body in [b for b in spec.bodies if b.id in gone]:
        spec.delete(body)
    return [names[b] for b in gone]


def _strings(value: Any) -> Iterator[str]:
    """All strings in nested mappings and sequences, keys too."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict):
        for key, inner in value.items():
            yield from (*_strings(key), *_strings(inner))
    elif isinstance(value, list | tuple):
        for inner in value:
            yield from _strings(inner)


def _tied(model: mujoco.MjModel) -> set[int]:
    """Trees with a joint or site in a tendon, a part in an equality, or an actuator that is not at a joint."""
    joints, bodies = set[int](), set[int]()
    for kind, index in zip(model.wrap_type, model.wrap_objid, strict=True):
        if kind == mujoco.mjtWrap.mjWRAP_JOINT:
            joints.add(int(index))
        elif kind == mujoco.mjtWrap.mjWRAP_SITE:
            bodies.add(int(model.site_bodyid[index]))
        elif int(kind) in _ROUND_A_GEOM:
            bodies.add(int(model.geom_bodyid[index]))
    for i, kind in enumerate(model.eq_type):
        ends = [int(e) for e in (model.eq_obj1id[i], model.eq_obj2id[i]) if e >= 0]
        if kind == mujoco.mjtEq.mjEQ_JOINT:
            joints.update(ends)
        elif int(kind) in _OF_BODIES:
            at_sites = model.eq_objtype[i] == Obj.mjOBJ_SITE
            bodies.update(int(model.site_bodyid[e]) if at_sites else e for e in ends)
    for kind, ends in zip(model.actuator_trntype, model.actuator_trnid, strict=True):
        if kind == mujoco.mjtTrn.mjTRN_BODY:
            bodies.add(int(ends[0]))
        elif int(kind) in _AT_SITE:
            bodies |= {int(model.site_bodyid[e]) for e in ends if e >= 0}
    bodies |= {int(model.jnt_bodyid[j]) for j in joints}
    return {int(model.body_treeid[b]) for b in bodies}


def _driven(model: mujoco.MjModel) -> set[int]:
    """Trees with an actuator at a joint."""
    return {tree_of(model, Obj.mjOBJ_ACTUATOR, a) for a in range(model.nu)}


def _names_in(model: mujoco.MjModel, tree: int) -> set[str]:
    """Names of all that is in a tree, and of the actuators and sensors at it."""
    found = set[str]()
    for kind in (Obj.mjOBJ_BODY, Obj.mjOBJ_JOINT, Obj.mjOBJ_GEOM, Obj.mjOBJ_SITE, Obj.mjOBJ_ACTUATOR):
        found |= {name for i, name in enumerate(model_names(model, kind)) if tree_of(model, kind, i) == tree}
    for i, name in enumerate(model_names(model, Obj.mjOBJ_SENSOR)):
        # Of what cannot be placed, any tree may be a part: the force at the trunk, the momentum of all.
        at = tree_of(model, Obj(int(model.sensor_objtype[i])), int(model.sensor_objid[i]))
        if at in (-1, tree):
            found.add(name)
    return found - {""}
