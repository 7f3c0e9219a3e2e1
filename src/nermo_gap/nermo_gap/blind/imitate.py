"""What a fault leaves in a recording that no healthy robot, with numbers within tolerance, could have left there."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from nermo_gap.blind.truth import Truth

Array = NDArray[np.float64]

TOLERANCE = 0.12
"""Every number of a truth is off by 5 to 10 %; what little more of it would imitate nobody could tell from that."""
ZERO, ZERO_SHARE = 0.006, 0.03
"""[rad or m] by which a joint sensor's zero may be off, and as a share of its joint's standard deviation."""
IMITATED, IMITATED_WALK, WINDOW = 4.0, 2.0, 0.2
"""[s] of a recording that are looked at; of a walk less, put back to where the robot was at the start of each window,
because nothing smooth describes what its numbers do to its way."""
_ROUNDS, _STEP = 2, 0.5


def nominal_numbers(truth: Truth) -> list[Callable[[float], None]]:
    """Functions of z in [-1, 1] that move one number of a truth by z tolerances, in place."""
    model = truth.model

    def move(values: Array, where: int | slice, z: float) -> None:
        values[where] *= 1.0 + TOLERANCE * z

    def weigh(body: int, z: float) -> None:
        move(model.body_mass, body, z)
        move(model.body_inertia, body, z)

    moving = [b for b in range(1, model.nbody) if model.body_weldid[b] != 0]
    found: list[Callable[[float], None]] = [partial(weigh, b) for b in moving]
    fields = [model.dof_damping, model.dof_armature, model.jnt_stiffness, model.dof_frictionloss, truth.kv]
    # What a motor without feedback gives is its gain in the model; of a servo, it is computed with kp.
    fields += [np.where(truth.servo, 0.0, model.actuator_gainprm[:, 0]), np.where(truth.servo, truth.kp, 0.0)]
    numbers = [*fields[:-2], model.actuator_gainprm[:, 0], truth.kp]
    for values, field in zip(numbers, fields, strict=True):
        nonzero = np.flatnonzero(np.asarray(field).reshape(len(field), -1).any(axis=1))
        found += [partial(move, values, int(i)) for i in nonzero]
    found += [partial(move, model.body_inertia, b) for b in moving]
    # Where the masses lie is right in a truth, but nobody who looks at a recording knows that.
    found += [partial(move, model.body_ipos, b) for b in moving if np.abs(model.body_ipos[b]).max() > 0]
    if (model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE).any():
        every = slice(None)
        found.append(lambda z: move(model.geom_friction[:, 0], every, z))
        found.append(lambda z: move(model.geom_solref[:, 0], every, 2.0 * z))
    return found


def left_by_imitation(seen: Callable[[Array], Array], recorded: Array, count: int) -> float:
    """Root mean square of what is left of a recording after a healthy robot has imitated it [noise deviations].

    ``seen(z)`` (n, channels) is what the healthy robot's sensors see at numbers z (count,), ``recorded`` what is to be
    imitated; both in noise deviations. Bounded Gauss-Newton; sensitivities are taken once, at the nominal numbers.
    """
    nominal = seen(np.zeros(count))
    slopes = np.stack([(seen(_STEP * row) - nominal).ravel() / _STEP for row in np.eye(count)], 1)
    z, left = np.zeros(count), (recorded - nominal).ravel()
    best = float(np.sqrt(np.mean(left**2)))
    for _ in range(_ROUNDS):
        z = z + lsq_linear(slopes, left, (-1.0 - z - 1e-9, 1.0 - z + 1e-9)).x
        left = (recorded - seen(z)).ravel()
        best = min(best, float(np.sqrt(np.mean(left**2))))
    return best
