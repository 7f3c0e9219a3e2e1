"""What of a model can touch the ground, and whether anything can touch at all."""

from __future__ import annotations

import mujoco
import numpy as np


def colliding(model: mujoco.MjModel) -> tuple[list[int], list[int]]:
    """(geoms of the world, geoms of moving bodies) that can touch each other."""
    if model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_CONTACT):
        return [], []
    active = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    still = model.body_weldid[model.geom_bodyid] == 0
    world, moving = np.flatnonzero(active & still), np.flatnonzero(active & ~still)
    touches = [
        int(g)
        for g in moving
        if any(
            model.geom_contype[g] & model.geom_conaffinity[w] or model.geom_contype[w] & model.geom_conaffinity[g]
            for w in world
        )
    ]
    return ([int(w) for w in world], touches) if touches else ([], [])


def may_touch(model: mujoco.MjModel) -> bool:
    """Whether any two geoms could touch, wherever the robot is, by MuJoCo's masks, welds and parents."""
    if model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_CONTACT):
        return False
    if model.npair or model.nflex:
        return True
    kind, answers = model.geom_contype, model.geom_conaffinity
    passes = (kind[:, None] & answers) | (answers[:, None] & kind) != 0
    weld = model.body_weldid[model.geom_bodyid]
    passes &= weld[:, None] != weld
    if not model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_FILTERPARENT):
        parent = model.body_weldid[model.body_parentid[weld]]
        child = (weld[:, None] == parent) & (weld[:, None] != 0)
        passes &= ~(child | child.T)
    return bool(passes.any())
