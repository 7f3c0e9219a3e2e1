"""Does the nominal model touch anything where the robot was? Itself: then forces act that the robot may not have."""

from __future__ import annotations

import copy
import dataclasses
from collections import Counter
from collections.abc import Iterator
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from simgap.data.plant import Plant
from simgap.simulation.contacts import colliding
from simgap.simulation.state import MeasuredState

Array = NDArray[np.float64]

_POSES = 300
"""Measured poses that are looked at, spread over the recording."""
NEAR = 0.01
"""[m] Nearer than this is near."""
OFTEN = 0.02
"""Share of them from which it is worth a word."""
_GROUND = (mujoco.mjtGeom.mjGEOM_PLANE, mujoco.mjtGeom.mjGEOM_HFIELD)


def self_contacts(plant: Plant, state: MeasuredState) -> dict[tuple[str, str], float]:
    """Pairs of bodies of the robot that overlap in the measured poses, and in which share (0 to 1) of these.

    Asked only where all coordinates are measured. What belongs to the world body itself is no part of the robot; a body
    that is welded to the world is.
    """
    model = plant.model
    if not state.complete(model):
        return {}
    found, poses = Counter[tuple[str, str]](), 0
    names = plant.names(mujoco.mjtObj.mjOBJ_BODY)
    for contact in _contacts(model, state):
        poses += 1
        touching = set()
        for geoms, distance in zip(contact.geom, contact.dist, strict=True):
            bodies = model.geom_bodyid[geoms]
            if distance < 0.0 and bodies.min() > 0 and not np.isin(model.geom_type[geoms], _GROUND).any():
                touching.add(tuple(sorted(names[b] for b in bodies)))
        found.update(touching)
    return {pair: count / poses for pair, count in found.items() if count >= OFTEN * poses}


def _contacts(model: mujoco.MjModel, state: MeasuredState) -> Iterator[Any]:
    """Contacts of a model in measured poses spread over the recording."""
    data, known = mujoco.MjData(model), state.qpos >= 0
    for row in np.unique(np.linspace(0, len(state.position) - 1, _POSES).astype(int)):
        data.qpos[state.qpos[known]] = state.position[row, known]
        if state.base is not None:
            data.qpos[state.base[0] : state.base[0] + 7] = state.pose[row]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        yield data.contact


def without_needless_contacts(plant: Plant, state: MeasuredState) -> Plant:
    """The same with contacts switched off, where nothing came near anything in the measured poses: a leg in the air.

    Contacts that never come cost time, and finer steps for them twice as much.
    """
    if not colliding(plant.model)[0] or not state.complete(plant.model):
        return plant
    wider = copy.copy(plant.model)
    wider.geom_margin[:] += NEAR
    if any(len(contact.dist) for contact in _contacts(wider, state)):
        return plant
    model = copy.copy(plant.model)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    return dataclasses.replace(plant, model=model)


def warnings(plant: Plant, state: MeasuredState) -> list[str]:
    """A sentence for each pair of bodies that overlap."""
    return [
        f"the nominal model touches itself: {one} and {two} overlap in {100 * share:.0f} % of the measured poses; if "
        "the robot's parts do not touch there, exclude the contact in the model (<contact><exclude .../></contact>), "
        "or it will be taken for a stop or a soft foot"
        for (one, two), share in sorted(self_contacts(plant, state).items(), key=lambda item: -item[1])
    ]
