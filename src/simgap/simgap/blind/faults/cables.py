"""What can be wrong with cables and straps."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np

from simgap.blind.faults.base import Inject, Scale, Values
from simgap.blind.truth import Truth


def of_its_actuator(change: Callable[[Truth, Scale, int, float], Values]) -> Inject:
    """A change of the actuator that pulls a cable, as a fault of that cable."""

    def inject(truth: Truth, scale: Scale, tendon: str, size: float) -> Values:
        model, target = truth.model, truth.model.tendon(tendon).id
        through = model.actuator_trntype == mujoco.mjtTrn.mjTRN_TENDON
        return change(truth, scale, int(np.flatnonzero(through & (model.actuator_trnid[:, 0] == target))[0]), size)

    return inject


def slack(truth: Truth, scale: Scale, a: int, size: float) -> Values:
    """A drum that turns freely first, by a share of what the command swings."""
    truth.cables[a].slack = size * float(scale.swing[a])
    return {"slack": truth.cables[a].slack}


def stretch(truth: Truth, scale: Scale, a: int, size: float) -> Values:
    """A cable that stretches, relative to its servo's stiffness."""
    truth.cables[a].compliance = size / float(truth.kp[a])
    return {"compliance": truth.cables[a].compliance}


def broken(truth: Truth, scale: Scale, a: int, size: float) -> Values:
    """A cable that pulls no more."""
    truth.cables[a].broken = True
    return {"share": 1.0}


def routing(truth: Truth, scale: Scale, a: int, size: float) -> Values:
    """Capstan friction would grow with the pull; this is the constant part, of the sheath."""
    level, tendon = size * float(scale.force[a]), int(truth.model.actuator_trnid[a, 0])
    speed = float(scale.rate[a]) or 1e-3

    def force(data: mujoco.MjData) -> None:
        slide = float(np.tanh(data.ten_velocity[tendon] / (0.02 * speed)))
        jacobian = data.ten_J.reshape(truth.model.ntendon, -1)
        if jacobian.shape[1] == truth.model.nv:
            data.qfrc_applied[:] -= level * slide * jacobian[tendon]
        else:  # stored row by row without its zeros
            first, count = int(truth.model.ten_J_rowadr[tendon]), int(truth.model.ten_J_rownnz[tendon])
            where = truth.model.ten_J_colind[first : first + count]
            data.qfrc_applied[where] -= level * slide * data.ten_J[first : first + count]

    truth.forces.append(force)
    return {"friction": level}


def loose_strap(truth: Truth, scale: Scale, tendon: str, size: float) -> Values:
    """A strap that is too long, by a share of its length."""
    index = truth.model.tendon(tendon).id
    slack = size * float(truth.model.tendon_range[index, 1])
    truth.model.tendon_range[index, 1] += slack
    return {"slack": slack}


def cut_strap(truth: Truth, scale: Scale, tendon: str, size: float) -> Values:
    """A strap that holds nothing."""
    truth.model.tendon_limited[truth.model.tendon(tendon).id] = 0
    return {"share": 1.0}
