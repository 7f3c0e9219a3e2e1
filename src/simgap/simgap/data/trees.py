"""Kinematic trees: parts of a model that only contacts, cables and equalities tie to each other."""

from __future__ import annotations

import mujoco

Obj = mujoco.mjtObj
_AT_JOINT = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))


def tree_of(model: mujoco.MjModel, kind: mujoco.mjtObj, index: int) -> int:
    """Kinematic tree of an object; -1 of what belongs to none, or to several."""
    body = -1
    if kind == Obj.mjOBJ_JOINT:
        body = int(model.jnt_bodyid[index])
    elif kind in (Obj.mjOBJ_BODY, Obj.mjOBJ_XBODY):
        body = index
    elif kind == Obj.mjOBJ_GEOM:
        body = int(model.geom_bodyid[index])
    elif kind == Obj.mjOBJ_SITE:
        body = int(model.site_bodyid[index])
    elif kind == Obj.mjOBJ_ACTUATOR and int(model.actuator_trntype[index]) in _AT_JOINT:
        body = int(model.jnt_bodyid[model.actuator_trnid[index, 0]])
    return int(model.body_treeid[body]) if body >= 0 else -1
