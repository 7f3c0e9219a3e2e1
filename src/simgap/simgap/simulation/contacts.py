"""What of a model can touch the ground, and how its contacts set in."""

from __future__ import annotations

import mujoco
import numpy as np

_LANDING = 0.3
"""[m/s] of a foot that lands, about."""
_ONSET = 1e-4
"""Impedance of a contact of no depth."""


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


def soften_onset(model: mujoco.MjModel) -> None:
    """Let contacts set in over a small depth instead of at once, in place; for sensitivities only.

    MuJoCo's contact pushes hard from the first time step that finds it closed. Whether that is this step or the next
    moves a landing by about a noise floor, however small the change that decides it: a finite difference across it is
    all jump and no slope. Over a depth that takes a step to cross the force grows from zero, and the jumps are gone.
    """
    depth = _LANDING * float(model.opt.timestep)
    for impedance in (model.geom_solimp, model.pair_solimp):
        impedance[:, 0], impedance[:, 2] = _ONSET, np.minimum(impedance[:, 2], depth)
