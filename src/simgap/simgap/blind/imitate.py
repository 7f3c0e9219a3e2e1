"""What a fault leaves in a recording that no healthy robot, with numbers within tolerance, could have left there."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from simgap.blind.stand import STAND, of_robot
from simgap.blind.truth import Truth

Array = NDArray[np.float64]

TOLERANCE = 0.12
"""Every number of a truth is off by 5 to 10 %; what little more of it would imitate nobody could tell from that."""
OFF_CENTRE, LEAN, FIRMER = 0.09, 0.012, 1.2
"""Where masses lie, as a share of a body's size; gravity against the model's axes [rad]; how firmly friction holds
against its normal force [log]."""
BEGUN, LATE = 0.05, 0.004
"""[rad or m] by which a joint may begin elsewhere: nobody was told where; [s] by which stamps may be off."""
ZERO, ZERO_SHARE = 0.006, 0.03
"""[rad or m] by which a joint sensor's zero may be off, and as a share of its joint's standard deviation."""
IMITATED, IMITATED_WALK, WINDOW = 4.0, 2.0, 0.2
"""[s] of a recording that are looked at; of a walk less, put back to where the robot was at the start of each window,
because nothing smooth describes what its numbers do to its way."""
_STEP = 0.5
"""Of a number, for its sensitivity."""
_ROUNDS, _BETTER = 4, 0.9
"""Sensitivities are taken so often at most, and anew only where the last ones took a tenth of what was left."""
_STEPS, _FURTHER = 3, 0.98
"""With the same sensitivities so many steps at most, each of which must take a fiftieth."""


def nominal_numbers(truth: Truth) -> list[Callable[[float], None]]:
    """Functions of z in [-1, 1] that move one number of a truth by z tolerances, in place."""
    model = truth.model

    def move(values: Array, where: int | slice, z: float) -> None:
        values[where] *= 1.0 + TOLERANCE * z

    def weigh(body: int, z: float) -> None:
        move(model.body_mass, body, z)
        move(model.body_inertia, body, z)

    moving = [b for b in range(1, model.nbody) if model.body_weldid[b] != 0 and of_robot(model, "body")[b]]
    found: list[Callable[[float], None]] = [partial(weigh, b) for b in moving]
    numbers = [model.dof_damping, model.dof_armature, model.jnt_stiffness, model.dof_frictionloss]
    # A stand is no number of a healthy robot.
    fields = [(v.T * of_robot(model, k)).T for v, k in zip(numbers, ("dof", "dof", "jnt", "dof"), strict=True)]
    # What a motor without feedback gives is its gain in the model; of a servo, it is computed with kp.
    fields += [truth.kv, np.where(truth.servo, 0.0, model.actuator_gainprm[:, 0]), np.where(truth.servo, truth.kp, 0.0)]
    numbers += [truth.kv, model.actuator_gainprm[:, 0], truth.kp]
    for values, field in zip(numbers, fields, strict=True):
        nonzero = np.flatnonzero(np.asarray(field).reshape(len(field), -1).any(axis=1))
        found += [partial(move, values, int(i)) for i in nonzero]
    found += [partial(move, model.body_inertia, b) for b in moving]
    # Where masses lie, which way is down and where joints begin is right in a truth, but nobody knows that who looks.
    found += [partial(_shift, model, b, axis) for b in moving for axis in range(3) if model.body_mass[b] > 0]
    if np.linalg.norm(model.opt.gravity) > 0:
        found += [partial(_lean, model, axis) for axis in range(2)]
    if model.nq == model.njnt:
        names = [str(model.joint(j).name) for j in range(model.njnt)]
        others = {*truth.soft.values(), *(n for n in names if n.startswith(STAND))}
        found += [partial(_begin, truth, name) for name in names if name not in others]
    if (model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE).any():
        every = slice(None)
        found.append(lambda z: move(model.geom_friction[:, 0], every, z))
        found.append(lambda z: move(model.geom_solref[:, 0], every, 2.0 * z))
        found.append(lambda z: setattr(model.opt, "impratio", model.opt.impratio * np.exp(FIRMER * z)))
    return found


def _shift(model: mujoco.MjModel, body: int, axis: int, z: float) -> None:
    """A mass that lies elsewhere, by a share of how far it spreads and hangs."""
    spread = np.sqrt(model.body_inertia[body].max() / model.body_mass[body])
    size = np.hypot(spread, 0.5 * np.linalg.norm(model.body_ipos[body]))
    model.body_ipos[body, axis] += OFF_CENTRE * size * z
    model.body_sameframe[body] = model.body_simple[body] = 0


def _lean(model: mujoco.MjModel, axis: int, z: float) -> None:
    """Gravity along z that leans a little, so little that its size stays."""
    model.opt.gravity[axis] += LEAN * z * np.linalg.norm(model.opt.gravity)


def _begin(truth: Truth, joint: str, z: float) -> None:
    """A joint that begins elsewhere."""
    model = truth.model
    at = truth.addresses(joint)[-1]
    usual = model.key_qpos[0, at] if model.nkey else model.qpos0[at]
    truth.start[joint] = truth.start.get(joint, float(usual)) + BEGUN * z


def left_by_imitation(seen: Callable[[Array], Array], recorded: Array, count: int) -> float:
    """Root mean square of what is left of a recording after a healthy robot has imitated it [noise deviations].

    ``seen(z)`` (n, channels) is what the healthy robot's sensors see at numbers z (count,), ``recorded`` what is to be
    imitated; both in noise deviations. Bounded Gauss-Newton; sensitivities are taken anew as long as that helps.
    """
    z = np.zeros(count)
    at = seen(z)
    best = _size(recorded - at)
    for _ in range(_ROUNDS):
        slopes = np.stack([(seen(z + step) - at).ravel() / step.sum() for step in _steps(z)], 1)
        before = best
        for _ in range(_STEPS):
            tried = z + lsq_linear(slopes, (recorded - at).ravel(), (-1.0 - z - 1e-9, 1.0 - z + 1e-9)).x
            there = seen(tried)
            if _size(recorded - there) > _FURTHER * best:
                break
            z, at, best = tried, there, _size(recorded - there)
        if best > _BETTER * before:
            break
    return best


def _size(left: Array) -> float:
    return float(np.sqrt(np.mean(left**2)))


def _steps(z: Array) -> Array:
    """A step of each number, away from the end of its range."""
    return np.diag(np.where(z > 0.0, -_STEP, _STEP))
