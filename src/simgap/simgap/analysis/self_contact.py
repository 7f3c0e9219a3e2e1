"""Does the nominal model touch itself where the robot was? Then forces act that the robot may not have."""

from __future__ import annotations

from collections import Counter

import mujoco
import numpy as np
from numpy.typing import NDArray

from simgap.data.plant import Plant
from simgap.simulation.state import MeasuredState

Array = NDArray[np.float64]

_POSES = 300
"""Measured poses that are looked at, spread over the recording."""
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
    data, found = mujoco.MjData(model), Counter[tuple[str, str]]()
    rows = np.unique(np.linspace(0, len(state.position) - 1, _POSES).astype(int))
    known = state.qpos >= 0
    names = plant.names(mujoco.mjtObj.mjOBJ_BODY)
    for row in rows:
        data.qpos[state.qpos[known]] = state.position[row, known]
        if state.base is not None:
            data.qpos[state.base[0] : state.base[0] + 7] = state.pose[row]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        touching = set()
        for geoms, distance in zip(data.contact.geom, data.contact.dist, strict=True):
            bodies = model.geom_bodyid[geoms]
            if distance < 0.0 and bodies.min() > 0 and not np.isin(model.geom_type[geoms], _GROUND).any():
                touching.add(tuple(sorted(names[b] for b in bodies)))
        found.update(touching)  # type: ignore[arg-type]
    return {pair: count / len(rows) for pair, count in found.items() if count >= OFTEN * len(rows)}


def warnings(plant: Plant, state: MeasuredState) -> list[str]:
    """A sentence for each pair of bodies that overlap."""
    return [
        f"the nominal model touches itself: {one} and {two} overlap in {100 * share:.0f} % of the measured poses; if "
        "the robot's parts do not touch there, exclude the contact in the model (<contact><exclude .../></contact>), "
        "or it will be taken for a stop or a soft foot"
        for (one, two), share in sorted(self_contacts(plant, state).items(), key=lambda item: -item[1])
    ]
