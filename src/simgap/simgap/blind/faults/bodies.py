"""What can be wrong with bodies, feet, the ground and the stand."""

from __future__ import annotations

import mujoco
import numpy as np

from simgap.blind.faults.base import Scale, Values
from simgap.blind.stand import STAND, Stand
from simgap.blind.truth import Truth


def mass(truth: Truth, scale: Scale, body: str, size: float) -> Values:
    """A body heavier by a share of its mass, its inertia with it."""
    index = truth.model.body(body).id
    extra = size * float(truth.model.body_mass[index])
    truth.model.body_mass[index] *= 1.0 + size
    truth.model.body_inertia[index] *= 1.0 + size
    return {"change": extra}


def _gyration(truth: Truth, body: int) -> float:
    return float(np.sqrt(truth.model.body_inertia[body].max() / truth.model.body_mass[body]))


def com(truth: Truth, scale: Scale, body: str, size: float) -> Values:
    """A centre of mass that lies elsewhere, in shares of the body's radius of gyration."""
    index = truth.model.body(body).id
    # Along the body's x: what hangs or stands shows that best.
    shift = np.array([size * _gyration(truth, index), 0.0, 0.0])
    truth.model.body_ipos[index] += shift
    truth.model.body_sameframe[index] = truth.model.body_simple[index] = 0
    return dict(zip("xyz", map(float, shift), strict=True))


def inertia(truth: Truth, scale: Scale, body: str, size: float) -> Values:
    """A body harder to turn, of the same mass."""
    truth.model.body_inertia[truth.model.body(body).id] *= 1.0 + size
    return {"factor": 1.0 + size}


def slippery(truth: Truth, scale: Scale, geom: str, size: float) -> Values:
    """A foot with a share of its friction."""
    index = truth.model.geom(geom).id
    truth.model.geom_friction[index, 0] *= size
    truth.model.geom_priority[index] = int(truth.model.geom_priority.max()) + (truth.model.geom_priority[index] <= 0)
    return {"factor": size}


def soft_foot(truth: Truth, scale: Scale, geom: str, size: float) -> Values:
    """A foot whose contact is slower."""
    index = truth.model.geom(geom).id
    truth.model.geom_solref[index, 0] = size * max(float(truth.model.geom_solref[index, 0]), 1e-3)
    truth.model.geom_priority[index] = int(truth.model.geom_priority.max()) + (truth.model.geom_priority[index] <= 0)
    return {}


def slope_of_ground(truth: Truth, scale: Scale, _: str, size: float) -> Values:
    """The floor itself is tilted about y."""
    model = truth.model
    for g in np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE):
        model.geom_quat[g] = [np.cos(size / 2), 0.0, np.sin(size / 2), 0.0]
        model.geom_sameframe[g] = 0
    return {"pitch": size}


def stand_of(scale: Scale, size: float) -> Stand:
    """What gives way under the robot, relative to what its strongest joint does."""
    torque, swing = max(scale.torque.values()), max(scale.high[j] - scale.low[j] for j in scale.high)
    return Stand(4.0 * torque / (size * max(swing, 1e-6)))


def soft_mount(truth: Truth, scale: Scale, body: str, size: float) -> Values:
    """The stand is put in when the truth is built; its two axes differ a little, the mean counts."""
    model = truth.model
    names = (f"{STAND}_{axis}" for axis in "xy")
    return {"compliance": float(np.mean([1.0 / np.ravel(model.jnt_stiffness[model.joint(n).id])[0] for n in names]))}
